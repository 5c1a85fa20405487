"""Random and adversarial torques over whole episodes, on arms that nobody would build, in every setting."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from beltarm_env import BeltArmEnv, BeltArmVectorEnv
from beltarm_env.arm import DRIVE_EFFECTS, FIELDS, NOMINAL, WHOLE, ArmParams, bounds_of, params_columns
from beltarm_env.arrays import Flags, Floats, Singles
from beltarm_env.observation import SENSORS
from beltarm_env.physics.models import MODELS, Model
from beltarm_env.physics.substeps import integration_limits
from beltarm_env.task.ranges import TRAIN_RANGES
from beltarm_env.task.reference import PROFILES

STEPS = 1300  # more than an episode
ALONE = 3  # arms of a batch that are stepped once more by themselves
UPPER = {**asdict(NOMINAL), **{name: high for name, (_, high) in TRAIN_RANGES.items()}}
TORQUES = ("noise", "full", "constant", "with the belt", "against the motor", "tiny", "huge", "on and off")


@pytest.mark.parametrize(("arms", "decades", "count"), [(64, (0.5, 2.0, 4.0), 3), (1024, (0.04,), 2)])
def test_finite_within_bounds_and_as_arms_alone(arms: int, decades: tuple[float, ...], count: int):
    """Arms around the upper ends of the training ranges, by a factor of 10 to the power of `decades`."""

    @examples(count, shrink=False)
    @given(st.integers(0, 2**31))
    def step(seed: int) -> None:
        rng = np.random.default_rng(seed)
        step_batch(rng, seed, arms, float(rng.choice(decades)))

    step()


def step_batch(rng: np.random.Generator, seed: int, arms: int, decades: float) -> None:
    """Step a batch with settings of its own for about one episode, and some of its arms alone."""
    mode = list(AutoresetMode)[rng.integers(len(AutoresetMode))]
    settings: dict[str, Any] = {
        "sensors": str(rng.choice(SENSORS)),
        "profile": str(rng.choice(PROFILES)),
        "model": str(rng.choice(["lumped", "lagrangian"])),
        "encoder_counts": int(rng.choice([1, 100, 4000, 10_000_000])),
    }
    delays = rng.choice([0.0, 0.3, 1.0, 1.7, 2.0], arms)
    env = BeltArmVectorEnv(arms, **settings, delay=delays, autoreset_mode=mode, num_threads=int(rng.integers(1, 3)))
    model, ideal = MODELS[settings["model"]], bool(rng.random() < 0.3)
    table = draw_arms(rng, arms, decades, model, ideal)
    kind, constant = str(rng.choice(TORQUES)), rng.uniform(-1, 1, (arms, 1)).astype(np.float32)

    observations, _ = env.reset(seed=seed, options={"params": params_columns(table)})
    seen = {int(arm): [(observations[arm], 0.0)] for arm in rng.choice(arms, ALONE, replace=False)}
    over, first, torques = np.zeros(arms, np.bool_), np.ones(arms, np.bool_), []
    for step in range(STEPS):
        if mode is AutoresetMode.DISABLED and over.any():
            new = params_columns(draw_arms(rng, int(over.sum()), decades, model, ideal))
            env.reset(options={"reset_mask": over, "params": new})
        torques.append(torques_of(kind, rng, step, env, constant))
        observations, rewards, terminated, truncated, info = env.step(torques[-1])
        over = terminated | truncated
        assert_promises(env, observations, rewards, over, info)
        for arm, steps in seen.items():
            if first[arm]:
                last = info["final_obs"] if over[arm] and "final_obs" in info else observations
                steps.append((last[arm], float(rewards[arm])))
        first &= ~over
    for arm, steps in seen.items():
        alone = BeltArmEnv(**settings, delay=float(delays[arm]))
        observation, _ = alone.reset(seed=seed + arm, options={"params": asdict(ArmParams.from_row(table[arm]))})
        assert observation.tobytes() == steps[0][0].tobytes()
        for torque, (wanted, reward) in zip(torques, steps[1:], strict=False):
            observation, given_reward, *_ = alone.step(torque[arm])
            assert observation.tobytes() == wanted.tobytes() and given_reward == reward


def assert_promises(
    env: BeltArmVectorEnv, observations: Singles, rewards: Floats, over: Flags, info: dict[str, Any]
) -> None:
    """Everything is finite and within bounds, rewards are not positive, and episodes that end have totals."""
    infos = {**info, **info.get("final_info", {})}
    assert env.observation_space.contains(observations)
    assert np.isfinite(env.state).all() and np.isfinite(env.motor_torques).all()
    assert (np.isfinite(rewards) & (rewards <= 0)).all()
    assert all(np.isfinite(values).all() for name, values in infos.items() if not name.startswith(("_", "final")))
    assert not over.any() or "total_cost" in infos


def draw_arms(rng: np.random.Generator, count: int, decades: float, model: Model, ideal: bool) -> Floats:
    """Draw arms that the environment accepts, shape (count, fields)."""
    rows: list[Floats] = []
    while len(rows) < count:
        values = {name: draw_value(rng, name, decades) for name in FIELDS}
        if ideal:
            values |= dict.fromkeys(DRIVE_EFFECTS, 0.0)
        row = ArmParams(**values).row()
        if max(integration_limits(row, model)) <= 1:
            rows.append(row)
    return np.array(rows)


def draw_value(rng: np.random.Generator, name: str, decades: float) -> float:
    low, high, above, _ = bounds_of(name)
    value = UPPER[name] * 10 ** rng.uniform(-decades, decades) * (rng.choice([-1, 1]) if low < 0 else 1)
    value = min(max(value, low), high) if rng.random() > 0.02 * decades else rng.choice([low, min(high, 1e6)])
    value = UPPER[name] if above and value <= low else value
    return float(round(value)) if name in WHOLE else float(value)


def torques_of(kind: str, rng: np.random.Generator, step: int, env: BeltArmVectorEnv, constant: Singles) -> Singles:
    """Torques over their limits, shape (arms, 1)."""
    noise = rng.uniform(-1, 1, constant.shape).astype(np.float32)
    match kind:
        case "noise":
            return noise
        case "full":
            return np.sign(noise)
        case "constant":
            return constant
        case "with the belt":  # drives its vibration
            return np.sign(env.state[:, 3:]).astype(np.float32)
        case "against the motor":  # stops and starts it
            return -np.sign(env.state[:, 1:2]).astype(np.float32)
        case "tiny":
            return 1e-3 * noise
        case "huge":
            return np.float32(1e30) * noise
        case _:
            return constant if step // 50 % 2 else np.zeros_like(constant)
