"""Oracles, which know their arm: stored optimal episodes, a short problem against IPOPT, the privileged controller."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from commands import mistake

from baselines import PaperController, tuned_controller
from baselines.optimal.adaptive import AdaptiveController
from baselines.optimal.mpc import MpcController
from baselines.oracle import main
from baselines.yardsticks.clairvoyant import optimum
from baselines.yardsticks.oracle import FILE, METRICS, Scenario, read_file, replay, run
from baselines.yardsticks.privileged import PrivilegedController
from beltarm_env import EPISODE_STEPS, ArmParams, BeltArmVectorEnv, observation
from beltarm_env.rollout import rollout
from beltarm_env.task.reference import MoveShape


@pytest.fixture(scope="module")
def stored():
    return read_file()


def test_replayed_torques_cost_what_is_stored(stored):
    contents, scenarios, actions = stored
    metrics = replay(scenarios, actions).metrics()
    for name in METRICS:
        np.testing.assert_allclose([row[name] for row in contents["scenarios"]], metrics[name], rtol=1e-3, atol=1e-3)
    assert FILE.stat().st_size < 200_000 and "baselines/oracle.py" in contents["command"]
    for scenario in scenarios:
        assert Scenario.parse(f"{scenario.kind}:{scenario.seed}") == scenario


def test_no_controller_costs_less(stored):
    contents, scenarios, _ = stored
    least = np.array([row["cost"] for row in contents["scenarios"]])
    assert [row["optimiser_cost"] for row in contents["scenarios"]] == pytest.approx(least, rel=1e-6)
    assert (least < [row["privileged_cost"] for row in contents["scenarios"]]).all()
    for controller in (PaperController(), MpcController(), tuned_controller("adaptive")):
        assert (least < run(controller, scenarios).cost).all()


def costs_of_beginnings(scenario: Scenario, actions: np.ndarray) -> np.ndarray:
    """Costs of the first T samples of n episodes, replayed, under actions of shape (n, T)."""
    steps = actions.shape[1]
    whole = np.zeros((len(actions), EPISODE_STEPS), np.float32)
    whole[:, :steps] = actions
    replayed = replay([scenario] * len(actions), whole)
    tip, speed = (
        np.linalg.norm(e[:steps], axis=2).sum(axis=0) for e in (replayed.tip_error, replayed.tip_velocity_error)
    )
    change = np.abs(np.diff(whole[:, :steps].astype(np.float64), prepend=0)).sum(axis=1)
    return tip / 0.01 + speed / 0.2 + 0.1 * change


def test_a_short_problem_ends_at_the_least_cost_from_anywhere():
    """An independent nonlinear program of this problem, multiple shooting with IPOPT, came to 60.6444."""
    move = MoveShape(0.8, 1.2, 0.6, 0.15)
    for share in (0.3, 1.0):
        actual = optimum(ArmParams(), move, np.full(120, share))
        assert actual.cost == pytest.approx(60.6444, rel=1e-4)
        assert costs_of_beginnings(Scenario("nominal", 0, ArmParams(), move), actual.actions[None]) == pytest.approx(
            actual.cost, rel=1e-9
        )


def test_a_drive_is_met_as_it_is_built():
    """With stick and slip, latency and all, the cost is that of the replay, and torques nearby cost more."""
    scenario, rng = Scenario.parse("train:5000004"), np.random.default_rng(0)
    actual = optimum(scenario.params, scenario.move, np.full(120, 0.5))
    knots = rng.normal(0, 1, (60, 13)) * np.logspace(-4, -1, 60)[:, None]
    nearby = [actual.actions + np.interp(np.arange(120), np.arange(0, 130, 10), row) for row in knots]
    costs = costs_of_beginnings(scenario, np.clip([actual.actions, *nearby], -1, 1))
    assert costs[0] == pytest.approx(actual.cost, rel=1e-9)
    assert costs[1:].min() > 0.999 * actual.cost


def test_unknown_scenario_is_one_line(tmp_path: Path):
    assert "--scenario" in mistake(main, ("--scenario", "test:3"), tmp_path)


def test_the_privileged_controller_costs_less_and_knows_its_own_arms_alone():
    env = BeltArmVectorEnv(30, autoreset_mode="Disabled", randomization="ideal")
    env.reset(seed=5_000_000)
    oracle = PrivilegedController(env.params)
    cost = rollout(oracle, 30, seed=5_000_000, randomization="ideal", sensors="full").cost.mean()
    assert cost < rollout(AdaptiveController(), 30, seed=5_000_000, randomization="ideal").cost.mean()
    with pytest.raises(ValueError, match="sensors='full'"):
        oracle.predict(np.zeros((30, observation.size()), np.float32))
    with pytest.raises(ValueError, match=r"30 arms.* 4"):
        oracle.predict(np.zeros((4, observation.size("full")), np.float32))
