from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from commands import mistake

from baselines import PaperController, tuned_controller
from baselines.optimal.mpc import MpcController
from baselines.oracle import main
from baselines.yardsticks.clairvoyant import optimum
from baselines.yardsticks.oracle import FILE, METRICS, Scenario, read_file, replay, run
from beltarm_env import EPISODE_STEPS, ArmParams
from beltarm_env.task.reference import MoveShape


@pytest.fixture(scope="module")
def stored():
    return read_file()


def test_replayed_torques_cost_what_is_stored(stored):
    contents, scenarios, actions = stored
    metrics = replay(scenarios, actions).metrics()
    for name in METRICS:
        np.testing.assert_allclose([row[name] for row in contents["scenarios"]], metrics[name], rtol=1e-3, atol=1e-3)


def test_optimisers_figure_is_that_of_the_environment(stored):
    contents, _, _ = stored
    for row in contents["scenarios"]:
        assert row["optimiser_cost"] == pytest.approx(row["cost"], rel=1e-6)
        assert row["cost"] < row["privileged_cost"]


def test_scenarios_are_those_of_their_seeds(stored):
    for scenario in stored[1]:
        assert Scenario.parse(f"{scenario.kind}:{scenario.seed}") == scenario


def test_no_controller_costs_less(stored):
    contents, scenarios, _ = stored
    least = np.array([row["cost"] for row in contents["scenarios"]])
    for controller in (PaperController(), MpcController(), tuned_controller("adaptive")):
        assert (least < run(controller, scenarios).cost).all()


def test_stored_file_is_small():
    assert FILE.stat().st_size < 200_000
    assert "baselines/oracle.py" in json.loads(FILE.read_text())["command"]


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
        found = optimum(ArmParams(), move, np.full(120, share))
        assert found.cost == pytest.approx(60.6444, rel=1e-4)
        assert costs_of_beginnings(Scenario("nominal", 0, ArmParams(), move), found.actions[None]) == pytest.approx(
            found.cost, rel=1e-9
        )


def test_a_drive_is_met_as_it_is_built():
    """With stick and slip, latency and all, the cost is that of the replay, and torques nearby cost more."""
    scenario, rng = Scenario.parse("train:5000004"), np.random.default_rng(0)
    found = optimum(scenario.params, scenario.move, np.full(120, 0.5))
    knots = rng.normal(0, 1, (60, 13)) * np.logspace(-4, -1, 60)[:, None]
    nearby = [found.actions + np.interp(np.arange(120), np.arange(0, 130, 10), row) for row in knots]
    costs = costs_of_beginnings(scenario, np.clip([found.actions, *nearby], -1, 1))
    assert costs[0] == pytest.approx(found.cost, rel=1e-9)
    assert costs[1:].min() > 0.999 * found.cost


def test_unknown_scenario_is_one_line(tmp_path: Path):
    line = mistake(main, ("--scenario", "test:3"), tmp_path)
    assert line == "baselines/oracle.py: --scenario must be nominal:SEED, ideal:SEED or train:SEED, got 'test:3'"
