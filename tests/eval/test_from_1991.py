"""What each step brings: the chain, and `eval/from_1991.py` as a user runs it."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from commands import mistake, stopped
from eval.studies.steps.study import ADVANCES, BESIDE, measure

from baselines import CONTROLLERS
from baselines.optimal.adaptive import AdaptiveController
from beltarm_env.metrics import TORQUE_QUALITY, heading
from beltarm_env.rollout import rollout
from beltarm_env.task.seeds import LOOPS
from eval import from_1991
from eval.comparison.statistics import worst_mean


def test_the_last_of_the_identifications_is_adaptive_as_it_is_shipped():
    shipped = rollout(CONTROLLERS["adaptive"](), 4, seed=LOOPS.first, randomization="train")
    np.testing.assert_array_equal(measure(ADVANCES[-2], 4).metrics["cost"], shipped.metrics()["cost"])


def test_what_is_held_stays_at_the_design_model():
    assert BESIDE.make is not None
    controller = BESIDE.make()
    assert isinstance(controller, AdaptiveController)
    run = rollout(controller, 3, seed=LOOPS.first, randomization="train")
    assert run.finished.all()
    env_costs = measure(BESIDE, 3).metrics["cost"]
    np.testing.assert_array_equal(env_costs, run.metrics()["cost"])


def test_worst_is_the_mean_of_a_twentieth():
    assert worst_mean(np.arange(40.0)) == 38.5
    assert worst_mean(np.arange(4.0)) == 3.0


@pytest.mark.slow
def test_the_command_writes_the_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    code, errors = stopped(from_1991.main, ("--arms", "4", "--out", "out"), tmp_path)
    assert code == 0, errors
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"summary.md", "waterfall.png"}
    page = (tmp_path / "out" / "summary.md").read_text(encoding="utf-8")
    assert not re.search(r"\b(nan|inf)\b", page)
    rows = [line for line in page.splitlines() if line.startswith("|")]
    assert len(rows) == 2 + len(ADVANCES) + 1
    assert all(heading(name) in rows[0] for name in TORQUE_QUALITY)


def test_too_few_arms_are_a_mistake(tmp_path: Path):
    line = mistake(from_1991.main, ("--arms", "3"), tmp_path)
    assert line.startswith("eval/from_1991.py: ") and "arms" in line
