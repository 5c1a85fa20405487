"""Stopping and breaking away: whether they happen within a step, and when.

The instant of an event is the root of a *margin*, which is positive inside a friction mode: the speed of a motor that
slides, what is left to breakaway of one that sticks. Over a step in which the torque's target does not change, it is a
cubic Hermite polynomial through both ends plus the exponential of the lag. A margin that falls below zero and comes
back within the step, as a torque that reverses can make it, is found too: the lowest point of a convex margin.
`stays_in_mode` tells without that effort, of most steps, that there is no event.
"""

from __future__ import annotations

from typing import NamedTuple

from beltarm_env.arm import Plant
from beltarm_env.engine import inlined
from beltarm_env.physics.drive import Angles, Drive, decay, near
from beltarm_env.physics.friction import breakaway_torque
from beltarm_env.physics.models import Arm, driving_torque_at, driving_torque_rate_at
from beltarm_env.physics.step import Step
from beltarm_env.physics.torque import Lag, lag_left

EXIT_ITERATIONS = 10  # of bracketed Newton; the margin is a cubic and an exponential
CLOSE = 1e-13
"""Accuracy of roots, as a share of the step."""
NEGLIGIBLE = 1e-10
"""A margin [rad/s], [N m] or [rad] that dips less below zero has not been left."""
_SLACK = 0.1  # of the acceleration by a change of torque, and of its other changes, between the stages of a step
_CURVED = 0.02  # of the breakaway torque, by which it and the pull may change besides


@inlined
def after(step: Step, arm: Arm) -> Angles:
    """Return what torques depend on at the end of a step of a motor that hardly moved."""
    x, at, y, (plant, drive, _) = step.begin, step.at, step.end, arm
    motor = y.motor_angle - x.motor_angle
    sin_phi, cos_phi = near(at.sin_phi, at.cos_phi, motor * plant.inverse_gear - (y.torsion - x.torsion))
    if drive is None:
        return at._replace(sin_phi=sin_phi, cos_phi=cos_phi)
    sin_double, cos_double = near(at.sin_double, at.cos_double, 2 * motor)
    return at._replace(sin_phi=sin_phi, cos_phi=cos_phi, sin_double=sin_double, cos_double=cos_double)


@inlined
def stays_in_mode(step: Step, low: float, high: float, arm: Arm) -> bool:
    """Tell that the motor stops or breaks away nowhere within a step; False where that is not sure.

    The speed of a motor that slides lies above the lines from both ends with its lowest and highest acceleration; where
    they meet it is positive if a_high omega(0) - a_low omega(dt) > -a_low a_high dt. One that sticks would not
    accelerate by more than its breakaway torque makes it. The deflection of one that gives leaves the line between the
    step's ends by dt^2 / 8 of its acceleration at most.

    Args:
        step: The step.
        low: Lowest torque of the motor within it [N m].
        high: Highest.
        arm: What moves.
    """
    x, at, direction, dt, (plant, drive, _) = step.begin, step.at, step.direction, step.dt, arm
    y, slack = step.end, _SLACK * (step.highest - step.lowest + step.by_torque * (high - low))
    lowest = step.lowest + step.by_torque * low - slack
    highest = step.highest + step.by_torque * high + slack
    slowing, gaining = (lowest, highest) if direction > 0.0 else (-highest, -lowest)
    slowing, gaining = slowing if slowing < 0.0 else 0.0, gaining if gaining > 0.0 else 0.0
    first_speed, last_speed = direction * x.motor_speed, direction * y.motor_speed
    slides_on = (gaining * first_speed - slowing * last_speed > -slowing * gaining * dt) & (last_speed > 0.0)
    held = (1 - _CURVED) * step.by_torque * breakaway_torque(at, plant, drive)
    sticks_on = (highest < held) & (lowest > -held)
    if drive is not None:
        z = at.deflection + (y.motor_angle - x.motor_angle)
        nearer = abs(z) if abs(z) > abs(at.deflection) else abs(at.deflection)
        bent = 0.125 * dt * dt * (highest if highest > -lowest else -lowest)
        gives_on = step.by_torque * drive.spring * (nearer + bent) < held
        sticks_on = gives_on if drive.spring > 0.0 else sticks_on
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
def _hermite(start: float, slope: float, finish: float, last_slope: float, amplitude: float, exponent: float) -> Margin:
    """Return a margin from its smooth part at both ends and that part's slopes by u."""
    c3 = 2 * start + slope - 2 * finish + last_slope
    return Margin(start, slope, 3 * (finish - start) - 2 * slope - last_slope, c3, amplitude, exponent)


@inlined
def sliding_margin(step: Step, lag: Lag, plant: Plant) -> Margin:
    """Return the margin of a motor that slides: its speed.

    It follows the lag as q e^(-t / T_i), with the q that the excess causes by itself, viscous friction included; what
    is left of it is smooth.
    """
    torques, direction, dt, by_torque = step.torques, step.direction, step.dt, step.by_torque
    decayed = lag_left(lag, torques)
    q = -lag.excess * lag.time * by_torque * (1 + plant.viscous_friction * by_torque * lag.time)
    at_start = step.first.motor_speed + by_torque * (lag.target + lag.excess - torques.first) + q * lag.rate
    at_end = step.last.motor_speed + by_torque * (torques.end - torques.fourth) + q * lag.rate * decayed
    return _hermite(
        direction * (step.begin.motor_speed - q),
        dt * direction * at_start,
        direction * (step.end.motor_speed - q * decayed),
        dt * direction * at_end,
        direction * q,
        lag.rate * dt,
    )


@inlined
def sticking_margin(step: Step, lag: Lag, arm: Arm) -> tuple[Margin, float]:
    """Return the margin of a motor that sticks, what is left of the pull, and the side to which it breaks away."""
    x, at, y, dt = step.begin, step.at, step.end, step.dt
    most, following, decayed = breakaway_torque(at, arm.plant, arm.drive), after(step, arm), lag_left(lag, step.torques)
    pull = driving_torque_at(x, at, lag.target, arm)
    pull_after = driving_torque_at(y, following, lag.target, arm)
    end, middle = pull_after + lag.excess * decayed, 0.5 * (pull + pull_after) + lag.excess * 0.5
    side = 1.0 if (end if abs(end) >= most else middle) > 0.0 else -1.0
    start_rate = driving_torque_rate_at(x, at, step.first.torsion_speed, arm)
    end_rate = driving_torque_rate_at(y, following, step.last.torsion_speed, arm)
    slope, last_slope = -side * dt * start_rate, -side * dt * end_rate
    margin = _hermite(
        most - side * pull, slope, most - side * pull_after, last_slope, -side * lag.excess, lag.rate * dt
    )
    return margin, side


@inlined
def giving_margin(step: Step, lag: Lag, arm: Arm, drive: Drive) -> tuple[Margin, float]:
    """Return the margin of a motor that sticks and gives, what is left of the spring's torque, and the side.

    The deflection follows the lag as p e^(-t / T_i), p = by_torque excess T_i^2.
    """
    x, at, y, dt, plant = step.begin, step.at, step.end, step.dt, arm.plant
    decayed, following = lag_left(lag, step.torques), after(step, arm)
    z = at.deflection + (y.motor_angle - x.motor_angle)
    side = 1.0 if z + 0.5 * dt * y.motor_speed > 0.0 else -1.0
    spring, p = side * drive.spring, lag.excess * step.by_torque * lag.time * lag.time
    margin = _hermite(
        breakaway_torque(at, plant, drive) - spring * (at.deflection - p),
        -spring * dt * (x.motor_speed + p * lag.rate),
        breakaway_torque(following, plant, drive) - spring * (z - p * decayed),
        -spring * dt * (y.motor_speed + p * lag.rate * decayed),
        -spring * p,
        lag.rate * dt,
    )
    return margin, side


@inlined
def margin_of(step: Step, lag: Lag, arm: Arm) -> tuple[Margin, float]:
    """Return the margin over a step, and the side (-1, +1) to which a motor that sticks would break away."""
    drive, sliding = arm.drive, sliding_margin(step, lag, arm.plant)
    sticking, side = sticking_margin(step, lag, arm)
    if drive is not None:
        giving, side_of_giving = giving_margin(step, lag, arm, drive)
        sticking = either_margin(drive.spring > 0.0, giving, sticking)
        side = side_of_giving if drive.spring > 0.0 else side
    return either_margin(step.direction != 0.0, sliding, sticking), side


@inlined
def either_margin(first: bool, m: Margin, n: Margin) -> Margin:
    """Return the first margin or the second, entry by entry: a choice that vectorises."""
    return Margin._make(m[k] if first else n[k] for k in range(len(Margin._fields)))


@inlined
def leaves_mode(m: Margin, decayed: float, slides: bool) -> bool:
    """Tell whether the margin may fall below zero within the step: at its end, or before, by its tangents.

    A motor at rest leaves where the margin is `NEGLIGIBLE` below zero. It may begin a step with none at all, where it
    has just stopped, and in a very short step the rounding of what it gains would break it away, again and again.

    Args:
        m: Margin.
        decayed: Its exponential at the end.
        slides: Whether the motor does.
    """
    at_start, slope = m.c0 + m.amplitude, m.c1 - m.exponent * m.amplitude
    at_end = m.c0 + m.c1 + m.c2 + m.c3 + m.amplitude * decayed
    last_slope = m.c1 + 2 * m.c2 + 3 * m.c3 - m.exponent * m.amplitude * decayed
    low, other = at_start + slope, at_end - last_slope
    dips = (slope < 0.0) & (last_slope > 0.0) & ((low if low > other else other) < -NEGLIGIBLE)
    return (at_end < (0.0 if slides else -NEGLIGIBLE)) | dips


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
