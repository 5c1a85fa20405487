"""Random and adversarial torques on arms that nobody would build, in every setting of the environment."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from beltarm_env import BeltArmEnv, BeltArmVectorEnv
from beltarm_env.arm import DRIVE_EFFECTS, FIELDS, NOMINAL, WHOLE, ArmParams, bounds_of, params_columns
from beltarm_env.arrays import Flags, Floats, Singles
from beltarm_env.observation import SENSORS
from beltarm_env.physics.models import MODELS, Model
from beltarm_env.physics.substeps import integration_limits
from beltarm_env.task.ranges import TRAIN_RANGES
from beltarm_env.task.reference import PROFILES
from eval.siege.report import Siege

STEPS = 3e8
"""Of arms, in a whole siege."""
_TAME, _WILD = 8192, 64  # arms of a round near the training ranges, and of one far away, which take many short steps
_STEPS = 1300  # more than an episode
_WATCHED = 3  # arms of each round that are stepped once more by themselves
_KINDS = 8  # of torques
_UPPER = {**asdict(NOMINAL), **{name: high for name, (_, high) in TRAIN_RANGES.items()}}


def besiege(share: float, seed: int) -> Siege:
    """Step arms under torques that are meant to break them, and check all that the environment promises.

    Finite numbers within the spaces' bounds, rewards that are not positive, flags and info that fit each other, and
    arms that do alone exactly what they do in the batch, whatever the number of threads.

    Args:
        share: Of a whole siege.
        seed: Of all that is drawn.
    """
    siege = Siege("environment", "arm steps", "states that are finite and wrong: those are what `make physics` checks")
    number = 0
    while siege.count < share * STEPS:
        arms = _WILD if number % 2 == 0 else min(_TAME, int(share * STEPS / _STEPS) + 1)
        siege.found += [f"seed {seed}, round {number} of {arms} arms: {text}" for text in _round(seed, number, arms)]
        siege.count += arms * _STEPS
        number += 1
    return siege


def drawn_arms(rng: np.random.Generator, count: int, decades: float, model: Model, ideal: bool) -> Floats:
    """Draw arms that the environment accepts, some decades around the upper ends of training, shape (count, fields)."""
    rows: list[Floats] = []
    while len(rows) < count:
        values = {name: _drawn(rng, name, decades) for name in FIELDS}
        if ideal:
            values |= dict.fromkeys(DRIVE_EFFECTS, 0.0)
        row = ArmParams(**values).row()
        if max(integration_limits(row, model)) <= 1:
            rows.append(row)
    return np.array(rows)


def _drawn(rng: np.random.Generator, name: str, decades: float) -> float:
    low, high, above, _ = bounds_of(name)
    value = _UPPER[name] * 10 ** rng.uniform(-decades, decades) * (rng.choice([-1, 1]) if low < 0 else 1)
    value = min(max(value, low), high) if rng.random() > 0.02 * decades else rng.choice([low, min(high, 1e6)])
    value = _UPPER[name] if above and value <= low else value
    return float(round(value)) if name in WHOLE else float(value)


def _torques(rng: np.random.Generator, kind: int, step: int, env: BeltArmVectorEnv, held: Singles) -> Singles:
    """Torques of one of eight kinds, over their limits, shape (arms, 1)."""
    count = env.num_envs
    noise = rng.uniform(-1, 1, (count, 1)).astype(np.float32)
    match kind:
        case 0:
            return noise
        case 1:
            return np.sign(noise)
        case 2:
            return held
        case 3:  # drives the belt's vibration
            return np.sign(env.state[:, 3:]).astype(np.float32)
        case 4:  # stops and starts the motor
            return -np.sign(env.state[:, 1:2]).astype(np.float32)
        case 5:
            return 1e-3 * noise
        case 6:  # far beyond the limit
            return np.float32(1e30) * noise
        case _:
            return held if step // 50 % 2 else np.zeros_like(held)


def _round(seed: int, number: int, arms: int) -> list[str]:
    """Play about one episode of a batch in settings of its own; a line for each promise that is broken."""
    rng = np.random.default_rng([seed, number])
    mode = list(AutoresetMode)[rng.integers(len(AutoresetMode))]
    settings: dict[str, Any] = {
        "sensors": str(rng.choice(SENSORS)),
        "profile": str(rng.choice(PROFILES)),
        "model": str(rng.choice(["lumped", "lagrangian"])),
        "encoder_counts": int(rng.choice([1, 100, 4000, 10_000_000])),
    }
    delays = rng.choice([0.0, 0.3, 1.0, 1.7, 2.0], arms)
    env = BeltArmVectorEnv(arms, **settings, delay=delays, autoreset_mode=mode, num_threads=int(rng.integers(1, 3)))
    decades = rng.choice([0.5, 2.0, 4.0]) if arms == _WILD else 0.04
    model, ideal = MODELS[settings["model"]], bool(rng.random() < 0.3)
    table = drawn_arms(rng, arms, decades, model, ideal)
    kind, held = int(rng.integers(_KINDS)), rng.uniform(-1, 1, (arms, 1)).astype(np.float32)
    name = f"{settings}, {mode.value}, torques {kind}"

    observations, _ = env.reset(seed=number, options={"params": params_columns(table)})
    watched = {int(arm): [(observations[arm], 0.0)] for arm in rng.choice(arms, _WATCHED, replace=False)}
    over, first, given = np.zeros(arms, np.bool_), np.ones(arms, np.bool_), []
    for step in range(_STEPS):
        if mode is AutoresetMode.DISABLED and over.any():
            anew = params_columns(drawn_arms(rng, int(over.sum()), decades, model, ideal))
            env.reset(options={"reset_mask": over, "params": anew})
        given.append(_torques(rng, kind, step, env, held))
        observations, rewards, terminated, truncated, info = env.step(given[-1])
        broken = _broken(env, observations, rewards, terminated, truncated, info)
        if broken:
            return [f"{name}, step {step}: {text}" for text in broken]
        over = terminated | truncated
        for arm, seen in watched.items():
            if first[arm]:
                shown = info["final_obs"] if over[arm] and "final_obs" in info else observations
                seen.append((shown[arm], float(rewards[arm])))
        first &= ~over
    differ = [
        arm
        for arm, seen in watched.items()
        if not _same_alone(
            settings, float(delays[arm]), table[arm], number + arm, [torque[arm] for torque in given], seen
        )
    ]
    return [f"{name}: arm {arm} does something else alone" for arm in differ]


def _broken(
    env: BeltArmVectorEnv,
    observations: Singles,
    rewards: Floats,
    terminated: Flags,
    truncated: Flags,
    info: dict[str, Any],
) -> list[str]:
    """Promises about a step that are broken."""
    infos = {**info, **info.get("final_info", {})}
    numbers = [values for name, values in infos.items() if not name.startswith(("_", "final"))]
    checks = {
        "observations leave their space": env.observation_space.contains(observations),
        "states are not finite": bool(np.isfinite(env.state).all()),
        "torques of motors are not finite": bool(np.isfinite(env.motor_torques).all()),
        "rewards are not finite, or positive": bool((np.isfinite(rewards) & (rewards <= 0)).all()),
        "info is not finite": all(np.isfinite(values).all() for values in numbers),
        "info has no totals of an episode that ended": not (terminated | truncated).any() or "total_cost" in infos,
    }
    return [text for text, kept in checks.items() if not kept]


def _same_alone(
    settings: dict[str, Any],
    delay: float,
    row: Floats,
    seed: int,
    torques: list[Singles],
    seen: list[tuple[Singles, float]],
) -> bool:
    """Whether an arm by itself shows, bit for bit, what it showed in the batch."""
    env = BeltArmEnv(**settings, delay=delay)
    observation, _ = env.reset(seed=seed, options={"params": asdict(ArmParams.from_row(row))})
    same = observation.tobytes() == seen[0][0].tobytes()
    for torque, (shown, reward) in zip(torques, seen[1:], strict=False):
        observation, alone, *_ = env.step(torque)
        same &= observation.tobytes() == shown.tobytes() and alone == reward
    return same
