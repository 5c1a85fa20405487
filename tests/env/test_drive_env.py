"""The drive as it is built, through the environments."""

import math
from typing import Any

import numpy as np
import pytest

from beltarm_env import (
    CONTROL_PERIOD,
    IDEAL_RANGES,
    TRAIN_RANGES,
    ArmParams,
    BeltArmEnv,
    BeltArmVectorEnv,
    design_model,
)
from beltarm_env.arm import COLUMN, DRIVE_EFFECTS, FIELDS
from beltarm_env.task.ranges import DRIVE_RANGES

UPPER_ENDS = {name: high for name, (_, high) in DRIVE_RANGES.items()}


def commands(steps: int, arms: int = 1) -> np.ndarray:
    k = np.arange(steps)[:, None]
    wave = 0.25 * np.sin(0.03 * k + np.arange(arms)) + 0.1 * np.sign(np.sin(0.2 * k + np.arange(arms)))
    return wave[:, :, None].astype(np.float32)


@pytest.mark.parametrize("model", ["lumped", "lagrangian"])
def test_each_arm_of_a_mixed_batch_moves_as_it_does_alone(model: Any):
    rng = np.random.default_rng(0)
    params = [
        {name: rng.uniform(*pair) for name, pair in TRAIN_RANGES.items() if name != "torque_ripple_order"}
        if arm % 2
        else {name: rng.uniform(*pair) for name, pair in IDEAL_RANGES.items()}
        for arm in range(9)
    ]
    columns = {name: [arm.get(name, getattr(ArmParams(), name)) for arm in params] for name in FIELDS}
    batch = BeltArmVectorEnv(9, model=model)
    batch.reset(seed=5, options={"params": columns})
    alone = [BeltArmEnv(model=model) for _ in params]
    for arm, env in enumerate(alone):
        env.reset(seed=5 + arm, options={"params": params[arm]})
    for action in commands(400, 9):
        batch.step(action)
        for arm, env in enumerate(alone):
            env.step(action[arm])
    assert batch.state.tolist() == [env.state.tolist() for env in alone]
    assert batch.motor_torques.tolist() == [env.motor_torque for env in alone]


def test_an_episode_is_the_same_whatever_drives_the_arms_before_had():
    used, drives = BeltArmEnv(), [{}, UPPER_ENDS, {}, UPPER_ENDS]
    for params in drives:
        new = BeltArmEnv()
        for env in (used, new):
            env.reset(seed=1, options={"params": params})
            for action in commands(40)[:, 0]:
                env.step(action)
        assert used.state.tolist() == new.state.tolist() and used.motor_torque == new.motor_torque


@pytest.mark.parametrize("name", [name for name in DRIVE_EFFECTS if name != "friction_drift"])
def test_every_effect_moves_the_arm_otherwise(name: str):
    ideal, built = BeltArmEnv(), BeltArmEnv()
    ideal.reset(seed=1)
    built.reset(seed=1, options={"params": {name: UPPER_ENDS[name]}})
    for action in commands(200)[:, 0]:
        ideal.step(action)
        built.step(action)
    assert np.abs(ideal.state - built.state).max() > 1e-5


def test_torque_follows_the_command_late_and_lagging():
    lag, latency, constant = 0.0008, 1.3 * CONTROL_PERIOD, 0.06
    params = {
        "current_loop_time_constant": lag,
        "command_latency": latency,
        "torque_constant_error": constant,
    }
    env = BeltArmEnv()
    env.reset(seed=0, options={"params": params})
    for k in range(1, 8):
        env.step(np.array([0.5], np.float32))
        since = max(k * CONTROL_PERIOD - latency, 0.0)
        expected = 0.5 * 0.3 * (1 + constant) * (1 - math.exp(-since / lag))
        assert env.motor_torque == pytest.approx(expected, rel=1e-9, abs=1e-15)


def test_observation_has_the_command_and_not_the_torque():
    built, ideal = BeltArmEnv(), BeltArmEnv()
    built.reset(seed=0, options={"params": {"current_loop_time_constant": 0.01, "torque_constant_error": -0.5}})
    ideal.reset(seed=0)
    action = np.array([0.7], np.float32)
    assert built.step(action)[0][24] == ideal.step(action)[0][24] == pytest.approx(0.7)


def test_drift_changes_friction_from_the_first_sample_to_the_last():
    env = BeltArmEnv()
    env.reset(seed=0, options={"params": {"friction_drift": 0.5}, "move": {"start": 0.7, "goal": 1.2}})
    start = env.state[0]
    action = np.array([0.036 / 0.3], np.float32)  # more than friction at first, less after a quarter of the episode
    for _ in range(50):
        env.step(action)
    assert env.state[0] > start
    for _ in range(1100):
        env.step(np.array([0.045 / 0.3], np.float32))
    assert env.state[1] == 0


def test_design_model_is_the_middle_of_the_training_ranges():
    design = design_model()
    for name, (low, high) in TRAIN_RANGES.items():
        unknown_phase = name in ("friction_variation", "torque_ripple", "kinematic_error") or name.endswith("_phase")
        assert getattr(design, name) == (0.0 if unknown_phase else pytest.approx(0.5 * (low + high)))


def test_whole_numbers_are_drawn_with_equal_shares():
    env = BeltArmVectorEnv(2000, randomization="train")
    env.reset(seed=0)
    orders, counts = np.unique(env.params_table[:, COLUMN.torque_ripple_order], return_counts=True)
    assert orders.tolist() == list(range(4, 13))
    assert (np.abs(counts / 2000 - 1 / 9) < 0.03).all()


def test_a_ripple_between_whole_numbers_is_refused_in_the_middle_of_a_batch():
    env = BeltArmVectorEnv(3)
    with pytest.raises(ValueError, match=r"torque_ripple_order must be a whole number, got 5\.5"):
        env.reset(options={"params": {"torque_ripple_order": [4.0, 5.5, 8.0]}})


def test_words_for_the_ranges():
    for word, ranges in (("off", {}), ("ideal", IDEAL_RANGES), ("train", TRAIN_RANGES)):
        env = BeltArmVectorEnv(50, randomization=word)  # pyright: ignore[reportArgumentType]
        env.reset(seed=0)
        varied = {name for name, column in zip(FIELDS, env.params_table.T, strict=True) if np.ptp(column) > 0}
        assert varied == set(ranges)
