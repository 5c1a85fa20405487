"""A Runge-Kutta step of an arm behind a drive as it is built, within one friction mode.

Torques of its stages are those of `torque`; when the mode ends, `events` finds out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from beltarm_env.arm import Plant
from beltarm_env.engine import inlined
from beltarm_env.physics.drive import Angles, Drive, angles_near, turned
from beltarm_env.physics.driven.torque import Stages
from beltarm_env.physics.integrator import moved, weighted
from beltarm_env.physics.models import Model, accelerations_at, inverse_inertia
from beltarm_env.physics.state import ArmState
from beltarm_env.timing import CONTROL_PERIOD

_SLOW = 10.0  # [rad/s] at the motor: friction that falls with speed and ripple multiply errors here
_SLOW_FOR_RIPPLE = 40.0  # [rad/s]: and strong ripple here
_STRONG = 3e4  # c / M_a1 n^(3/2) omega_a, of a ripple whose torque disturbs its own phase [rad/s^3]
_SLOW_STEP = 0.5 * CONTROL_PERIOD
ROUNDING = 1e-9
"""Of a step: what is left by less is taken with it."""
FRICTION_STEPS = 12
"""Steps, over the static excess s, in which an accelerating motor's speed gains omega_a + omega_s."""


class Step(NamedTuple):
    """Outcome of a step within one friction mode."""

    state: ArmState
    at: Angles  # of the first stage; those of a motor at rest are its own
    first: ArmState  # slope of the first stage
    second: ArmState
    third: ArmState
    last: ArmState


@inlined
def slope(
    x: ArmState, at: Angles, torque: float, direction: float, plant: Plant, drive: Drive, model: Model
) -> ArmState:
    """Return dx/dt under a motor torque [N m]."""
    motor, torsional = accelerations_at(x, at, torque, direction, plant, model, drive)
    return ArmState(x.motor_speed, motor, x.torsion_speed, torsional)


class Base(NamedTuple):
    """State near which a stage of a step lies: its motor's angle, phi, sines and cosines."""

    motor_angle: float
    phi: float
    at: Angles


@inlined
def _slope_near(
    x: ArmState, more: float, torque: float, base: Base, direction: float, plant: Plant, drive: Drive, model: Model
) -> ArmState:
    phi = x.motor_angle * plant.inverse_gear - x.torsion
    at = angles_near(base.at, phi - base.phi, x.motor_angle - base.motor_angle + more, drive)
    return slope(x, at, torque, direction, plant, drive, model)


class Fit(NamedTuple):
    """What fits a step to a sine whose angle turns with the motor."""

    ends: float  # its amplitude at the step's ends
    middle: float  # and in the middle
    lead: float  # displacement of the middle stages' angle, over h^2 and the sine's acceleration at the beginning


@inlined
def fit_of(half_turn: float) -> Fit:
    """Return the fit for a sine whose angle turns by w in half a step, at most 2 rad, by series in w^2.

    With a = 3 (sin(w) - w cos(w)) / (w^2 sin(w)) at the ends and m = (3 sin(w) / w - a cos(w)) / 2 in the middle, the
    stages have its first two moments. With lead = (D - 1/4) / 2 and S = sin(w) / w,

        D = (6 (S^2 / 4 - (a cos(2 w) + 2 m cos(w)) / 12) / (w a m sin(w)) - 1/2) / 2

    the energy that the sine's torque gives and takes is 0 in the mean over its phase, to second order in the torque.
    """
    w2 = half_turn * half_turn
    w4 = w2 * w2
    a0, a1, a2 = 1 + w2 * (1 / 15), 2 / 315 + w2 * (1 / 1575), 2 / 31185 + w2 * (1382 / 212837625)
    m0, m1, m2 = 1 - w2 * (1 / 30), 13 / 2520 + w2 * (1 / 3600), 647 / 19958400 + w2 * (176639 / 54486432000)
    d0, d1 = -1 / 30 - w2 * (1 / 3150), 1 / 23625 + w2 * (89 / 18191250)
    return Fit(a0 + w4 * (a1 + w4 * a2), m0 + w4 * (m1 + w4 * m2), w2 * (d0 + w4 * d1))


@inlined
def _fit(at: Angles, by_double: float, by_ripple: float) -> Angles:
    """Return the angles with these amplitudes."""
    return Angles(
        at.sin_phi,
        at.cos_phi,
        by_double * at.sin_double,
        by_double * at.cos_double,
        by_ripple * at.sin_ripple,
        by_ripple * at.cos_ripple,
    )


@inlined
def driven_step(
    x: ArmState,
    at: Angles,
    torques: Stages,
    direction: float,
    dt: float,
    plant: Plant,
    drive: Drive,
    model: Model,
) -> Step:
    """Take a fourth-order Runge-Kutta step of `dt` seconds within one friction mode.

    It is fitted to what turns with the motor: ripple, variation of friction, kinematic error (`fit_of`). The
    stages see these at the angles to which the motor's true torque turns it, not to which theirs would. Where the motor
    rests, the fifth term of the exact step is added to the arm's vibration: (omega h)^4 / 120 of h x'.

    Args:
        x: State.
        at: Its sines and cosines.
        torques: Of the stages.
        direction: Friction mode.
        dt: Length of the step [s].
        plant: Coefficients of the arm.
        drive: Coefficients of its drive.
        model: Whose equations of motion.
    """
    turn = 0.5 * dt * x.motor_speed
    phi = x.motor_angle * plant.inverse_gear - x.torsion
    double, ripple = fit_of(2 * turn), fit_of(drive.ripple_order * turn)
    at_middle = turned(at, turn, drive)
    middle = Base(x.motor_angle + turn, phi, _fit(at_middle, double.middle, ripple.middle))
    last = Base(x.motor_angle + 2 * turn, phi, _fit(turned(at_middle, turn, drive), double.ends, ripple.ends))
    w11, w12, w22 = inverse_inertia(at.cos_phi, plant, model)
    per_torque = direction * direction * w11 * plant.gear * plant.gear * dt * dt
    by_end = per_torque * (1 / 6) * (torques.first - 2 * torques.second + torques.third)
    begin = _fit(at, double.ends, ripple.ends)
    k1 = slope(x, begin, torques.first, direction, plant, drive, model)
    bend = dt * dt * 0.125 * k1.motor_speed
    lead = ripple.lead * ripple.ends * drive.ripple * at.sin_ripple
    more = per_torque * (torques.half - 0.125 * torques.first + lead)
    k2 = _slope_near(moved(x, 0.5 * dt, k1), more + bend, torques.second, middle, direction, plant, drive, model)
    k3 = _slope_near(moved(x, 0.5 * dt, k2), more - bend, torques.third, middle, direction, plant, drive, model)
    k4 = _slope_near(moved(x, dt, k3), by_end, torques.fourth, last, direction, plant, drive, model)
    y = moved(x, dt * (1 / 6), weighted(k1, k2, k3, k4))
    vibrates_by = (1 - direction * direction) * dt * dt * plant.stiffness * (w22 - w12 * w12 / w11)
    fifth = 1 + vibrates_by * vibrates_by * (1 / 120)
    torsion = x.torsion + fifth * (y.torsion - x.torsion)
    torsion_speed = x.torsion_speed + fifth * (y.torsion_speed - x.torsion_speed)
    return Step(ArmState(y.motor_angle, y.motor_speed, torsion, torsion_speed), begin, k1, k2, k3, k4)


@inlined
def needed_rate(x: ArmState, motor: float, torque_change: float, direction: float, plant: Plant, drive: Drive) -> float:
    """Return the steps per second that ripple, and friction's fall with speed, have to be resolved with [1/s].

    At most 3.3 radians of ripple, and one of twice the motor's angle, per step; where friction depends on the speed, a
    share 1 / (12 s) of omega_a + omega_s; below 10 rad/s, or 40 with strong ripple, half a sample.

    Args:
        x: State.
        motor: Acceleration of the motor [rad/s^2].
        torque_change: By how much its torque may change within the step [N m].
        direction: Friction mode.
        plant: Coefficients of the arm.
        drive: Coefficients of its drive.
    """
    speed, change = abs(x.motor_speed), abs(motor) + torque_change * plant.inverse_motor_inertia
    by_ripple = 0.3 * drive.ripple_order if drive.ripple > 0.0 else 0.0
    by_turning = (by_ripple if by_ripple > 2.0 else 2.0) * speed
    u = drive.inverse_stribeck_speed
    by_friction = FRICTION_STEPS * drive.static_excess * change * u / (1 + speed * u)
    ripple = drive.ripple * plant.inverse_motor_inertia * speed
    strong = ripple * ripple * drive.ripple_order * drive.ripple_order * drive.ripple_order > _STRONG * _STRONG
    touchy = (speed < _SLOW) & ((drive.static_excess > 0.0) | (drive.ripple > 0.0))
    touchy = (touchy | (strong & (speed < _SLOW_FOR_RIPPLE))) & (direction != 0.0)
    by_slowness = 1 / _SLOW_STEP if touchy else 0.0
    fastest = by_turning if by_turning > by_friction else by_friction
    return (fastest if fastest > by_slowness else by_slowness) * (direction * direction)


@inlined
def step_length(remaining: float, rate: float, substeps: float) -> tuple[float, float]:
    """Return the length of the next step of what remains of a piece [s], and how many such steps there are."""
    steps = np.ceil(remaining * rate - ROUNDING)
    coarse = np.ceil(remaining * (1 / CONTROL_PERIOD) * substeps - ROUNDING)
    steps = substeps * steps
    steps = coarse if coarse > steps else steps
    steps = steps if steps > 1.0 else 1.0
    return remaining / steps, steps
