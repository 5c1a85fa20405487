"""A Runge-Kutta step of the arm within one friction mode, and how long it may be.

The step is the classical one of fourth order. Behind a real drive its stages take the torques of `torque`, by which it
is exact for a linear arm whatever the torque does within the step, and three more corrections:

- Ripple, variation of friction and kinematic error turn with the motor. Where such an effect turns by 2w in a step,
  amplitudes a(w) at the ends and m(w) in the middle give its first two moments exactly at constant speed, and small
  displacements of the stages' angles those of an accelerating motor, to second order in the ripple (`fit_of`).
- The stages see these effects, and friction that falls with the speed, at the angles and speeds to which the motor's
  true torque leads, not to which theirs would.
- Where the motor rests, the fifth term of the exact step is added to the arm's vibration: (omega h)^4 / 120 of h x'.

Of an ideal drive (None) nothing of this is in the generated code. When a mode ends, `events` finds out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from beltarm_env.engine import inlined
from beltarm_env.physics.drive import Angles, near, nearer, turned
from beltarm_env.physics.friction import free_motor
from beltarm_env.physics.models import (
    Arm,
    acceleration_per_torque,
    accelerations_at,
    inverse_inertia,
    torsional_mobility,
)
from beltarm_env.physics.state import ArmState
from beltarm_env.physics.torque import Stages
from beltarm_env.timing import CONTROL_PERIOD

_SLOW = 3.0  # [rad/s] at the motor: friction that falls with speed and ripple multiply errors here
_SLOW_STEP = 0.5 * CONTROL_PERIOD
_TURN_OF_RIPPLE, _TURN = 3.3, 0.5  # largest turn of ripple, and of the motor, in a step [rad]
TURN_GAINED = 0.8  # largest part of the ripple's turn in a sample that a change of the speed may make [rad]
ROUNDING = 1e-9
"""Of a step: what is left by less is taken with it."""
FRICTION_STEPS = 8
"""Steps, over the static excess s, in which a motor's speed may gain omega_a + omega_s; half a step is added."""
SPRING_TURN = 0.2
"""Largest product of step and natural frequency of a motor that gives before it slips."""


class Step(NamedTuple):
    """A step within one friction mode."""

    begin: ArmState
    at: Angles  # what torques depend on, there
    torques: Stages
    direction: float  # friction mode
    dt: float  # its length [s]
    end: ArmState
    first: ArmState  # slope of the first stage
    last: ArmState
    lowest: float  # acceleration in the step of a motor that nothing holds, without that by its torque [rad/s^2]
    highest: float
    by_torque: float  # acceleration by torque [rad/s^2 per N m]


@inlined
def moved(x: ArmState, dt: float, slope: ArmState) -> ArmState:
    """Return a state `dt` seconds on along a slope."""
    return ArmState(
        x.motor_angle + dt * slope.motor_angle,
        x.motor_speed + dt * slope.motor_speed,
        x.torsion + dt * slope.torsion,
        x.torsion_speed + dt * slope.torsion_speed,
    )


@inlined
def weighted(k1: ArmState, k2: ArmState, k3: ArmState, k4: ArmState) -> ArmState:
    """Return six times the mean slope of a Runge-Kutta step from its four slopes."""
    return ArmState(
        k1.motor_angle + 2 * (k2.motor_angle + k3.motor_angle) + k4.motor_angle,
        k1.motor_speed + 2 * (k2.motor_speed + k3.motor_speed) + k4.motor_speed,
        k1.torsion + 2 * (k2.torsion + k3.torsion) + k4.torsion,
        k1.torsion_speed + 2 * (k2.torsion_speed + k3.torsion_speed) + k4.torsion_speed,
    )


@inlined
def _slope(x: ArmState, at: Angles, torque: float, direction: float, arm: Arm) -> tuple[ArmState, float]:
    """Return dx/dt under a motor torque [N m], and the acceleration of a motor that nothing holds [rad/s^2]."""
    motor, torsional, loose = accelerations_at(x, at, torque, direction, arm)
    return ArmState(x.motor_speed, motor, x.torsion_speed, torsional), loose


class Fit(NamedTuple):
    """Amplitudes and angles at which a step sees a sine whose angle turns with the motor."""

    ends: float  # amplitude at the step's ends
    middle: float  # and in the middle
    bend: float  # displacement of the middle stages' angle, over that by the motor's steady acceleration
    along: float  # and over h^2 and the amplitude of the acceleration by the sine: in its phase; of the end, less that
    across: float  # and a quarter of a turn ahead


@inlined
def fit_of(half_turn: float) -> Fit:
    """Return the fit for a sine whose angle turns by w in half a step, at most 2 rad, by series in w^2.

    With a = 3 (sin(w) - w cos(w)) / (w^2 sin(w)) at the ends and m = (3 sin(w) / w - a cos(w)) / 2 in the middle, the
    stages have the first two moments of the sine at constant speed. A steady acceleration bends the angle by b(t). Its
    first moment is right where the middle stages have rho b more, rho = 3/2 (Q - a cos(w) / 3) / m, with
    Q = integral of v^2 cos(w v) over v from 0 to 1.

    The acceleration C sin(angle) by the sine itself bends it as well. To second order in C the change of speed is right
    where the angle is ahead by C h^2 (l_1 sin + l_2 cos) of the middle's phase in the middle, and -C h^2 l_1 sin at the
    end. l_1 and l_2 follow from its three harmonics; their series are fitted, to 3e-6.
    """
    w2 = half_turn * half_turn
    w4 = w2 * w2
    a0, a1, a2 = 1 + w2 * (1 / 15), 2 / 315 + w2 * (1 / 1575), 2 / 31185 + w2 * (1382 / 212837625)
    m0, m1, m2 = 1 - w2 * (1 / 30), 13 / 2520 + w2 * (1 / 3600), 647 / 19958400 + w2 * (176639 / 54486432000)
    bend = w2 * ((1 / 15 + w2 * (2 / 525)) + w4 * (1 / 7875 - w2 * (62 / 27286875)))
    along = w2 * ((1 / 15 - w2 * 0.001562365) + w4 * (2.0044e-4 + w2 * 3.1689e-5))
    across = half_turn * w2 * ((1 / 60 - w2 * 0.00150758) + w4 * (2.195e-5 - w2 * 6.23e-7))
    return Fit(a0 + w4 * (a1 + w4 * a2), m0 + w4 * (m1 + w4 * m2), bend, along, across)


class Base(NamedTuple):
    """State near which a stage of a step lies."""

    motor_angle: float
    phi: float
    deflection: float
    at: Angles


@inlined
def _fitted(at: Angles, by_double: float, by_ripple: float) -> Angles:
    """Return the angles with these amplitudes."""
    return at._replace(
        sin_double=by_double * at.sin_double,
        cos_double=by_double * at.cos_double,
        sin_ripple=by_ripple * at.sin_ripple,
        cos_ripple=by_ripple * at.cos_ripple,
    )


@inlined
def _seen(x: ArmState, base: Base, ahead: float, faster: float, arm: Arm) -> Angles:
    """Return what a stage sees near a base, its motor ahead of x by an angle [rad] and faster by a speed [rad/s]."""
    drive, phi = arm.drive, x.motor_angle * arm.plant.inverse_gear - x.torsion
    sin_phi, cos_phi = near(base.at.sin_phi, base.at.cos_phi, phi - base.phi)
    if drive is None:
        return Angles(sin_phi, cos_phi, 0.0, 0.0, 0.0, 0.0, x.motor_speed, 0.0)
    motor = x.motor_angle - base.motor_angle
    turn = motor + ahead
    sin_double, cos_double = nearer(base.at.sin_double, base.at.cos_double, 2 * turn)
    sin_ripple, cos_ripple = near(base.at.sin_ripple, base.at.cos_ripple, drive.ripple_order * turn)
    speed, deflection = x.motor_speed + faster, base.deflection + motor
    return Angles(sin_phi, cos_phi, sin_double, cos_double, sin_ripple, cos_ripple, speed, deflection)


@inlined
def rk4_step(x: ArmState, at: Angles, torques: Stages, direction: float, dt: float, arm: Arm) -> Step:
    """Take a step of `dt` seconds within one friction mode.

    Args:
        x: State.
        at: What its torques depend on.
        torques: Of the stages.
        direction: Friction mode.
        dt: Length of the step [s].
        arm: What moves.
    """
    plant, drive, model = arm
    phi = x.motor_angle * plant.inverse_gear - x.torsion
    by_torque = acceleration_per_torque(at, arm)
    begin, middle, end = at, Base(x.motor_angle, phi, 0.0, at), Base(x.motor_angle, phi, 0.0, at)
    ahead, ahead_at_end, bends, faster, faster_in_third, faster_at_end = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    if drive is not None:
        turn = 0.5 * dt * x.motor_speed
        double, ripple = fit_of(2 * turn), fit_of(drive.ripple_order * turn)
        at_middle = turned(at, 2 * turn, drive.ripple_order * turn)
        at_end = turned(at_middle, 2 * turn, drive.ripple_order * turn)
        middle = Base(x.motor_angle + turn, phi, at.deflection + turn, _fitted(at_middle, double.middle, ripple.middle))
        end = Base(x.motor_angle + 2 * turn, phi, at.deflection + 2 * turn, _fitted(at_end, double.ends, ripple.ends))
        begin = _fitted(at, double.ends, ripple.ends)
        per_torque = free_motor(direction, drive) * by_torque * dt
        ripples_by = per_torque * dt * drive.ripple
        along = ripples_by * ripple.along * at_middle.sin_ripple
        ahead = per_torque * dt * (torques.half - 0.125 * torques.first)
        ahead += along + ripples_by * (
            ripple.across * at_middle.cos_ripple - 0.125 * ripple.bend * ripple.ends * at.sin_ripple
        )
        ahead_at_end = per_torque * dt * (1 / 6) * (torques.first - 2 * torques.second + torques.third) - along
        faster = per_torque * (torques.early - 0.5 * torques.first)
        faster_in_third = per_torque * (torques.early - 0.5 * torques.second)
        mean = (torques.first + 2 * torques.second + 2 * torques.third + torques.fourth) * (1 / 6)
        faster_at_end = per_torque * (mean - torques.third)
        bends = ripple.bend
    k1, a1 = _slope(x, begin, torques.first, direction, arm)
    bend = 0.125 * dt * dt * k1.motor_speed
    x2 = moved(x, 0.5 * dt, k1)
    seen = _seen(x2, middle, ahead + (bends + 1) * bend, faster, arm)
    k2, a2 = _slope(x2, seen, torques.second, direction, arm)
    x3 = moved(x, 0.5 * dt, k2)
    seen = _seen(x3, middle, ahead + (bends - 1) * bend, faster_in_third, arm)
    k3, a3 = _slope(x3, seen, torques.third, direction, arm)
    x4 = moved(x, dt, k3)
    seen = _seen(x4, end, ahead_at_end, faster_at_end, arm)
    k4, a4 = _slope(x4, seen, torques.fourth, direction, arm)
    y = moved(x, dt * (1 / 6), weighted(k1, k2, k3, k4))
    if drive is not None:
        w11, w12, w22 = inverse_inertia(at.cos_phi, plant, model)
        sliding = direction * direction
        compliance = sliding * torsional_mobility(w11, w12, w22) + (1 - sliding) * (w22 - w12 * w12 / w11)
        vibrates_by = dt * dt * plant.stiffness * compliance
        fifth = 1 + vibrates_by * vibrates_by * (1 / 120)
        y = y._replace(
            torsion=x.torsion + fifth * (y.torsion - x.torsion),
            torsion_speed=x.torsion_speed + fifth * (y.torsion_speed - x.torsion_speed),
        )
    a1, a2 = a1 - by_torque * torques.first, a2 - by_torque * torques.second
    a3, a4 = a3 - by_torque * torques.third, a4 - by_torque * torques.fourth
    early_low, late_low = (a1 if a1 < a2 else a2), (a3 if a3 < a4 else a4)
    early_high, late_high = (a1 if a1 > a2 else a2), (a3 if a3 > a4 else a4)
    lowest = early_low if early_low < late_low else late_low
    highest = early_high if early_high > late_high else late_high
    return Step(x, at, torques, direction, dt, y, k1, k4, lowest, highest, by_torque)


@inlined
def needed_rate(x: ArmState, at: Angles, torque: float, change: float, direction: float, arm: Arm) -> float:
    """Return the steps per second that a real drive's effects have to be resolved with [1/s].

    At most 3.3 rad of ripple and half a radian of the motor per step; a step for each 0.8 rad by which a change of the
    speed turns the ripple on in a sample; where friction depends on the speed, a share
    1 / (8 s + 1/2) of omega_a + omega_s; below 3 rad/s, half a sample; 0.2 rad of the vibration of a motor
    that sticks and gives.

    Args:
        x: State.
        at: What its torques depend on.
        torque: Of the motor [N m].
        change: By how much it may change within the step [N m].
        direction: Friction mode.
        arm: What moves.
    """
    plant, drive, _ = arm
    if drive is None:
        return 0.0
    speed, sliding = abs(x.motor_speed), direction * direction
    level = plant.coulomb_friction * (1 + drive.static_excess)
    pull = torque + drive.ripple * at.sin_ripple - plant.stiffness * x.torsion * plant.inverse_gear
    push = abs(pull - direction * level) + change
    by_turning = (1 / _TURN) * speed
    gained = (CONTROL_PERIOD / TURN_GAINED * _TURN_OF_RIPPLE) * push * plant.inverse_motor_inertia
    quickest = speed if speed > gained else gained
    by_ripple = (1 / _TURN_OF_RIPPLE) * drive.ripple_order * quickest if drive.ripple > 0.0 else 0.0
    u = drive.inverse_stribeck_speed
    share = FRICTION_STEPS * drive.static_excess + 0.5 if drive.static_excess > 0.0 else 0.0
    by_friction = share * push * plant.inverse_motor_inertia * u / (1 + speed * u)
    touchy = (speed < _SLOW) & ((drive.static_excess > 0.0) | (drive.ripple > 0.0))
    by_slowness = 1 / _SLOW_STEP if touchy else 0.0
    turning = by_turning if by_turning > by_ripple else by_ripple
    falling = by_friction if by_friction > by_slowness else by_slowness
    return (turning if turning > falling else falling) if sliding > 0.0 else drive.spring_rate * (1 / SPRING_TURN)


@inlined
def step_length(remaining: float, rate: float, substeps: float) -> tuple[float, float]:
    """Return the length of the next step of what remains of a piece [s], and how many such steps there are."""
    steps = np.ceil(remaining * rate - ROUNDING)
    coarse = np.ceil(remaining * (1 / CONTROL_PERIOD) * substeps - ROUNDING)
    steps = substeps * steps
    steps = coarse if coarse > steps else steps
    steps = steps if steps > 1.0 else 1.0
    return remaining / steps, steps
