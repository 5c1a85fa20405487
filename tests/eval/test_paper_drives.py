"""The paper's servo on the drive as it is built, with few drives."""

from __future__ import annotations

import numpy as np
import pytest

from beltarm_env.arm import COLUMN, DRIVE_EFFECTS
from eval.comparison.effects import ALL, IDEAL
from eval.reproduction.assumptions import USUAL_MOVE
from eval.reproduction.drive_page import drive_markdown, verdict
from eval.reproduction.drives import DRIVES, DrivesStudy, run_drives
from eval.reproduction.loop import ServoGains
from eval.reproduction.ringing import suppression
from eval.reproduction.runs import ANALYSED, SIMULATED, run_moves
from eval.reproduction.study import AS_ANALYSED, FRICTION, MAIN, STANDARD, TO_0


@pytest.fixture(scope="module")
def study() -> DrivesStudy:
    return run_drives(ServoGains(), USUAL_MOVE, draws=2)


@pytest.mark.parametrize("view", MAIN)
def test_on_the_ideal_drive_it_is_the_ringing_of_the_other_pages(study: DrivesStudy, view: str):
    moves = list(study.moves.values())
    expected = suppression(MAIN[view], study.gains, moves)
    for k, place in enumerate((STANDARD, TO_0)):
        found = study.found[place, view, IDEAL].ringing
        for of_gain, of_other in zip(found, expected, strict=True):
            for phase, other in zip(of_gain, of_other, strict=True):
                np.testing.assert_array_equal(phase, other[k])


def test_every_effect_changes_the_motion(study: DrivesStudy):
    """But for those of Coulomb friction where there is none: there, only by rounding."""
    without_friction = {"static_friction_excess", "friction_variation"}
    for place, view, drive in study.found:
        swings, ideal = (study.found[place, view, which].swings for which in (drive, IDEAL))
        same = bool(np.abs(swings.suppressed - ideal.suppressed).max() < 1e-5)
        assert same == (drive == IDEAL or (view == AS_ANALYSED and drive in without_friction)), (place, view, drive)


def test_drives_differ_by_what_is_drawn(study: DrivesStudy):
    swings = study.found[STANDARD, FRICTION, ALL].swings
    assert not np.array_equal(swings.without[:, 0], swings.without[:, 1])


def test_the_servo_takes_given_arms_for_that_of_the_conditions():
    rows = np.tile(SIMULATED.arm.row(), (2, 1))
    rows[1, COLUMN.torque_constant_error] = 0.1
    run = run_moves(SIMULATED, ServoGains(), [USUAL_MOVE] * 2, rows)
    alone = run_moves(SIMULATED, ServoGains(), [USUAL_MOVE])
    np.testing.assert_array_equal(run.torque[:, 0], alone.torque[:, 0])
    assert not np.array_equal(run.torque[:, 1], alone.torque[:, 0])
    np.testing.assert_array_equal(run.params, rows)


def test_the_page_has_every_drive_and_says_what_becomes_of_the_conclusion(study: DrivesStudy):
    page = drive_markdown(study)
    assert page.count("| ideal | ") == page.count("| all | ") == len(study.moves) * len(MAIN)
    assert len(DRIVES) == len(DRIVE_EFFECTS) + 2
    assert verdict(study) in page and "the conclusion" in verdict(study)
    assert ANALYSED.arm.coulomb_friction == 0
