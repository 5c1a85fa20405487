"""The law of friction and what a drive couples, each at one state, against what the equations say in words."""

import math
from typing import Any

import pytest

from beltarm_env import ArmParams
from beltarm_env.physics.drive import (
    angles_of,
    belt_motion,
    belt_torque_rate,
    coupling,
    drive_of,
    resting,
    transmission,
)
from beltarm_env.physics.friction import (
    breakaway_torque,
    exit_margin,
    exit_margin_rate,
    friction_torque,
    mode_margin,
    sliding_direction,
)
from beltarm_env.physics.state import ArmState
from beltarm_env.task.ranges import DRIVE_RANGES
from eval.reference.drive import belt_spring, ripple

PARAMS = ArmParams(
    **{
        **{name: high for name, (_, high) in DRIVE_RANGES.items()},
        **{"kinematic_error_phase": 0.7, "friction_variation_phase": 1.9, "torque_ripple_phase": 2.5},
    }
)
PLANT, DRIVE = PARAMS.plant(), drive_of(PARAMS.row())
IDEAL = ArmParams().plant()
STATES = [ArmState(70.0, 30.0, 0.01, -0.2), ArmState(12.3, -4.0, -0.03, 0.5), ArmState(101.0, 0.0, 0.0005, 0.0)]
EACH = pytest.mark.parametrize("x", STATES)


@pytest.mark.parametrize(
    ("speed", "pull", "direction"),
    [
        *((1e-9, -9.0, 1.0), (50.0, 0.0, 1.0), (0.5, 0.0, 1.0), (-1e-9, 9.0, -1.0), (-0.5, 0.0, -1.0)),
        *((0.0, 0.3, 0.0), (0.0, -0.3, 0.0), (0.0, 0.31, 1.0), (0.0, -0.31, -1.0), (0.0, 0.0, 0.0)),
    ],
)
def test_a_motor_slides_as_it_turns_and_from_rest_as_it_is_pulled(speed: float, pull: float, direction: float):
    assert sliding_direction(speed, pull, 0.3) == direction


@pytest.mark.parametrize(
    ("direction", "margin"), [(1.0, 2.5), (-1.0, -2.5), (0.0, 0.3 - 0.2)], ids=["forward", "backward", "sticking"]
)
def test_margins(direction: float, margin: float):
    for pull in (-0.2, 0.2):
        assert mode_margin(2.5, pull, direction, 0.3) == pytest.approx(margin)
    for side in (-1.0, 1.0):
        left = margin if direction else 0.3 - side * 0.2
        assert exit_margin(2.5, 0.2, direction, side, 0.3) == pytest.approx(left)
        before, after = (exit_margin(2.5 + t * 40, 0.2 + t * 7, direction, side, 0.3) for t in (-1e-3, 1e-3))
        assert exit_margin_rate(40.0, 7.0, direction, side) == pytest.approx((after - before) / 2e-3)


@EACH
def test_friction_varies_over_the_turn_and_falls_with_the_speed(x: ArmState):
    at = angles_of(x, PLANT, DRIVE)
    varied = 1 + PARAMS.friction_variation * math.sin(2 * x.motor_angle + 1.9)
    share = 1 / (1 + (x.motor_speed / PARAMS.stribeck_speed) ** 2)
    factor = coupling(x, at, PLANT, DRIVE).friction
    assert factor == pytest.approx(varied * (1 + PARAMS.static_friction_excess * share), rel=1e-12)
    at_rest = PARAMS.coulomb_friction * varied * (1 + PARAMS.static_friction_excess)
    assert breakaway_torque(at, PLANT, DRIVE) == pytest.approx(at_rest, rel=1e-12)
    for direction in (-1.0, 1.0):
        torque = direction * PARAMS.coulomb_friction
        assert friction_torque(direction, factor, PLANT, DRIVE) == pytest.approx(torque * factor, rel=1e-12)
        assert friction_torque(direction, factor, IDEAL, None) == direction * ArmParams().coulomb_friction
    assert breakaway_torque(angles_of(x, IDEAL, None), IDEAL, None) == ArmParams().coulomb_friction


def joint_beyond(angle: float) -> float:
    """Angle of joint 1 beyond that of the gear ratio [rad]."""
    return PARAMS.kinematic_error * math.sin(2 * angle + 0.7)


@EACH
def test_transmission_is_the_kinematic_error_and_its_derivatives(x: ArmState):
    gear, h = transmission(angles_of(x, PLANT, DRIVE), PLANT, DRIVE), 1e-4
    before, now, after = (joint_beyond(x.motor_angle + d) for d in (-h, 0.0, h))
    assert gear.error == pytest.approx(now, abs=1e-15)
    assert gear.ratio == pytest.approx(1 / PARAMS.gear_ratio + (after - before) / (2 * h), rel=1e-6)
    assert gear.curvature == pytest.approx((after - 2 * now + before) / h**2, abs=1e-9)


@EACH
def test_what_couples_motor_and_arm(x: ArmState):
    at, h = angles_of(x, PLANT, DRIVE), 1e-6
    on = coupling(x, at, PLANT, DRIVE, 0.02)
    torsion, rate = belt_motion(x, PLANT, DRIVE)
    assert torsion == pytest.approx(x.torsion + joint_beyond(x.motor_angle), abs=1e-15)
    before, after = (x.torsion + t * x.torsion_speed + joint_beyond(x.motor_angle + t * x.motor_speed) for t in (-h, h))
    assert rate == on.torsion_speed == pytest.approx((after - before) / (2 * h), abs=1e-9)
    assert on.belt == pytest.approx(belt_spring(PARAMS, torsion) + PLANT.damping * rate, rel=1e-11)
    assert on.ripple == pytest.approx(ripple(PARAMS, x.motor_angle), abs=1e-15)
    assert on.inverse == pytest.approx(50.0, rel=1e-12)


@EACH
def test_the_belts_torque_behind_a_motor_at_rest_changes_as_it_is_stretched(x: ArmState):
    x, h = x._replace(motor_speed=0.0), 1e-6

    def belt(time: float, plant: Any, drive: Any) -> float:
        moved = x._replace(torsion=x.torsion + time * x.torsion_speed, torsion_speed=x.torsion_speed + time * 3.0)
        return coupling(moved, angles_of(moved, plant, drive), plant, drive).belt

    for plant, drive in ((PLANT, DRIVE), (IDEAL, None)):
        slope = (belt(h, plant, drive) - belt(-h, plant, drive)) / (2 * h)
        found = belt_torque_rate(x, angles_of(x, plant, drive), 3.0, plant, drive)
        assert found == pytest.approx(slope, rel=1e-6, abs=1e-8)


def test_an_ideal_drive_couples_by_the_belt_alone():
    x = STATES[0]
    on = coupling(x, angles_of(x, IDEAL, None), IDEAL, None, 0.02)
    assert on[:1] + on[2:] == (0.0, -0.2, 1 / 88, 0.0, 1.0, 1 / 0.02)
    assert on.belt == pytest.approx(33 * 0.01 - 0.2 * IDEAL.damping)
    assert belt_motion(x, IDEAL, None) == (0.01, -0.2)
    assert angles_of(x, IDEAL, None)[2:] == (0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("angle", [0.0, 33.3, 110.0])
def test_an_arm_at_rest_has_no_torque_in_its_belt(angle: float):
    x = resting(angle, PLANT, DRIVE)
    assert (x.motor_angle, x.motor_speed, x.torsion_speed) == (angle, 0.0, 0.0)
    assert belt_motion(x, PLANT, DRIVE) == pytest.approx((0.0, 0.0), abs=1e-16)
    assert abs(x.torsion) > 1e-6, "the kinematic error is taken up"
