"""Episodes of a dataset: controllers on batches of arms, some of them disturbed by random torques.

An episode is disturbed in one of two ways, or not at all:

    noise       smooth noise is added to the torque, all along
    stretches   now and then the controller is not asked, and smooth noise is the torque

The noise is of first order. Everything is drawn from the episode's own seed, and so the same in any batch.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode

from beltarm_env import BeltArmVectorEnv
from beltarm_env.arm import FIELDS
from beltarm_env.arrays import Flags, Singles
from beltarm_env.rollout import Controller, check_data_sheet, nominal_params
from beltarm_env.task.moves import MOVE_FIELDS
from beltarm_env.timing import EPISODE_STEPS

if TYPE_CHECKING:
    from minari.data_collector import EpisodeBuffer

KINDS = ("none", "noise", "stretches")
MEMORY = 0.97
"""Share of the noise that is left a sample later: 50 ms."""
LARGEST = {"none": 0.0, "noise": 0.2, "stretches": 0.5}
"""Largest standard deviation of the noise, over the torque limit, by kind; uniform from zero for each episode."""
GAP, STRETCH = 250, (30, 120)
"""Mean gap before a stretch, and its shortest and longest length, in samples: 375 ms; 45 to 180 ms."""
NOISE = {"memory": MEMORY, "largest_size": LARGEST, "mean_gap": GAP, "stretch": STRETCH}
"""The same as the dataset's metadata tell it."""
_STREAM = 1  # another one than that which the arm is drawn from


class Disturbance(NamedTuple):
    """Disturbance of one episode."""

    kind: str  # among `KINDS`
    size: float  # standard deviation of the noise, over the torque limit
    noise: Singles  # over the torque limit; zero where it does not act    (T,)
    alone: Flags  # where it is the torque by itself    (T,)


def draw_disturbance(seed: int, share: float) -> Disturbance:
    """Draw the disturbance of an episode.

    Args:
        seed: Seed of the episode.
        share: Share of episodes that are disturbed, 0 to 1; half of them in either way.
    """
    random = np.random.default_rng((seed, _STREAM))
    disturbed, way = random.random() < share, KINDS[1 + random.integers(2)]
    kind = way if disturbed else "none"
    size = LARGEST[kind] * random.random()
    fresh, noise = random.standard_normal(EPISODE_STEPS), np.empty(EPISODE_STEPS)
    last = random.standard_normal()
    for k in range(EPISODE_STEPS):
        noise[k] = last = MEMORY * last + np.sqrt(1 - MEMORY**2) * fresh[k]
    alone = np.zeros(EPISODE_STEPS, np.bool_)
    begin = random.exponential(GAP)
    while kind == "stretches" and begin < EPISODE_STEPS:
        end = begin + random.integers(*STRETCH, endpoint=True)
        alone[int(begin) : int(end)] = True
        begin = end + random.exponential(GAP)
    acts = alone | (kind == "noise")
    return Disturbance(kind, size, np.where(acts, size * noise, 0.0).astype(np.float32), alone)


def run_episodes(
    name: str, controller: Controller, seeds: Sequence[int], share: float, settings: Mapping[str, Any]
) -> dict[int, tuple[EpisodeBuffer, dict[str, Any]]]:
    """Run a controller on the arms of some seeds, side by side; each episode is that of a single environment.

    Args:
        name: Name of the controller.
        controller: The controller.
        seeds: Seed of each episode.
        share: Share of episodes that are disturbed, see `draw_disturbance`.
        settings: Arguments of `BeltArmVectorEnv`.

    Returns:
        Episode and its metadata, by seed.

    Raises:
        ValueError: If the controller does not suit the arms.
    """
    from minari.data_collector import EpisodeBuffer

    disturbances = [draw_disturbance(seed, share) for seed in seeds]
    noise, alone = (np.stack([getattr(each, name) for each in disturbances], axis=1) for name in ("noise", "alone"))
    env = BeltArmVectorEnv(len(seeds), autoreset_mode=AutoresetMode.DISABLED, **settings)
    seen, _ = env.reset(seed=seeds)
    check_data_sheet(nominal_params(controller), env.params_table, name)
    params, moves, memory, start = env.params_table, env.moves, None, np.ones(len(seeds), np.bool_)
    samples, steps = [(seen, env.state, np.hypot(*env.tip_errors()[:, :2].T))], []
    for k in range(EPISODE_STEPS):
        action, memory = controller.predict(seen, memory, start, deterministic=True)
        own = np.clip(action[:, 0], -1, 1)
        torques = np.clip(~alone[k] * own + noise[k], -1, 1)[:, None]
        seen, reward, start, truncated, info = env.step(torques)
        samples.append((seen, env.state, info["tip_error"]))
        steps.append((own, torques, reward, start, truncated))
        if start.any() and not truncated.any():  # keeps the batch going; what is over is cut off below
            seen, _ = env.reset(options={"reset_mask": start})
    observations, states, errors = map(np.stack, zip(*samples, strict=True))
    wanted, actions, rewards, terminated, truncated = map(np.stack, zip(*steps, strict=True))
    episodes = {}
    for k, (seed, disturbance) in enumerate(zip(seeds, disturbances, strict=True)):
        end = int(np.argmax(terminated[:, k] | truncated[:, k])) + 1
        hidden = {"state": states[: end + 1, k], "tip_error": errors[: end + 1, k]}
        behaviour = {"controller_action": wanted[:, k], "noise": disturbance.noise, "alone": disturbance.alone}
        infos = {
            "not_observed": {key: values.astype(np.float32) for key, values in hidden.items()},
            "behaviour": {key: np.insert(values[:end], 0, 0) for key, values in behaviour.items()},  # 0: the reset
        }
        reset = {
            "params": dict(zip(FIELDS, params[k].tolist(), strict=True)),
            "move": dict(zip(MOVE_FIELDS, moves[k].tolist(), strict=True)),
        }
        arrays: dict[str, Any] = {
            "observations": observations[: end + 1, k],
            "actions": actions[:end, k],
            "rewards": rewards[:end, k],
            "terminations": terminated[:end, k],
            "truncations": truncated[:end, k],
        }
        buffer = EpisodeBuffer(seed=seed, options=reset, infos=infos, **arrays)
        metadata = {
            "controller": name,
            "disturbance": disturbance.kind,
            "noise_size": disturbance.size,
            "cost": -float(np.sum(rewards[:end, k])),
            "finished": not terminated[end - 1, k],
        }
        episodes[seed] = buffer, metadata
    return episodes
