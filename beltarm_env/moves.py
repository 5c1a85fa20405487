"""Moves: which ones are allowed, how they are drawn, and how much torque they ask for."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from beltarm_env.params import ArmParams
from beltarm_env.reference import PEAK_ACCELERATION, PEAK_SPEED, QUINTIC, MoveShape

Floats = NDArray[np.float64]

MOVE_FIELDS = MoveShape._fields
DRAWS = 5
"""Uniform draws a move takes."""

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
_RAMP_SHARE = (0.15, 0.35)  # of the duration
_ROUNDING = 1e-9

_NOMINAL = ArmParams()
_INERTIA = (
    _NOMINAL.motor_inertia + (_NOMINAL.arm_inertia + _NOMINAL.arm_inertia_swing) / _NOMINAL.gear_ratio**2
) * _NOMINAL.gear_ratio
_VISCOUS = _NOMINAL.motor_viscous_friction * _NOMINAL.gear_ratio
_CENTRIFUGAL = 0.5 * _NOMINAL.arm_inertia_swing / _NOMINAL.gear_ratio


def _peaks(profile: int, length: Floats, duration: Floats, ramp_time: Floats) -> tuple[Floats, Floats]:
    """Peak joint acceleration [rad/s^2] and speed [rad/s]."""
    if profile == QUINTIC:
        return PEAK_ACCELERATION[profile] * length / duration**2, PEAK_SPEED[profile] * length / duration
    cruise = length / (duration - ramp_time)
    return PEAK_ACCELERATION[profile] * cruise / ramp_time, PEAK_SPEED[profile] * cruise


def peak_torque(profile: int, length: Floats, duration: Floats, ramp_time: Floats) -> Floats:
    """Motor torque the nominal rigid arm needs at most [N m]: all peaks taken together, inertia as at 90 degrees."""
    acceleration, speed = _peaks(profile, length, duration, ramp_time)
    moving = _INERTIA * acceleration + _VISCOUS * speed + _CENTRIFUGAL * speed**2
    return moving + _NOMINAL.coulomb_friction


def shortest_duration(profile: int, length: Floats, ramp_share: Floats) -> Floats:
    """Shortest duration [s] of a feasible move whose ramps take `ramp_share` of it.

    With q = 1/duration, acceleration scales with q^2 and speed with q, so `peak_torque` is quadratic in q.
    """
    acceleration, speed = _peaks(profile, length, np.ones_like(length), ramp_share)
    quadratic = _INERTIA * acceleration + _CENTRIFUGAL * speed**2
    linear = _VISCOUS * speed
    spare = TORQUE_SHARE * _NOMINAL.torque_limit - _NOMINAL.coulomb_friction
    return 2 * quadratic / (np.sqrt(linear**2 + 4 * quadratic * spare) - linear)


def draw_moves(profile: int, uniforms: Floats, fixed: Mapping[str, Floats]) -> Floats:
    """Draw moves, all feasible: start and goal uniform over the pairs at least `SHORTEST` apart.

    Args:
        profile: Index into `reference.PROFILES`.
        uniforms: Draws in [0, 1), shape (n, DRAWS).
        fixed: Values of shape (n,) for any of `MOVE_FIELDS`, taken as they are.

    Returns:
        Table of moves, shape (n, 4), columns as `MOVE_FIELDS`.

    Raises:
        ValueError: If a fixed value leaves no allowed or no feasible move.
    """
    start, goal = _draw_ends(uniforms, fixed)
    length = np.maximum(np.abs(goal - start), _ROUNDING)
    quickest = _FASTEST_SHORT + (_FASTEST_LONG - _FASTEST_SHORT) * (length - SHORTEST) / (WORKSPACE - SHORTEST)
    ramp_share = _RAMP_SHARE[0] + (_RAMP_SHARE[1] - _RAMP_SHARE[0]) * uniforms[:, 4]
    drawn = quickest * (1 + _SLOWDOWN * uniforms[:, 3])
    drawn = np.maximum(drawn, shortest_duration(profile, length, ramp_share))
    if "ramp_time" in fixed:
        drawn = np.maximum(drawn, 2 * fixed["ramp_time"])
    duration = fixed.get("duration", drawn)
    ramp_time = fixed.get("ramp_time", ramp_share * duration)
    table = np.column_stack([start, goal, duration, ramp_time])
    check_moves(profile, table)
    return table


def _draw_ends(uniforms: Floats, fixed: Mapping[str, Floats]) -> tuple[Floats, Floats]:
    if "start" in fixed and "goal" in fixed:
        return fixed["start"], fixed["goal"]
    if "start" in fixed:
        return fixed["start"], _other_end(fixed["start"], uniforms[:, 0])
    if "goal" in fixed:
        return _other_end(fixed["goal"], uniforms[:, 0]), fixed["goal"]
    length = WORKSPACE - (WORKSPACE - SHORTEST) * np.sqrt(uniforms[:, 0])
    low = uniforms[:, 1] * (WORKSPACE - length)
    rising = uniforms[:, 2] < 0.5
    return np.where(rising, low, low + length), np.where(rising, low + length, low)


def _other_end(end: Floats, uniform: Floats) -> Floats:
    """A point at least `SHORTEST` from `end`, uniform over what the workspace leaves on both sides."""
    below = np.maximum(end - SHORTEST, 0.0)
    above = np.maximum(WORKSPACE - SHORTEST - end, 0.0)
    position = uniform * (below + above)
    return np.where(position < below, position, end + SHORTEST + (position - below))


def check_moves(profile: int, table: Floats) -> None:
    """Check a table of moves, shape (n, 4).

    Raises:
        ValueError: Naming the value that is not allowed, the bound, and what would do.
    """
    _require(np.isfinite(table).all(axis=1), table, "all values must be finite")
    start, goal, duration, ramp_time = table.T
    length = np.abs(goal - start)
    _require((start >= -_ROUNDING) & (start <= WORKSPACE + _ROUNDING), table, "start must lie within 0 and pi/2 rad")
    _require((goal >= -_ROUNDING) & (goal <= WORKSPACE + _ROUNDING), table, "goal must lie within 0 and pi/2 rad")
    _require(
        length >= SHORTEST - _ROUNDING, table, f"start and goal must be at least {SHORTEST:.4f} rad (15 degrees) apart"
    )
    _require(
        (duration > 0) & (duration <= LONGEST_TIME), table, f"duration must be positive and at most {LONGEST_TIME} s"
    )
    _require((ramp_time > 0) & (ramp_time <= duration / 2 + _ROUNDING), table, "ramp_time must be positive and at most half the duration")
    needed = peak_torque(profile, length, duration, ramp_time)
    limit = TORQUE_SHARE * _NOMINAL.torque_limit
    if (needed > limit + _ROUNDING).any():
        arm = int(np.argmax(needed))
        least = float(shortest_duration(profile, length, ramp_time / duration)[arm])
        raise ValueError(
            f"infeasible move {_describe(*table[arm])}: the nominal rigid arm needs {needed[arm]:.3f} N m, more than "
            f"{TORQUE_SHARE:.0%} of its limit, {limit:.3f} N m; with ramps of the same share, allow {least:.3f} s"
        )


def _require(allowed: NDArray[np.bool_], table: Floats, rule: str) -> None:
    if not allowed.all():
        raise ValueError(f"move: {rule}, got {_describe(*table[int(np.argmin(allowed))])}")


def _describe(start: float, goal: float, duration: float, ramp_time: float) -> str:
    return f"(start={start:.4g}, goal={goal:.4g}, duration={duration:.4g}, ramp_time={ramp_time:.4g})"
