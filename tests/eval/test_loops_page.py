"""The page of the classical controllers: what it measures, and that the command writes it."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from commands import mistake, stopped
from eval.report.budgets import ModelSteps, budgets, model_steps

from baselines import CONTROLLERS, TUNABLE
from baselines.estimation import arm_ekf
from baselines.gains import read_file, tuned, write_entry
from baselines.loops.condition import least_margins
from beltarm_env.arm import COLUMN, FIELDS
from beltarm_env.rollout import rollout
from beltarm_env.task.ranges import TRAIN_RANGES
from beltarm_env.task.seeds import LOOPS
from eval import baselines
from eval.comparison.methods import shipped_policies
from eval.loops import price as prices
from eval.loops.changes import CHANGES, LIMITS
from eval.loops.costs import blind, built_arms, run_arms
from eval.loops.gains import gains_table
from eval.loops.identification import worth
from eval.loops.scan import scan

SEEDS = len([folder for folder in shipped_policies() if folder.parent.name == "student"])


class TestScan:
    def test_its_worst_is_what_the_condition_asks_about(self):
        found, least = scan(CONTROLLERS["ei"]()), least_margins(CONTROLLERS["ei"]())
        for name in ("modulus", "delay"):
            value, arm, degrees = found.worst(name)
            assert (value, f"{arm}, {degrees:.0f}°") == (getattr(least, name), getattr(least, f"{name}_at"))
        assert found.over_arms("modulus").min() == least.modulus

    def test_an_unstable_loop_has_no_margins(self):
        found = scan(CONTROLLERS["paper"]())
        unstable = ~found.margins.stable
        assert unstable.any()
        assert np.all(found.margins.modulus[unstable] == 0)
        assert np.all(found.margins.gain_up[unstable] == 1)
        assert any(poles.real.max() > 0 for poles in found.poles) == unstable[0].any()


class TestChanges:
    def test_a_change_sets_its_constants_and_nothing_else(self):
        table = built_arms(3)
        for change in CHANGES:
            differ = {FIELDS[k] for k in np.flatnonzero((change.applied(table) != table).any(axis=0))}
            assert differ <= set(change.constants)
            for name, value in change.constants.items():
                assert np.all(change.applied(table)[:, getattr(COLUMN, name)] == value)

    def test_limits_lie_beyond_the_training_ranges(self):
        for change in LIMITS:
            ((name, value),) = change.constants.items()
            low, high = TRAIN_RANGES[name]
            assert not low <= value <= high

    def test_arms_as_built_run_as_the_environment_draws_them(self):
        controller = CONTROLLERS["zv"]()
        drawn = rollout(controller, 3, seed=LOOPS.first, randomization="train")
        np.testing.assert_array_equal(run_arms(blind(controller), built_arms(3)).cost, drawn.cost)


class TestPrice:
    @pytest.fixture
    def file(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
        monkeypatch.setattr(prices, "WITHOUT", tmp_path / "without.json")
        return tmp_path / "without.json"

    def test_the_same_gains_cost_the_same(self, file: Path):
        write_entry("zv", tuned("zv", TUNABLE["zv"].gains), read_file()["zv"]["provenance"], file)
        kept = run_arms(blind(CONTROLLERS["zv"]()), built_arms(3)).cost
        found = prices.price("zv", kept)
        assert found is not None
        np.testing.assert_array_equal(found.free, kept)

    def test_gains_of_another_law_or_search_have_none(self, file: Path):
        same = read_file()["zv"]["provenance"]
        write_entry("zv", tuned("ei", TUNABLE["ei"].gains), same, file)
        assert prices.price("zv", np.ones(3)) is None
        write_entry("zv", tuned("zv", TUNABLE["zv"].gains), {**same, "budget": same["budget"] + 1}, file)
        assert prices.price("zv", np.ones(3)) is None
        assert prices.price("ei", np.ones(3)) is None
        assert prices.price("paper", np.ones(3)) is None

    def test_the_file_has_gains_that_were_found_without_margins(self):
        entries = read_file(prices.WITHOUT)
        assert {"adaptive", "preview", "mpc"} <= set(entries)
        assert all(entry["provenance"]["margins"] == "not asked for" for entry in entries.values())


def test_identification_is_beside_the_best_that_does_not():
    costs = {"ei": np.full(4, 100.0), "zv": np.full(4, 300.0), "adaptive": np.array([100.0, 119.0, 121.0, 90.0])}
    same, best = worth(costs)
    assert (best.title, best.worse, best.worst) == ("`ei`", 1, 1.21)
    assert same.title == "`adaptive` with nothing identified"
    assert np.all(same.other > 0)
    assert worth({"ei": np.ones(4)}) == []


ROOT = Path(__file__).resolve().parents[2]
COUNTED = """
import sys
from baselines.estimation import believed_motion
from baselines.optimal.adaptive import AdaptiveController
from baselines.registry import CONTROLLERS
from beltarm_env import BeltArmVectorEnv
from beltarm_env.kernels import simulate
from beltarm_env.task.seeds import LOOPS

steps = 0


def counted(module, function):
    whole = getattr(module, function)

    def call(block, work, actions, count, model):
        global steps
        steps += count
        whole(block, work, actions, count, model)

    setattr(module, function, call)


counted(believed_motion, "advance_built_block")
counted(simulate, "advance_driven_block")
counted(simulate, "advance_block")
controller = CONTROLLERS[sys.argv[1]]()
if isinstance(controller, AdaptiveController):
    controller = AdaptiveController(controller.gains, improvements=0)
env = BeltArmVectorEnv(1, randomization="train")
observation, memory = env.reset(seed=LOOPS.first)[0], None
for _ in range(int(sys.argv[2])):
    action, memory = controller.predict(observation, memory)
    observation = env.step(action)[0]
print(steps)
"""
"""Counts the arms that a controller's model simulates in some actions, in plain Python."""


class TestBudgets:
    def test_every_controller_states_what_its_model_simulates(self):
        for name in CONTROLLERS:
            assert model_steps(CONTROLLERS[name]()), f"{name}: add its type to MODEL_STEPS in eval/report/budgets.py"

    @pytest.mark.parametrize("name", ["zv", "lqg", "preview", "adaptive"])
    def test_that_is_what_it_simulates(self, name: str):
        actions, stated = 6, model_steps(CONTROLLERS[name]())
        assert stated is not None
        plain = {**os.environ, "NUMBA_DISABLE_JIT": "1"}  # so that calls within kernels can be counted
        done = subprocess.run(
            [sys.executable, "-c", COUNTED, name, str(actions)], capture_output=True, text=True, cwd=ROOT, env=plain
        )
        assert done.returncode == 0, done.stderr
        assert stated.simulated * (actions - 2) <= int(done.stdout) <= stated.simulated * actions

    def test_methods_stand_side_by_side(self):
        found = {of.name: of for of in budgets(("rigid", "zv"))}
        assert list(found)[:2] == ["rigid", "zv"]
        assert {of.kind for of in found.values()} == {"classical", "learned"}
        assert found["zv"].samples == read_file()["zv"]["provenance"]["steps"]
        assert found["rigid"].samples == 0
        assert found["student"].runs == SEEDS
        assert found["student"].steps == model_steps(CONTROLLERS["adaptive"]())
        assert found["ppo"].steps == ModelSteps(2 + arm_ekf.DIFFERENCED, 0)


@pytest.mark.slow
def test_the_command_writes_the_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    shown = ("paper", "ei", "adaptive")
    code, errors = stopped(baselines.main, (*shown, "--arms", "8", "--batch", "2", "--out", "out"), tmp_path)
    assert code == 0, errors
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {"summary.md", "margins.png", "poles.png", "breaks.png"}
    page = (tmp_path / "out" / "summary.md").read_text(encoding="utf-8")
    tables = {part.split("\n")[0]: part for part in page.split("\n## ")}
    for name in shown:
        assert f"\n### {name}\n" in tables["Each controller"]
        for title in ("At a glance", "Linear loops", "Costs", "Time", "Budgets on equal terms"):
            assert f"\n| {name} | " in tables[title], title
    for change in CHANGES:
        assert f"\n| {change.title} | " in tables["Where each breaks"]
    assert f"\n| student | {SEEDS} | " in tables["Budgets on equal terms"]
    assert tables["What identification is worth"].count(" of 8 | ×") == 2
    assert "nan" not in page
    printed = capsys.readouterr().out
    assert all(f"\n| {name} | " in printed for name in shown)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("adaptve",), "no controller 'adaptve' to show; did you mean 'adaptive'?"),
        (("--arms", "7"), "--arms must lie within 8 and 10000, got 7"),
        (("--batch", "0"), "--batch must lie within 1 and 100000, got 0"),
        (("--out", "/dev/null/x"), "cannot write to /dev/null/x"),
    ],
)
def test_bad_options(arguments: tuple[str, ...], message: str, tmp_path: Path):
    assert message in mistake(baselines.main, arguments, tmp_path)


def test_gains_of_a_tree_that_was_not_committed_are_said_to_be():
    """On the page of the gains, for each controller, and where the file of gains is documented."""
    entries = read_file()
    unclean = {name for name, entry in entries.items() if entry["provenance"]["commit"].endswith("-dirty")}
    page, guide = (
        (ROOT / "docs" / name).read_text(encoding="utf-8")
        for name in ("results/loops/summary.md", "science/controllers.md")
    )
    for name in entries:
        origin = gains_table(name).splitlines()[-1]
        assert ("not committed" in origin) == (name in unclean)
        assert origin in page
    (named,) = re.findall(r"For ((?:`[a-z]+`[, and\n]*)+) that commit ends in `-dirty`", guide)
    assert set(re.findall(r"`([a-z]+)`", named)) == unclean
