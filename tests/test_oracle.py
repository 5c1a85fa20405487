from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from commands import mistake

from baselines import PaperController
from baselines.optimal.mpc import MpcController
from baselines.oracle import main
from baselines.yardsticks.oracle import FILE, METRICS, Scenario, read_file, replay
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.physics.integrator import rk4_step
from beltarm_env.physics.models import LUMPED
from beltarm_env.physics.state import ArmState
from beltarm_env.rollout import rollout
from beltarm_env.task.reference import MoveShape

ROOT = Path(__file__).resolve().parent.parent


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
        assert row["converged"] and 0 < row["gap"] < 2  # norms are smooth by 0.001: at most 2.4 over an episode
        assert row["gap"] == pytest.approx(row["optimiser_cost"] - row["cost"], abs=1e-3)


def test_scenarios_are_those_of_their_seeds(stored):
    for scenario in stored[1]:
        assert Scenario.parse(f"{scenario.kind}:{scenario.seed}") == scenario


def test_no_controller_costs_less(stored):
    contents, scenarios, _ = stored
    controllers = PaperController(), MpcController()
    for kind, randomization in (("nominal", "off"), ("train", "train")):
        least = [row["cost"] for row in contents["scenarios"] if row["kind"] == kind]
        seeds = [s.seed for s in scenarios if s.kind == kind]
        assert seeds == list(range(seeds[0], seeds[0] + len(seeds)))
        for controller in controllers:
            cost = rollout(controller, len(seeds), seed=seeds[0], randomization=randomization).cost
            assert (least < cost).all()


def test_stored_file_is_small():
    assert FILE.stat().st_size < 200_000
    assert "baselines/oracle.py" in json.loads(FILE.read_text())["command"]


def test_traced_equations_are_the_compiled_ones():
    pytest.importorskip("casadi")
    from baselines.yardsticks.clairvoyant import plain

    plant = ArmParams().plant()
    state = ArmState(50.0, 100.0, 0.01, 0.2)
    traced = plain(rk4_step)(state, 0.1, 1.0, CONTROL_PERIOD, plant, LUMPED)
    assert tuple(traced) == tuple(rk4_step(state, 0.1, 1.0, CONTROL_PERIOD, plant, LUMPED))


def test_a_short_problem_is_solved_and_replayed():
    pytest.importorskip("casadi")
    from baselines.yardsticks.clairvoyant import optimum

    steps, move = 120, MoveShape(0.8, 1.2, 0.6, 0.15)
    found = optimum(ArmParams(), move, steps)
    assert found.converged and (found.modes == 1).all()
    actions = np.zeros((1, 1200), np.float32)
    actions[0, :steps] = found.torque / 0.3
    run = replay([Scenario("nominal", 0, ArmParams(), move)], actions)
    tip, speed = (np.linalg.norm(e[:steps, 0], axis=1).sum() for e in (run.tip_error, run.tip_velocity_error))
    change = np.abs(np.diff(actions[0, :steps], prepend=0)).sum()
    cost = tip / 0.01 + speed / 0.2 + 0.1 * change
    assert found.cost - 0.24 < cost <= found.cost + 1e-3  # the norms are smooth by 0.001


def test_an_arm_without_friction_is_refused():
    pytest.importorskip("casadi")
    from baselines.yardsticks.clairvoyant import optimum

    with pytest.raises(ValueError, match="coulomb_friction must be positive"):
        optimum(ArmParams(coulomb_friction=0.0), MoveShape(0.8, 1.2, 0.6, 0.15))


def test_missing_casadi_is_one_line():
    start = "import runpy, sys; sys.modules['casadi'] = None; "
    start += f"runpy.run_path({str(ROOT / 'baselines/oracle.py')!r}, run_name='__main__')"
    command = [sys.executable, "-c", start]
    result = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert result.returncode == 2
    assert result.stderr == "baselines/oracle.py: casadi is not installed; run `pip install -e '.[oracle]'`\n"


def test_unknown_scenario_is_one_line(tmp_path: Path):
    pytest.importorskip("casadi")
    line = mistake(main, ("--scenario", "test:3"), tmp_path)
    assert line == "baselines/oracle.py: --scenario must be nominal:SEED or train:SEED, got 'test:3'"
