"""The study of repeated moves: learning lowers the cost, the textbook's moves the motor alone, and kinds are splits."""

from __future__ import annotations

import numpy as np
import pytest

from baselines import PaperController
from baselines.iterative.controller import IterativeController
from baselines.iterative.motor_learning import MotorLearningController
from beltarm_env import BeltArmEnv, BeltArmVectorEnv
from beltarm_env.arm import FIELDS, params_table
from beltarm_env.rollout import rollout
from eval.comparison.splits import SPLITS
from eval.studies.iterative import KINDS, metrics_of, repeated

SEED = 4_200_000


def test_cost_falls_from_repetition_to_repetition():
    costs = [run["cost"].mean() for run in repeated(IterativeController, 6, 4, seed=SEED, randomization="ideal")]
    assert costs[1] < 0.95 * costs[0]
    assert (np.diff(costs) < 0.01 * costs[0]).all()


@pytest.mark.slow
def test_runs_are_reproducible():
    first, again = (repeated(IterativeController, 2, 3, seed=SEED, randomization="ideal") for _ in range(2))
    for ours, theirs in zip(first, again, strict=True):
        assert all((ours[name] == theirs[name]).all() for name in ours)


def test_textbook_learning_moves_the_motor_and_not_the_tip():
    runs = repeated(MotorLearningController, 6, 4, seed=SEED, randomization="ideal")
    motor = [run["motor_rms_mrad"].mean() for run in runs]
    assert (np.diff(motor) < 0).all() and motor[-1] < 0.05 * motor[0]
    assert runs[-1]["residual_pp_mm"].mean() > 0.8 * runs[0]["residual_pp_mm"].mean()


def test_the_motors_error_is_that_of_the_joint():
    run = rollout(PaperController(), 2, seed=SEED, randomization="ideal")
    env = BeltArmEnv(randomization="ideal")
    env.reset(seed=SEED)
    wanted = [env.reference(t).angle for t in run.time]
    expected = 1e3 * np.sqrt(np.mean((run.state[:, 0, 0] / 88 - wanted) ** 2))
    assert metrics_of(run)["motor_rms_mrad"][0] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_arms_vary_as_in_the_split_of_the_same_name(kind: str):
    env = BeltArmVectorEnv(64, randomization=KINDS[kind])  # pyright: ignore[reportArgumentType]
    env.reset(seed=SEED)
    table = params_table(env.params)
    varying = {name for name, values in zip(FIELDS, table.T, strict=True) if np.ptp(values)}
    assert varying == set(SPLITS[kind].ranges)
    for name, (low, high) in SPLITS[kind].ranges.items():
        values = table[:, FIELDS.index(name)]
        assert low <= values.min() and values.max() <= high, name
