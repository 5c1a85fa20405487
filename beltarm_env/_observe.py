"""Observations of a block of arms, from their sensors and moves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltarm_env import _layout as at
from beltarm_env._constants import CONTROL_PERIOD
from beltarm_env._jit import compiled, inlined
from beltarm_env._layout import LANES, load_move, load_plant, load_state
from beltarm_env.observation import ENTRIES, FULL, LOOKAHEADS, SENSORS, TIP, bounds, scales, size
from beltarm_env.reference import QUINTIC, SCURVE, TRAPEZOID, MoveShape, reference_at
from beltarm_env.sensors import speed_from_counts

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

MOST_ENTRIES = max(len(entries) for entries in ENTRIES.values())
_COMMON = len(ENTRIES["encoder"])
_AHEAD = len(LOOKAHEADS)
_INVERSE_SCALE = np.ones((len(SENSORS), MOST_ENTRIES))
_BOUND = np.ones((len(SENSORS), MOST_ENTRIES))
for _tier, _sensors in enumerate(SENSORS):
    _INVERSE_SCALE[_tier, : size(_sensors)] = 1 / scales(_sensors)
    _BOUND[_tier, : size(_sensors)] = bounds(_sensors)


@inlined
def _put(tile: Singles, lane: int, tier: int, entry: int, value: float) -> None:
    """Scale and clip a physical value into the row of its entry."""
    bound = _BOUND[tier, entry]
    tile[entry * LANES + lane] = min(max(value * _INVERSE_SCALE[tier, entry], -bound), bound)


@inlined
def _delayed(block: Floats, row: int, lane: int) -> float:
    """A reading from a sensor's history: row holds the latest, the next rows older ones."""
    delay = block[at.DELAY * LANES + lane]
    latest = block[row * LANES + lane]
    once = block[(row + 1) * LANES + lane]
    twice = block[(row + 2) * LANES + lane]
    return latest if delay == 0.0 else (once if delay == 1.0 else twice)


@inlined
def _look_ahead(tile: Singles, lane: int, k: int, profile: int, move: MoveShape, time: float) -> None:
    reference = reference_at(profile, move, time + LOOKAHEADS[k])
    _put(tile, lane, 0, 6 + k, reference.speed)
    _put(tile, lane, 0, 6 + _AHEAD + k, reference.acceleration)


@inlined
def _motion_entries(block: Floats, tile: Singles, count: int, profile: int) -> None:
    """Entries that depend on the reference's profile: errors, speed, reference now and ahead."""
    for j in range(count):
        gear = load_plant(block, j).gear
        move = load_move(block, j)
        resolution = block[at.RESOLUTION * LANES + j]
        now = _delayed(block, at.COUNTS, j)
        speed = speed_from_counts(now, _delayed(block, at.COUNTS + 1, j), resolution)
        time = block[at.STEP * LANES + j] * CONTROL_PERIOD
        reference = reference_at(profile, move, time)
        _put(tile, j, 0, 0, reference.angle * gear - now * resolution)
        _put(tile, j, 0, 1, reference.speed * gear - speed)
        _put(tile, j, 0, 2, speed)
        _put(tile, j, 0, 3, reference.angle)
        _put(tile, j, 0, 4, reference.speed)
        _put(tile, j, 0, 5, reference.acceleration)
        _look_ahead(tile, j, 0, profile, move, time)
        _look_ahead(tile, j, 1, profile, move, time)
        _look_ahead(tile, j, 2, profile, move, time)
        _look_ahead(tile, j, 3, profile, move, time)
        _look_ahead(tile, j, 4, profile, move, time)


@compiled
def _entries(block: Floats, tile: Singles, count: int, profile: int, tier: int) -> None:
    """Observation entries, one row each, in the order of `observation.ENTRIES`."""
    if profile == TRAPEZOID:  # constants from here on, so that each loop holds the equations of one profile only
        _motion_entries(block, tile, count, TRAPEZOID)
    elif profile == SCURVE:
        _motion_entries(block, tile, count, SCURVE)
    else:
        _motion_entries(block, tile, count, QUINTIC)
    after = 6 + 2 * _AHEAD
    for j in range(count):
        move = load_move(block, j)
        _put(tile, j, 0, after, move.start)
        _put(tile, j, 0, after + 1, move.goal)
        _put(tile, j, 0, after + 2, move.duration)
        _put(tile, j, 0, after + 3, move.ramp_time)
        _put(tile, j, 0, after + 4, block[at.STEP * LANES + j] * CONTROL_PERIOD)
        _put(tile, j, 0, after + 5, block[at.ACTION * LANES + j])
    if tier == TIP:
        for j in range(count):
            _put(tile, j, TIP, _COMMON, _delayed(block, at.TIP_SPEEDS, j))
    elif tier == FULL:
        for j in range(count):
            x = load_state(block, at.STATE, j)
            _put(tile, j, FULL, _COMMON, x.torsion)
            _put(tile, j, FULL, _COMMON + 1, x.torsion_speed)


@compiled
def observe_block(block: Floats, tile: Singles, observations: Singles, profile: int, tier: int) -> None:
    """Write the scaled and clipped observations of the first arms of a block.

    Args:
        block: As `_layout` describes.
        tile: Room for MOST_ENTRIES rows.
        observations: Shape (count, size).
        profile: Index into `reference.PROFILES`.
        tier: Index into `observation.SENSORS`.
    """
    _entries(block, tile, len(observations), profile, tier)
    _transpose(tile, observations)


@compiled
def _transpose(tile: Singles, observations: Singles) -> None:
    """Copy a tile, one row per entry, to observations, one row per arm."""
    count, entries = observations.shape
    for j in range(count):
        for k in range(_COMMON):  # a constant, so that LLVM unrolls it
            observations[j, k] = tile[k * LANES + j]
    for k in range(_COMMON, entries):
        for j in range(count):
            observations[j, k] = tile[k * LANES + j]
