"""The study of the guard: faulty arms, and comparisons with the base alone."""

from __future__ import annotations

import numpy as np
import pytest

from baselines import PaperController
from beltarm_env.rollout import record
from eval.studies.guard import NAN, Options, measure, tables, worse_measures
from eval.studies.guard.faults import FaultyArms


def test_an_unknown_fault_is_refused():
    with pytest.raises(ValueError, match="'rust'"):
        FaultyArms(1, "rust")


def test_an_arm_that_leaves_changes_nothing_for_the_others():
    few, many = (
        record(PaperController(), FaultyArms(arms, "sign error", randomization="train"), seed=5) for arms in (2, 8)
    )
    assert not many.finished[2:].all()
    np.testing.assert_array_equal(few.state, many.state[:, :2])


def test_measures_beyond_the_margin_are_named():
    base = {"peak": 10.0, "left": 0.0, "energy": 1.0, "passive": 0.0}
    guarded = {"peak": 11.5, "left": 2.0, "energy": 1.1, "passive": 0.0}
    row = {"controller": "ppo", "fault": "payload", "base": base, "without": base, "guarded": guarded}
    assert worse_measures(row) == ["peak", "left"]
    assert worse_measures(row | {"guarded": base}) == []
    facts = tables({"rows": [row], "bases": {"ppo": "paper"}, "healthy": []})
    assert facts["comparisons"] == 3 and [key for _, key in facts["worse"]] == ["peak", "left"]


def test_a_classical_controller_is_its_own_base_and_has_no_weights():
    quick = Options(controllers=("preview",), faults=("payload", NAN), splits=("nominal",), arms=1, episodes=4, jobs=1)
    (row,) = measure(quick)["rows"]
    assert row["fault"] == "payload" and row["base"] == row["without"]
