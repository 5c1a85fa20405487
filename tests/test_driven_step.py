"""Pieces of the integration behind a drive as it is built, each against a closed form."""

import math

import numpy as np
import pytest

from beltarm_env import ArmParams
from beltarm_env.physics.drive import angles_near, angles_of, belt_stiffness, decay, drive_of, turned
from beltarm_env.physics.driven import Margin, driven_step, exit_fraction, first_slope, lag_of, leaves_mode, step_length
from beltarm_env.physics.models import LUMPED
from beltarm_env.physics.state import ArmState
from beltarm_env.physics.trigonometry import wrapped
from beltarm_env.task.ranges import DRIVE_RANGES

PARAMS = ArmParams(**{name: high for name, (_, high) in DRIVE_RANGES.items()})
PLANT, DRIVE = PARAMS.plant(), drive_of(PARAMS.row())


@pytest.mark.parametrize("ratio", [0.0, 1e-9, 0.3, 1.0, 7.5, 20.0, 39.0])
def test_decay_is_an_exponential(ratio: float):
    assert decay(ratio) == pytest.approx(math.exp(-ratio), rel=3e-14 if ratio < 10 else 1e-7)


def test_decay_of_a_long_time_is_nothing():
    assert 0 <= decay(1e9) < 1e-17


@pytest.mark.parametrize("angle", [0.0, 3.0, -3.0, 7.0, 1234.5, -2000.0])
def test_wrapped_leaves_out_whole_turns(angle: float):
    assert abs(wrapped(angle)) <= math.pi + 1e-12
    assert math.cos(wrapped(angle)) == pytest.approx(math.cos(angle), abs=1e-12)
    assert math.sin(wrapped(angle)) == pytest.approx(math.sin(angle), abs=1e-12)


def test_angles_turn_with_the_motor():
    x = ArmState(61.0, 100.0, 0.02, 0.5)
    for turn in (0.0, 0.05, -0.1):
        there = angles_of(ArmState(61.0 + turn, 100.0, 0.02 + turn / 88, 0.5), PLANT, DRIVE)
        np.testing.assert_allclose(turned(angles_of(x, PLANT, DRIVE), turn, DRIVE), there, atol=1e-12)


def test_angles_nearby_are_right_to_the_fourth_order():
    x, errors = ArmState(61.0, 100.0, 0.02, 0.5), []
    for motor in (0.004, 0.002):
        moved = angles_of(ArmState(61.0 + motor, 100.0, 0.02, 0.5), PLANT, DRIVE)
        near = angles_near(angles_of(x, PLANT, DRIVE), motor / 88, motor, DRIVE)
        errors.append(np.abs(np.array(near) - np.array(moved)).max())
    assert errors[0] < (12 * 0.004) ** 4 / 24
    assert errors[0] / errors[1] == pytest.approx(16, rel=0.1)


def test_belt_stiffness_is_the_mean_at_its_knee_and_the_tangent_a_derivative():
    def torque(torsion: float) -> float:
        return belt_stiffness(torsion**2 / (torsion**2 + DRIVE.knee), PLANT, DRIVE)[0] * torsion

    assert torque(0.01) == pytest.approx(33 * 0.01)
    assert torque(1e-6) == pytest.approx(33 * 0.75 * 1e-6)
    for torsion in (0.0, 0.004, 0.02, -0.03):
        _, tangent = belt_stiffness(torsion**2 / (torsion**2 + DRIVE.knee), PLANT, DRIVE)
        assert tangent == pytest.approx((torque(torsion + 1e-6) - torque(torsion - 1e-6)) / 2e-6, rel=1e-6)


@pytest.mark.parametrize("time", [1e-4, 1e-3])
def test_a_step_over_many_time_constants_is_as_exact_as_many_short_ones(time: float):
    def after(steps: int) -> ArmState:
        x, torque = ArmState(61.0, 60.0, 0.01, 0.3), -0.05
        for _ in range(steps):
            at = angles_of(x, PLANT, DRIVE)
            lag = lag_of(torque, 0.05, time, 1 / time, 1.0, at, PLANT, LUMPED)
            k1 = first_slope(x, at, lag, 1.0, PLANT, DRIVE, LUMPED)
            step = driven_step(x, at, k1, lag, 1.0, 7.5e-4 / steps, PLANT, DRIVE, LUMPED)
            x, torque = step.state, step.torque
        assert torque == pytest.approx(0.05 - 0.1 * math.exp(-7.5e-4 / time), rel=1e-12)
        return x

    assert np.abs(np.array(after(1)) - np.array(after(64)))[1] < 2e-5  # rad/s, of 60


def test_margins_that_dip_below_zero_and_come_back_are_found():
    dips = Margin(1.0, -6.0, 6.0, 0.0, 0.0, 0.0)  # 1 - 6 u + 6 u^2: below zero between 0.211 and 0.789
    assert leaves_mode(dips, 1.0)
    assert exit_fraction(dips) == pytest.approx(0.5 - math.sqrt(3) / 6, rel=1e-9)
    stays = Margin(2.0, -6.0, 6.0, 0.0, 0.0, 0.0)  # lowest 0.5
    assert exit_fraction(stays) == 1.0


def test_the_root_of_a_margin_with_an_exponential():
    falls = Margin(-0.5, 0.0, 0.0, 0.0, 1.0, 4.0)  # e^(-4 u) - 0.5
    assert leaves_mode(falls, math.exp(-4))
    assert exit_fraction(falls) == pytest.approx(math.log(2) / 4, rel=1e-9)


def test_steps_divide_what_remains():
    assert step_length(1.5e-3, 0.0, 1.0) == (1.5e-3, 1.0)
    assert step_length(1.5e-3, 1000.0, 1.0) == (0.75e-3, 2.0)
    assert step_length(0.75e-3, 0.0, 4.0) == (0.375e-3, 2.0)
    assert step_length(1.5e-3, 1000.0, 2.0) == (0.375e-3, 4.0)
