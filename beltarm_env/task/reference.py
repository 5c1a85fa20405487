"""Reference motion of the joint: the move asked of the arm, as angle, speed and acceleration over time.

A move leads from `start` to `goal` in `duration` seconds:

- `trapezoid` (the paper's): speed rises linearly for `ramp_time`, stays, and falls linearly for `ramp_time`;
- `scurve`: the same with ramps 3u^2 - 2u^3, so that the acceleration is continuous;
- `quintic`: the minimum-jerk polynomial 10u^3 - 15u^4 + 6u^5 over the whole duration; `ramp_time` has no effect.

After the move the reference rests at the goal.
"""

from __future__ import annotations

from typing import Literal, NamedTuple, get_args

import numpy as np

from beltarm_env.arrays import Floats
from beltarm_env.engine import compiled, inlined
from beltarm_env.timing import CONTROL_PERIOD, EPISODE_STEPS

Profile = Literal["trapezoid", "scurve", "quintic"]
PROFILES: tuple[Profile, ...] = get_args(Profile)
TRAPEZOID, SCURVE, QUINTIC = range(3)
SCURVE_PEAK_ACCELERATION = 1.5
"""Peak acceleration of a ramp over its mean: the steepest slope of 3u^2 - 2u^3. A linear ramp has 1."""
QUINTIC_PEAK_ACCELERATION = 10 / 3**0.5
"""Peak acceleration over displacement / duration^2."""
QUINTIC_PEAK_SPEED = 1.875
"""Peak speed over displacement / duration."""


class MoveShape(NamedTuple):
    """One move, as the kernels see it."""

    start: float  # [rad]
    goal: float  # [rad]
    duration: float  # [s]
    ramp_time: float  # [s]


class Reference(NamedTuple):
    """Reference at one instant, at the joint."""

    angle: float  # [rad]
    speed: float  # [rad/s]
    acceleration: float  # [rad/s^2]


@inlined
def linear_ramp(u: float) -> tuple[float, float, float]:
    """Return integral, value and slope of a ramp that rises from 0 to 1 over 0 <= u < 1, linearly."""
    c = 0.0 if u < 0.0 else (1.0 if u > 1.0 else u)
    beyond = u - 1.0 if u > 1.0 else 0.0
    slope = 1.0 if (u >= 0.0) & (u < 1.0) else 0.0
    return 0.5 * c * c + beyond, c, slope


@inlined
def smooth_ramp(u: float) -> tuple[float, float, float]:
    """Return integral, value and slope of the ramp 3u^2 - 2u^3."""
    c = 0.0 if u < 0.0 else (1.0 if u > 1.0 else u)
    beyond = u - 1.0 if u > 1.0 else 0.0
    return c * c * c * (1.0 - 0.5 * c) + beyond, c * c * (3.0 - 2.0 * c), 6.0 * c * (1.0 - c)


@inlined
def _between_ramps(
    move: MoveShape, ramp_rate: float, up: tuple[float, float, float], down: tuple[float, float, float]
) -> Reference:
    """Return the motion whose speed is one ramp up minus one ramp down, times the cruising speed."""
    cruise = (move.goal - move.start) / (move.duration - move.ramp_time)
    return Reference(
        move.start + cruise * move.ramp_time * (up[0] - down[0]),
        cruise * (up[1] - down[1]),
        cruise * ramp_rate * (up[2] - down[2]),
    )


@inlined
def _quintic(move: MoveShape, time: float) -> Reference:
    rate = 1.0 / move.duration
    u = time * rate
    c = 0.0 if u < 0.0 else (1.0 if u > 1.0 else u)
    length = move.goal - move.start
    return Reference(
        move.start + length * (c * c * c * (10.0 + c * (6.0 * c - 15.0))),
        length * rate * (30.0 * c * c * (1.0 - c) * (1.0 - c)),
        length * rate * rate * (60.0 * c * (1.0 - c) * (1.0 - 2.0 * c)),
    )


@inlined
def reference_at(profile: int, move: MoveShape, time: float) -> Reference:
    """Return the reference angle, speed and acceleration at the joint, `time` seconds after the move's start.

    Accelerations that jump (`trapezoid`) take the value that holds from this instant on.
    """
    if profile == QUINTIC:
        return _quintic(move, time)
    ramp_rate = 1.0 / move.ramp_time  # does not depend on time: computed once for all lookaheads
    rising = time * ramp_rate
    falling = (time - (move.duration - move.ramp_time)) * ramp_rate
    if profile == SCURVE:
        return _between_ramps(move, ramp_rate, smooth_ramp(rising), smooth_ramp(falling))
    return _between_ramps(move, ramp_rate, linear_ramp(rising), linear_ramp(falling))


def sampled_moves(moves: Floats, steps: int = EPISODE_STEPS) -> Floats:
    """Sample the trapezoid references of n moves, for controllers that know the whole move beforehand.

    Args:
        moves: Start, goal [rad], duration, ramp time [s]; shape (n, 4).
        steps: Control periods.

    Returns:
        Angle [rad], speed [rad/s] and acceleration [rad/s^2] from the start on, shape (n, steps + 1, 3).
    """
    samples = np.empty((len(moves), steps + 1, 3))
    _sample(np.ascontiguousarray(moves), samples)
    return samples


@compiled
def _sample(moves: Floats, samples: Floats) -> None:
    for i in range(len(moves)):
        move = MoveShape(moves[i, 0], moves[i, 1], moves[i, 2], moves[i, 3])
        for k in range(samples.shape[1]):
            samples[i, k, 0], samples[i, k, 1], samples[i, k, 2] = reference_at(TRAPEZOID, move, k * CONTROL_PERIOD)
