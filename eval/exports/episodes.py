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
from beltarm_env.arrays import Flags, Floats, Singles
from beltarm_env.rollout import Controller, record
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


class _Disturbed:
    """Controller of n episodes that are disturbed, for one rollout."""

    def __init__(self, controller: Controller, disturbances: Sequence[Disturbance]) -> None:
        self.params = getattr(controller, "params", None)
        self.wanted: list[Singles] = []  # actions of the controller by itself, shape (n,) for each sample
        self._controller = controller
        self._noise: Singles = np.stack([each.noise for each in disturbances], axis=1)
        self._asked: Flags = ~np.stack([each.alone for each in disturbances], axis=1)

    def predict(
        self, observation: Singles, state: Any = None, episode_start: Flags | None = None, deterministic: bool = True
    ) -> tuple[Singles, Any]:
        """Call the controller's `predict`, and disturb what it returns."""
        action, state = self._controller.predict(observation, state, episode_start, deterministic)
        k, own = len(self.wanted), np.clip(action[:, 0], -1, 1)
        self.wanted.append(own)
        return np.clip(self._asked[k] * own + self._noise[k], -1, 1)[:, None], state


class _RecordedArms(BeltArmVectorEnv):
    """Vector environment that stores every observation, state and reward of one rollout."""

    def __init__(self, num_envs: int, **settings: Any) -> None:
        super().__init__(num_envs, autoreset_mode=AutoresetMode.DISABLED, **settings)
        self.samples: list[tuple[Singles, Floats, Floats]] = []  # T + 1 observations, states, errors of the tip
        self.steps: list[tuple[Singles, Floats, Flags, Flags]] = []  # T actions, rewards, terminations, truncations

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Singles, dict[str, Any]]:
        seen, info = super().reset(seed=seed, options=options)
        if not self.samples:  # later resets are those of arms whose episode is over
            self.samples.append((seen, self.state, np.hypot(*self.tip_errors()[:, :2].T)))
        return seen, info

    def step(self, actions: Singles) -> tuple[Singles, Floats, Flags, Flags, dict[str, Any]]:
        seen, reward, terminated, truncated, info = super().step(actions)
        self.samples.append((seen, self.state, info["tip_error"]))
        self.steps.append((actions, reward, terminated, truncated))
        return seen, reward, terminated, truncated, info


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
    env, disturbed = _RecordedArms(len(seeds), **settings), _Disturbed(controller, disturbances)
    recording = record(disturbed, env, seed=seeds)
    observations, states, errors = map(np.stack, zip(*env.samples, strict=True))
    actions, rewards, terminated, truncated = map(np.stack, zip(*env.steps, strict=True))
    wanted = np.stack(disturbed.wanted)
    episodes = {}
    for k, (seed, disturbance) in enumerate(zip(seeds, disturbances, strict=True)):
        steps = int(np.argmax(terminated[:, k] | truncated[:, k])) + 1
        hidden = {"state": states[: steps + 1, k], "tip_error": errors[: steps + 1, k]}
        behaviour = {"controller_action": wanted[:, k], "noise": disturbance.noise, "alone": disturbance.alone}
        infos = {
            "not_observed": {key: values.astype(np.float32) for key, values in hidden.items()},
            "behaviour": {key: np.insert(values[:steps], 0, 0) for key, values in behaviour.items()},  # 0: the reset
        }
        reset = {
            "params": dict(zip(FIELDS, recording.params[k].tolist(), strict=True)),
            "move": dict(zip(MOVE_FIELDS, recording.moves[k].tolist(), strict=True)),
        }
        arrays: dict[str, Any] = {
            "observations": observations[: steps + 1, k],
            "actions": actions[:steps, k],
            "rewards": rewards[:steps, k],
            "terminations": terminated[:steps, k],
            "truncations": truncated[:steps, k],
        }
        buffer = EpisodeBuffer(seed=seed, options=reset, infos=infos, **arrays)
        metadata = {
            "controller": name,
            "disturbance": disturbance.kind,
            "noise_size": disturbance.size,
            "cost": -float(np.sum(rewards[:steps, k])),
            "finished": not terminated[steps - 1, k],
        }
        episodes[seed] = buffer, metadata
    return episodes
