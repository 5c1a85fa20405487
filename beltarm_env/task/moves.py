"""Moves: bounds, random draws, and the torque that they take."""

from __future__ import annotations

import math

import numpy as np

from beltarm_env.arm import NOMINAL
from beltarm_env.arrays import Flags, Floats
from beltarm_env.engine import compiled, inlined
from beltarm_env.task.reference import (
    QUINTIC,
    QUINTIC_PEAK_ACCELERATION,
    QUINTIC_PEAK_SPEED,
    SCURVE,
    SCURVE_PEAK_ACCELERATION,
    MoveShape,
)

MOVE_FIELDS = MoveShape._fields
DRAWS = 5
"""Uniform random numbers that a move takes."""

WORKSPACE = math.pi / 2
"""Moves stay within 0 and this angle [rad]."""
SHORTEST = math.radians(15)
"""Least distance between start and goal [rad]."""
LONGEST_TIME = 1.5
"""Longest duration [s]: leaves 0.3 s of the episode to see the arm ring."""
TORQUE_SHARE = 0.8
"""Share of the torque limit within which the nominal rigid arm must be able to follow a move."""

_FASTEST_SHORT, _FASTEST_LONG = 0.5, 0.8  # quickest duration of a 15 and of a 90 degree move [s]
_SLOWDOWN = 0.5  # durations are drawn up to this much longer than the quickest: 0.5 to 1.2 s in all
_LEAST_RAMP_SHARE, _MOST_RAMP_SHARE = 0.15, 0.35  # of the duration
_ROUNDING = 1e-9

_INERTIA = (
    NOMINAL.motor_inertia + (NOMINAL.arm_inertia + NOMINAL.arm_inertia_swing) / NOMINAL.gear_ratio**2
) * NOMINAL.gear_ratio
_VISCOUS = NOMINAL.motor_viscous_friction * NOMINAL.gear_ratio
_COULOMB = NOMINAL.coulomb_friction
_CENTRIFUGAL = 0.5 * NOMINAL.arm_inertia_swing / NOMINAL.gear_ratio

MOST_TORQUE = TORQUE_SHARE * NOMINAL.torque_limit
"""Most torque a move may ask of the nominal rigid arm [N m]."""


@inlined
def _peaks(profile: int, length: float, duration: float, ramp_time: float) -> tuple[float, float]:
    """Return peak joint acceleration [rad/s^2] and speed [rad/s]."""
    if profile == QUINTIC:
        return QUINTIC_PEAK_ACCELERATION * length / (duration * duration), QUINTIC_PEAK_SPEED * length / duration
    cruise = length / (duration - ramp_time)
    return (SCURVE_PEAK_ACCELERATION if profile == SCURVE else 1.0) * cruise / ramp_time, cruise


@inlined
def peak_torque(profile: int, length: float, duration: float, ramp_time: float) -> float:
    """Bound the motor torque that the nominal rigid arm needs [N m]: all peaks together, inertia of 90 degrees."""
    acceleration, speed = _peaks(profile, length, duration, ramp_time)
    return _INERTIA * acceleration + _VISCOUS * speed + _CENTRIFUGAL * speed * speed + _COULOMB


@inlined
def shortest_duration(profile: int, length: float, ramp_share: float) -> float:
    """Return the shortest duration [s] of a feasible move whose ramps take `ramp_share` of it.

    With q = 1/duration, acceleration scales with q^2 and speed with q, so `peak_torque` is quadratic in q.
    """
    acceleration, speed = _peaks(profile, length, 1.0, ramp_share)
    quadratic = _INERTIA * acceleration + _CENTRIFUGAL * speed * speed
    linear = _VISCOUS * speed
    spare = MOST_TORQUE - _COULOMB
    return 2 * quadratic / (math.sqrt(linear * linear + 4 * quadratic * spare) - linear)


@inlined
def _longest_move(profile: int, duration: float, ramp_share: float) -> float:
    """Return the longest feasible move in `duration` seconds [rad]: `peak_torque` is quadratic in the length too."""
    acceleration, speed = _peaks(profile, 1.0, duration, ramp_share * duration)
    linear = _INERTIA * acceleration + _VISCOUS * speed
    quadratic = _CENTRIFUGAL * speed * speed
    spare = MOST_TORQUE - _COULOMB
    return 2 * spare / (linear + math.sqrt(linear * linear + 4 * quadratic * spare))


@inlined
def _shortest_with_ramps(profile: int, length: float, ramp_time: float) -> float:
    """Return the shortest duration [s] with ramps of a given time: `peak_torque` is quadratic in the speed."""
    if profile == QUINTIC:
        return shortest_duration(profile, length, 0.5)
    acceleration, _ = _peaks(profile, 1.0, ramp_time + 1.0, ramp_time)  # at a cruising speed of 1 rad/s
    linear = _INERTIA * acceleration + _VISCOUS
    spare = MOST_TORQUE - _COULOMB
    cruise = 2 * spare / (linear + math.sqrt(linear * linear + 4 * _CENTRIFUGAL * spare))
    return ramp_time + length / cruise


@inlined
def _other_end(end: float, uniform: float, longest: float) -> float:
    """Choose a point between `SHORTEST` and `longest` from `end`, uniform over what the workspace leaves."""
    below = max(min(end, longest) - SHORTEST, 0.0)
    above = max(min(WORKSPACE - end, longest) - SHORTEST, 0.0)
    position = uniform * (below + above)
    return end - SHORTEST - position if position < below else end + SHORTEST + (position - below)


@inlined
def _draw_ends(uniforms: Floats, start: float, goal: float, longest: float) -> tuple[float, float]:
    """Choose start and goal, where not given (NaN) uniform over the pairs between `SHORTEST` and `longest` apart."""
    if start == start and goal == goal:
        return start, goal
    if start == start:
        return start, _other_end(start, uniforms[0], longest)
    if goal == goal:
        return _other_end(goal, uniforms[0], longest), goal
    least, most = WORKSPACE - max(longest, SHORTEST), WORKSPACE - SHORTEST  # room that is left beside the move
    length = WORKSPACE - math.sqrt(least * least + (most * most - least * least) * uniforms[0])
    low = uniforms[1] * (WORKSPACE - length)
    return (low, low + length) if uniforms[2] < 0.5 else (low + length, low)


@compiled
def draw_moves(profile: int, uniforms: Floats, given: Floats) -> Floats:
    """Draw moves, feasible wherever what is given allows it.

    Args:
        profile: Index into `reference.PROFILES`.
        uniforms: Draws in [0, 1), shape (n, DRAWS).
        given: Values taken as they are, NaN where to draw, shape (n, 4), columns as `MOVE_FIELDS`.

    Returns:
        Table of moves, shape (n, 4). Given values make `check_moves` necessary.
    """
    table = np.empty((len(uniforms), 4))
    for i in range(len(uniforms)):
        u = uniforms[i]
        duration, ramp_time = given[i, 2], given[i, 3]
        ramp_share = _LEAST_RAMP_SHARE + (_MOST_RAMP_SHARE - _LEAST_RAMP_SHARE) * u[4]
        longest = WORKSPACE
        if duration > 0.0:  # given: longer ramps, and then a shorter move, where it would take too much torque
            steady_share = ramp_time / duration if ramp_time > 0.0 else _MOST_RAMP_SHARE
            longest = min(_longest_move(profile, duration, steady_share), WORKSPACE)
        elif ramp_time > 0.0:
            longest = min(_longest_move(profile, LONGEST_TIME, ramp_time / LONGEST_TIME), WORKSPACE)
        start, goal = _draw_ends(u, given[i, 0], given[i, 1], longest)
        length = max(abs(goal - start), SHORTEST)
        if duration != duration:
            quickest = _FASTEST_SHORT + (_FASTEST_LONG - _FASTEST_SHORT) * (length - SHORTEST) / (WORKSPACE - SHORTEST)
            duration = quickest * (1 + _SLOWDOWN * u[3])
            if ramp_time > 0.0:
                duration = max(duration, 2 * ramp_time, _shortest_with_ramps(profile, length, ramp_time))
            else:
                duration = max(duration, shortest_duration(profile, length, ramp_share))
            if duration < LONGEST_TIME + _ROUNDING:  # the longest move of all may come out a rounding error too long
                duration = min(duration, LONGEST_TIME)
        elif duration < shortest_duration(profile, length, ramp_share):
            ramp_share = _MOST_RAMP_SHARE
        if ramp_time != ramp_time:
            ramp_time = ramp_share * duration
        table[i, 0], table[i, 1], table[i, 2], table[i, 3] = start, goal, duration, ramp_time
    return table


def check_moves(profile: int, table: Floats) -> None:
    """Check a table of moves, shape (n, 4).

    Raises:
        ValueError: Naming the value that is not allowed, the bound, and what would do.
    """
    _require(np.all(np.isfinite(table), axis=1), table, "all values must be finite")
    start, goal, duration, ramp_time = table.T
    length = np.abs(goal - start)
    _require((start >= -_ROUNDING) & (start <= WORKSPACE + _ROUNDING), table, "start must lie within 0 and pi/2 rad")
    _require((goal >= -_ROUNDING) & (goal <= WORKSPACE + _ROUNDING), table, "goal must lie within 0 and pi/2 rad")
    _require(
        length >= SHORTEST - _ROUNDING, table, f"start and goal must be at least {SHORTEST:.4f} rad (15 degrees) apart"
    )
    _require(
        (duration > 0) & (duration <= LONGEST_TIME + _ROUNDING),
        table,
        f"duration must be positive and at most {LONGEST_TIME} s",
    )
    _require(
        (ramp_time > 0) & (ramp_time <= duration / 2 + _ROUNDING),
        table,
        "ramp_time must be positive and at most half the duration",
    )
    for move, span in zip(table, length, strict=True):
        needed = peak_torque(profile, float(span), float(move[2]), float(move[3]))
        if needed > MOST_TORQUE + _ROUNDING:
            least = math.ceil(1000 * shortest_duration(profile, float(span), float(move[3] / move[2]))) / 1000
            raise ValueError(
                f"infeasible move {_describe(*move)}: the nominal rigid arm needs {needed:.3f} N m, more than "
                f"{TORQUE_SHARE:.0%} of its limit, {MOST_TORQUE:.3f} N m; with ramps of the same share, allow "
                f"{least:.3f} s"
            )


def _require(allowed: Flags, table: Floats, rule: str) -> None:
    if not allowed.all():
        raise ValueError(f"move: {rule}, got {_describe(*table[int(np.argmin(allowed))])}")


def _describe(start: float, goal: float, duration: float, ramp_time: float) -> str:
    return f"(start={start:.4g}, goal={goal:.4g}, duration={duration:.4g}, ramp_time={ramp_time:.4g})"
