"""The study of the accelerometer: with it the filter knows the torsion better, and the arm vibrates less."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from baselines.registry import FELT
from eval.comparison.sets import development_set
from eval.studies.sensors import TIERS, Outcome, outcome, student_folder


@cache
def both(name: str) -> tuple[Outcome, Outcome]:
    split = development_set().splits["randomized"]
    without, with_it = (outcome(name, tier, split, 16) for tier in TIERS)
    return without, with_it


@pytest.mark.parametrize(("name", "most"), [("adaptive", 0.4), ("preview", 0.6)])
def test_a_filter_with_the_accelerometer_knows_the_torsion_better(name: str, most: float):
    without, with_it = both(name)
    assert with_it.torsion < most * without.torsion


@pytest.mark.parametrize("name", FELT)
def test_the_arm_vibrates_less(name: str):
    without, with_it = (result.metrics for result in both(name))
    assert np.median(with_it["cost"] - without["cost"]) < 0
    assert with_it["residual_pp_mm"].mean() < 0.9 * without["residual_pp_mm"].mean()


def test_students_are_of_the_sensors_that_they_are_compared_for():
    assert student_folder("encoder") != student_folder("accelerometer")
