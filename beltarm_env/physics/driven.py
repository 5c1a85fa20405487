"""Integration of an arm behind a drive as it is built, over a piece of a sample in which the command does not change.

**Lag.** Within a piece the motor torque is tau(t) = target + excess e^(-t / T_i), in closed form. The time constant may
be a tenth of the sample, which a Runge-Kutta step would not resolve. So the step is taken for

    y = x - q e^(-t / T_i),     y' = f(x, tau(t)) + q / T_i e^(-t / T_i)

which is the same motion for every q. With the q that the excess causes in the motor by itself, its viscous friction
included, the transient drops out of y' but for what belt and friction make of so small a motion.

**Events.** As in `integrator`, the instant of stopping or breaking away is the root of the margin, here of a cubic
Hermite polynomial through both ends of y plus the exponential. A margin that falls below zero and comes back within
the step, as a torque that reverses can make it, is found too: the lowest point of a convex margin.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from beltarm_env.arm import Plant
from beltarm_env.jit import inlined
from beltarm_env.physics import friction
from beltarm_env.physics.drive import Angles, Drive, angles_near, angles_of, decay, turned
from beltarm_env.physics.integrator import moved, weighted
from beltarm_env.physics.models import (
    Model,
    accelerations_at,
    driving_torque_at,
    driving_torque_rate_at,
    inverse_inertia,
    sliding_direction,
)
from beltarm_env.physics.state import ArmState
from beltarm_env.timing import CONTROL_PERIOD

_ROOT_ITERATIONS = 10  # of bracketed Newton; the margin is a cubic and an exponential
_CLOSE = 1e-13  # of roots, as a share of the step
_NEGLIGIBLE = 1e-10  # [rad/s] or [N m]: a margin that dips less below zero has not been left
_SLOW = 10.0  # [rad/s] at the motor: friction that falls with speed and ripple multiply errors here
_SLOW_STEP = 5e-4  # [s]


class Lag(NamedTuple):
    """Motor torque over a piece: target + excess e^(-t / T_i), and the motion q that the excess causes."""

    target: float  # [N m]
    excess: float  # [N m]
    time: float  # T_i [s]; 0 for a motor that follows at once
    rate: float  # 1 / T_i [1/s], or 0
    motor_speed: float  # q's share of omega_a [rad/s]; that of theta_a is -T_i of it
    torsion_speed: float  # q's share of omega_s [rad/s]


class Step(NamedTuple):
    """Outcome of a step within one friction mode."""

    state: ArmState
    torque: float  # of the motor at the end [N m]
    decayed: float  # e^(-dt / T_i)
    first: ArmState  # slope of y at the beginning
    last: ArmState  # and at the end


@inlined
def lag_of(
    torque: float, target: float, time: float, rate: float, direction: float, at: Angles, plant: Plant, model: Model
) -> Lag:
    """Return the motor torque from now on; `torque` is that of the motor now [N m], `rate` 1 / T_i or 0."""
    excess = torque - target
    w11, w12, _ = inverse_inertia(at.cos_phi, plant, model)
    by_torque = w11 * plant.gear * plant.gear
    shift = -direction * direction * excess * time * (1 + plant.viscous_friction * by_torque * time)
    return Lag(target, excess, time, rate, shift * by_torque, shift * (w11 - w12) * plant.gear)


@inlined
def _shifted(y: ArmState, e: float, lag: Lag) -> ArmState:
    """Return y + q e."""
    return ArmState(
        y.motor_angle - lag.time * lag.motor_speed * e,
        y.motor_speed + lag.motor_speed * e,
        y.torsion - lag.time * lag.torsion_speed * e,
        y.torsion_speed + lag.torsion_speed * e,
    )


class Base(NamedTuple):
    """State near which a stage of a step lies: its motor's angle, phi, sines and cosines."""

    motor_angle: float
    phi: float
    at: Angles


@inlined
def _slope(
    y: ArmState, e: float, base: Base, lag: Lag, direction: float, plant: Plant, drive: Drive, model: Model
) -> ArmState:
    """Return y', at e = e^(-t / T_i)."""
    x = _shifted(y, e, lag)
    phi = x.motor_angle * plant.inverse_gear - x.torsion
    at = angles_near(base.at, phi - base.phi, x.motor_angle - base.motor_angle, drive)
    motor, torsional = accelerations_at(x, at, lag.target + lag.excess * e, direction, plant, model, drive)
    return ArmState(
        y.motor_speed,
        motor + lag.motor_speed * lag.rate * e,
        y.torsion_speed,
        torsional + lag.torsion_speed * lag.rate * e,
    )


@inlined
def first_slope(
    x: ArmState, at: Angles, lag: Lag, direction: float, plant: Plant, drive: Drive, model: Model
) -> ArmState:
    """Return y' at the beginning of a step."""
    base = Base(x.motor_angle, x.motor_angle * plant.inverse_gear - x.torsion, at)
    return _slope(_shifted(x, -1.0, lag), 1.0, base, lag, direction, plant, drive, model)


@inlined
def driven_step(
    x: ArmState,
    at: Angles,
    k1: ArmState,
    lag: Lag,
    direction: float,
    dt: float,
    plant: Plant,
    drive: Drive,
    model: Model,
) -> Step:
    """Take a fourth-order Runge-Kutta step of `dt` seconds within one friction mode.

    Args:
        x: State.
        at: Its sines and cosines.
        k1: Its `first_slope`.
        lag: Torque of the motor.
        direction: Friction mode.
        dt: Length of the step [s].
        plant: Coefficients of the arm.
        drive: Coefficients of its drive.
        model: Whose equations of motion.
    """
    half = decay(0.5 * dt * lag.rate)
    end = half * half
    turn = 0.5 * dt * x.motor_speed
    phi = x.motor_angle * plant.inverse_gear - x.torsion
    middle = Base(x.motor_angle + turn, phi, turned(at, turn, drive))
    last = Base(x.motor_angle + 2 * turn, phi, turned(middle.at, turn, drive))
    y = _shifted(x, -1.0, lag)
    k2 = _slope(moved(y, 0.5 * dt, k1), half, middle, lag, direction, plant, drive, model)
    k3 = _slope(moved(y, 0.5 * dt, k2), half, middle, lag, direction, plant, drive, model)
    k4 = _slope(moved(y, dt, k3), end, last, lag, direction, plant, drive, model)
    state = _shifted(moved(y, dt * (1 / 6), weighted(k1, k2, k3, k4)), end, lag)
    return Step(state, lag.target + lag.excess * end, end, k1, k4)


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
    lag: Lag,
    direction: float,
    dt: float,
    plant: Plant,
    drive: Drive,
    model: Model,
) -> tuple[Margin, float]:
    """Return the margin over a step, and the side (-1, +1) to which a motor that sticks would break away.

    The pull matters for a motor that sticks, whose angle does not change.
    """
    most = friction.breakaway_torque(at, plant, drive)
    after = angles_near(at, x.torsion - step.state.torsion, 0.0, drive)
    pull = driving_torque_at(x, at, lag.target, plant, model, drive)
    pull_after = driving_torque_at(step.state, after, lag.target, plant, model, drive)
    end, middle = pull_after + lag.excess * step.decayed, 0.5 * (pull + pull_after) + lag.excess * 0.5
    side = 1.0 if (end if abs(end) >= most else middle) > 0.0 else -1.0
    start_rate = driving_torque_rate_at(x, at, step.first.torsion_speed, plant, model, drive)
    end_rate = driving_torque_rate_at(step.state, after, step.last.torsion_speed, plant, model, drive)
    sliding = direction != 0.0
    # Of y, so without what decays: that is added in closed form.
    decaying = direction * lag.motor_speed if sliding else -side * lag.excess
    start = direction * (x.motor_speed - lag.motor_speed) if sliding else most - side * pull
    ending = direction * (step.state.motor_speed - lag.motor_speed * step.decayed)
    finish = ending if sliding else most - side * pull_after
    slope = dt * (direction * step.first.motor_speed if sliding else -side * start_rate)
    last_slope = dt * (direction * step.last.motor_speed if sliding else -side * end_rate)
    c3 = 2 * start + slope - 2 * finish + last_slope
    c2 = 3 * (finish - start) - 2 * slope - last_slope
    return Margin(start, slope, c2, c3, decaying, lag.rate * dt), side


@inlined
def leaves_mode(m: Margin, decayed: float) -> bool:
    """Tell whether the margin may fall below zero within the step: at its end, or before, by its tangents.

    `decayed` is the exponential at the end.
    """
    at_start, slope = m.c0 + m.amplitude, m.c1 - m.exponent * m.amplitude
    at_end = m.c0 + m.c1 + m.c2 + m.c3 + m.amplitude * decayed
    last_slope = m.c1 + 2 * m.c2 + 3 * m.c3 - m.exponent * m.amplitude * decayed
    low, other = at_start + slope, at_end - last_slope
    dips = (slope < 0.0) & (last_slope > 0.0) & ((low if low > other else other) < -_NEGLIGIBLE)
    return (at_end < 0.0) | dips


@inlined
def _lowest(m: Margin, first_slope: float, last_slope: float) -> float:
    """Return where on (0, 1) a convex margin is lowest, its slope being negative at 0 and positive at 1."""
    low, high, at_low, at_high = 0.0, 1.0, first_slope, last_slope
    for _ in range(_ROOT_ITERATIONS):  # a secant, which is exact where it is straight, and a bisection, which is sure
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
def exit_fraction(m: Margin) -> float:
    """Return where on (0, 1) the margin falls below zero, or 1 if it does not: bracketed Newton iterations."""
    _, first_slope = _margin_at(m, 0.0)
    at_end, last_slope = _margin_at(m, 1.0)
    dips = (at_end >= 0.0) & (first_slope < 0.0) & (last_slope > 0.0)
    bottom = _lowest(m, first_slope, last_slope) if dips else 1.0
    lowest, _ = _margin_at(m, bottom)
    if lowest >= (-_NEGLIGIBLE if dips else 0.0):
        return 1.0
    start = m.c0 + m.amplitude
    low, high = 0.0, bottom
    u = bottom * start / (start - lowest) if start > 0.0 else 0.5 * bottom  # breaking away starts at zero speed
    for _ in range(_ROOT_ITERATIONS):
        value, slope = _margin_at(m, u)
        low = u if value > 0.0 else low
        high = high if value > 0.0 else u
        newton = u - value / (slope if slope != 0.0 else 1.0)
        before = u
        u = newton if (newton >= low) & (newton <= high) else 0.5 * (low + high)
        if abs(u - before) < _CLOSE:
            break
    return u


@inlined
def needed_rate(x: ArmState, motor: float, lag: Lag, direction: float, plant: Plant, drive: Drive) -> float:
    """Return the steps per second that ripple, and friction's fall with speed, have to be resolved with [1/s].

    Two radians of ripple, and one of twice the motor's angle, per step; where friction depends on the speed, a share
    1 / (4 s) of omega_a + omega_s.

    Args:
        x: State.
        motor: Acceleration of the motor, but for what its lag makes of it [rad/s^2].
        lag: Torque of the motor.
        direction: Friction mode.
        plant: Coefficients of the arm.
        drive: Coefficients of its drive.
    """
    speed, change = abs(x.motor_speed), abs(motor) + abs(lag.excess) * plant.inverse_motor_inertia
    order = drive.ripple_order if drive.ripple > 0.0 else 0.0
    by_turning = (0.5 * order if order > 4.0 else 2.0) * speed
    u = drive.inverse_stribeck_speed
    by_friction = 4 * drive.static_excess * change * u / (1 + speed * u)
    touchy = (direction != 0.0) & (speed < _SLOW) & ((drive.static_excess > 0.0) | (drive.ripple > 0.0))
    by_slowness = 1 / _SLOW_STEP if touchy else 0.0
    fastest = by_turning if by_turning > by_friction else by_friction
    return (fastest if fastest > by_slowness else by_slowness) * (direction * direction)


@inlined
def step_length(remaining: float, rate: float, substeps: float) -> tuple[float, float]:
    """Return the length of the next step of what remains of a piece [s], and how many such steps there are."""
    steps = np.ceil(remaining * rate - 1e-9)
    coarse = np.ceil(remaining * (1 / CONTROL_PERIOD) * substeps - 1e-9)
    steps = substeps * steps
    steps = coarse if coarse > steps else steps
    steps = steps if steps > 1.0 else 1.0
    return remaining / steps, steps


@inlined
def past_mode_change(
    x: ArmState, lag: Lag, direction: float, dt: float, plant: Plant, drive: Drive, model: Model
) -> tuple[ArmState, float, float, float]:
    """Step only as far as the motor stops or breaks away, if it does within `dt`.

    Returns:
        State then, torque of the motor, the friction mode from then on, and how far the step went [s].
    """
    at = angles_of(x, plant, drive)
    k1 = first_slope(x, at, lag, direction, plant, drive, model)
    step = driven_step(x, at, k1, lag, direction, dt, plant, drive, model)
    margin, side = margin_of(x, at, step, lag, direction, dt, plant, drive, model)
    u = exit_fraction(margin)
    if u == 1.0:
        return step.state, step.torque, direction, dt
    z = driven_step(x, at, k1, lag, direction, u * dt, plant, drive, model)
    at_rest = ArmState(z.state.motor_angle, 0.0, z.state.torsion, z.state.torsion_speed)
    following = sliding_direction(at_rest, z.torque, plant, model, drive) if direction != 0.0 else side
    return at_rest, z.torque, following, u * dt
