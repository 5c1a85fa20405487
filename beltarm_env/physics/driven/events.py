"""Stopping and breaking away behind a drive as it is built.

As in `integrator`, the instant of an event is the root of the margin, here of a cubic Hermite polynomial through both
ends of a step plus the exponential of the lag. A margin that falls below zero and comes back within the step, as a
torque that reverses can make it, is found too: the lowest point of a convex margin. `stays_in_mode` tells without that
effort, of most steps, that there is no event.
"""

from __future__ import annotations

from typing import NamedTuple

from beltarm_env.arm import Plant
from beltarm_env.engine import inlined
from beltarm_env.physics import friction
from beltarm_env.physics.drive import Angles, Drive, angles_near, decay
from beltarm_env.physics.driven.step import Step
from beltarm_env.physics.driven.torque import Lag, Stages, lag_left
from beltarm_env.physics.models import Model, acceleration_per_torque, driving_torque_at, driving_torque_rate_at
from beltarm_env.physics.state import ArmState

EXIT_ITERATIONS = 10  # of bracketed Newton; the margin is a cubic and an exponential
CLOSE = 1e-13
"""Accuracy of roots, as a share of the step."""
NEGLIGIBLE = 1e-10
"""A margin [rad/s] or [N m] that dips less below zero has not been left."""
_SURE = 1.1  # of the acceleration by a change of torque, in which the full arm's links take part
_CURVED, _BENT = 0.01, 0.1  # shares of pull, and of its change, by which it may leave the line between a step's ends


@inlined
def stays_in_mode(
    x: ArmState,
    step: Step,
    direction: float,
    dt: float,
    lowest: float,
    highest: float,
    plant: Plant,
    drive: Drive,
    model: Model,
) -> bool:
    """Tell that the motor stops or breaks away nowhere within a step; False where that is not sure.

    A motor that slides cannot stop within dt if |omega_a(0) + omega_a(dt)| is above dt times its largest acceleration.
    The pull on one that sticks is, between the ends, near a straight line: a step is an eighth of the belt's radian at
    most, so that a vibration leaves the line by 1/500 of its amplitude.

    Args:
        x: State.
        step: From there.
        direction: Friction mode.
        dt: Length of the step [s].
        lowest: Motor torque within it [N m].
        highest: Motor torque within it [N m].
        plant: Coefficients of the arm.
        drive: Coefficients of its drive.
        model: Whose equations of motion.
    """
    k1, k2 = abs(step.first.motor_speed), abs(step.second.motor_speed)
    k3, k4 = abs(step.third.motor_speed), abs(step.last.motor_speed)
    early, late = (k1 if k1 > k2 else k2), (k3 if k3 > k4 else k4)
    largest = (early if early > late else late) + _SURE * (highest - lowest) * plant.inverse_motor_inertia
    slides_on = direction * (x.motor_speed + step.state.motor_speed) > dt * largest
    after = angles_near(step.at, x.torsion - step.state.torsion, 0.0, drive)
    pull = driving_torque_at(x, step.at, 0.0, plant, model, drive)
    pull_after = driving_torque_at(step.state, after, 0.0, plant, model, drive)
    low, high = (pull, pull_after) if pull < pull_after else (pull_after, pull)
    most = friction.breakaway_torque(step.at, plant, drive) - _CURVED * abs(pull) - _BENT * (high - low)
    sticks_on = (high + highest < most) & (low + lowest > -most)
    return slides_on if direction != 0.0 else sticks_on


class Margin(NamedTuple):
    """Margin to the friction mode over a step, by u = t / dt: a cubic plus a decaying exponential."""

    c0: float
    c1: float
    c2: float
    c3: float
    amplitude: float
    exponent: float  # rate dt


@inlined
def _margin_at(m: Margin, u: float) -> tuple[float, float]:
    """Return the margin and its derivative by u."""
    part = m.amplitude * decay(m.exponent * u)
    return m.c0 + u * (m.c1 + u * (m.c2 + u * m.c3)) + part, m.c1 + u * (2 * m.c2 + u * 3 * m.c3) - m.exponent * part


@inlined
def margin_of(
    x: ArmState,
    at: Angles,
    step: Step,
    torques: Stages,
    lag: Lag,
    direction: float,
    dt: float,
    plant: Plant,
    drive: Drive,
    model: Model,
) -> tuple[Margin, float]:
    """Return the margin over a step, and the side (-1, +1) to which a motor that sticks would break away.

    The speed of a motor that slides follows the lag as q e^(-t / T_i), with the q that the excess causes by itself,
    viscous friction included; what is left of it is smooth. The pull on one that sticks is smooth but for the torque.
    """
    by_torque = acceleration_per_torque(at, plant, drive, model)
    q = -lag.excess * lag.time * by_torque * (1 + plant.viscous_friction * by_torque * lag.time)
    decayed = lag_left(lag, torques)
    most = friction.breakaway_torque(at, plant, drive)
    after = angles_near(at, x.torsion - step.state.torsion, 0.0, drive)
    pull = driving_torque_at(x, at, lag.target, plant, model, drive)
    pull_after = driving_torque_at(step.state, after, lag.target, plant, model, drive)
    end, middle = pull_after + lag.excess * decayed, 0.5 * (pull + pull_after) + lag.excess * 0.5
    side = 1.0 if (end if abs(end) >= most else middle) > 0.0 else -1.0
    start_rate = driving_torque_rate_at(x, at, step.first.torsion_speed, plant, model, drive)
    end_rate = driving_torque_rate_at(step.state, after, step.last.torsion_speed, plant, model, drive)
    at_start = step.first.motor_speed + by_torque * (lag.target + lag.excess - torques.first) + q * lag.rate
    at_end = step.last.motor_speed + by_torque * (torques.end - torques.fourth) + q * lag.rate * decayed
    sliding = direction != 0.0
    start = direction * (x.motor_speed - q) if sliding else most - side * pull
    finish = direction * (step.state.motor_speed - q * decayed) if sliding else most - side * pull_after
    slope = dt * (direction * at_start if sliding else -side * start_rate)
    last_slope = dt * (direction * at_end if sliding else -side * end_rate)
    c3 = 2 * start + slope - 2 * finish + last_slope
    c2 = 3 * (finish - start) - 2 * slope - last_slope
    return Margin(start, slope, c2, c3, direction * q if sliding else -side * lag.excess, lag.rate * dt), side


@inlined
def leaves_mode(m: Margin, decayed: float) -> bool:
    """Tell whether the margin may fall below zero within the step: at its end, or before, by its tangents.

    `decayed` is the exponential at the end.
    """
    at_start, slope = m.c0 + m.amplitude, m.c1 - m.exponent * m.amplitude
    at_end = m.c0 + m.c1 + m.c2 + m.c3 + m.amplitude * decayed
    last_slope = m.c1 + 2 * m.c2 + 3 * m.c3 - m.exponent * m.amplitude * decayed
    low, other = at_start + slope, at_end - last_slope
    dips = (slope < 0.0) & (last_slope > 0.0) & ((low if low > other else other) < -NEGLIGIBLE)
    return (at_end < 0.0) | dips


@inlined
def dips(m: Margin) -> bool:
    """Tell whether a margin falls at the step's beginning and has risen at its end, above zero."""
    _, first_slope = _margin_at(m, 0.0)
    at_end, last_slope = _margin_at(m, 1.0)
    return (at_end >= 0.0) & (first_slope < 0.0) & (last_slope > 0.0)


@inlined
def lowest_point(m: Margin) -> float:
    """Return where on (0, 1) a convex margin that dips is lowest."""
    _, at_low = _margin_at(m, 0.0)
    _, at_high = _margin_at(m, 1.0)
    low, high = 0.0, 1.0
    for _ in range(EXIT_ITERATIONS):  # a secant, which is exact where it is straight, and a bisection, which is sure
        secant = low - at_low * (high - low) / (at_high - at_low)
        u = secant if (secant > low) & (secant < high) else 0.5 * (low + high)
        _, slope = _margin_at(m, u)
        low, at_low = (u, slope) if slope < 0.0 else (low, at_low)
        high, at_high = (high, at_high) if slope < 0.0 else (u, slope)
        u = 0.5 * (low + high)
        _, slope = _margin_at(m, u)
        low, at_low = (u, slope) if slope < 0.0 else (low, at_low)
        high, at_high = (high, at_high) if slope < 0.0 else (u, slope)
    return 0.5 * (low + high)


@inlined
def first_guess(m: Margin, bottom: float) -> tuple[float, bool]:
    """Return where a margin may fall below zero, and whether it does, given where it is lowest: 1 unless it dips."""
    lowest, _ = _margin_at(m, bottom)
    start = m.c0 + m.amplitude
    guess = bottom * start / (start - lowest) if start > 0.0 else 0.5 * bottom  # breaking away starts at zero speed
    return guess, lowest < (-NEGLIGIBLE if bottom < 1.0 else 0.0)


@inlined
def nearer_exit(m: Margin, u: float, low: float, high: float) -> tuple[float, float, float]:
    """Return a better guess of where the margin falls below zero, and its bounds, by a bracketed Newton iteration."""
    value, slope = _margin_at(m, u)
    low = u if value > 0.0 else low
    high = high if value > 0.0 else u
    newton = u - value / (slope if slope != 0.0 else 1.0)
    return newton if (newton >= low) & (newton <= high) else 0.5 * (low + high), low, high
