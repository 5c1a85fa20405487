"""Observations of a block of arms, from their sensors and moves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltarm_env.jit import compiled, inlined
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.layout import LANES, load_move, load_plant, load_state
from beltarm_env.observation import ENTRIES, FULL, LOOKAHEADS, TIP
from beltarm_env.task.reference import TRAPEZOID, MoveShape, reference_at
from beltarm_env.task.sensors import speed_from_counts
from beltarm_env.timing import CONTROL_PERIOD

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

# Rows of a tile: the entries of all tiers, those of the encoder first.
_COMMON = len(ENTRIES["encoder"])
_TIP_ROW = _COMMON
_FULL_ROW = _COMMON + len(ENTRIES["tip"][_COMMON:])
_ROW_ENTRIES = (*ENTRIES["tip"], *ENTRIES["full"][_COMMON:])
TILE_ROWS = len(_ROW_ENTRIES)
_AHEAD = len(LOOKAHEADS)
_INVERSE_SCALE = np.array([1 / entry.scale for entry in _ROW_ENTRIES])
_BOUND = np.array([np.float32(entry.bound / entry.scale) for entry in _ROW_ENTRIES], dtype=np.float64)


@inlined
def _put(tile: Singles, lane: int, row: int, value: float) -> None:
    """Scale and clip a physical value into its row."""
    bound = _BOUND[row]
    tile[row * LANES + lane] = min(max(value * _INVERSE_SCALE[row], -bound), bound)


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
    _put(tile, lane, 6 + k, reference.speed)
    _put(tile, lane, 6 + _AHEAD + k, reference.acceleration)


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
        _put(tile, j, 0, reference.angle * gear - now * resolution)
        _put(tile, j, 1, reference.speed * gear - speed)
        _put(tile, j, 2, speed)
        _put(tile, j, 3, reference.angle)
        _put(tile, j, 4, reference.speed)
        _put(tile, j, 5, reference.acceleration)
        _look_ahead(tile, j, 0, profile, move, time)
        _look_ahead(tile, j, 1, profile, move, time)
        _look_ahead(tile, j, 2, profile, move, time)
        _look_ahead(tile, j, 3, profile, move, time)
        _look_ahead(tile, j, 4, profile, move, time)


@compiled
def _entries(block: Floats, tile: Singles, count: int, profile: int, tier: int) -> None:
    """Observation entries, one row each, in the order of `observation.ENTRIES`."""
    if profile == TRAPEZOID:  # the usual case as a constant, so that its loop does not compute the other profiles
        _motion_entries(block, tile, count, TRAPEZOID)
    else:
        _motion_entries(block, tile, count, profile)
    after = 6 + 2 * _AHEAD
    for j in range(count):
        move = load_move(block, j)
        _put(tile, j, after, move.start)
        _put(tile, j, after + 1, move.goal)
        _put(tile, j, after + 2, move.duration)
        _put(tile, j, after + 3, move.ramp_time)
        _put(tile, j, after + 4, block[at.STEP * LANES + j] * CONTROL_PERIOD)
        _put(tile, j, after + 5, block[at.ACTION * LANES + j])
    if tier == TIP:
        for j in range(count):
            _put(tile, j, _TIP_ROW, _delayed(block, at.TIP_SPEEDS, j))
    elif tier == FULL:
        for j in range(count):
            x = load_state(block, at.STATE, j)
            _put(tile, j, _FULL_ROW, x.torsion)
            _put(tile, j, _FULL_ROW + 1, x.torsion_speed)


@compiled
def observe_block(block: Floats, tile: Singles, observations: Singles, profile: int, tier: int) -> None:
    """Write the scaled and clipped observations of the first arms of a block.

    Args:
        block: As `_layout` describes.
        tile: Room for TILE_ROWS rows.
        observations: Shape (count, size).
        profile: Index into `reference.PROFILES`.
        tier: Index into `observation.SENSORS`.
    """
    _entries(block, tile, len(observations), profile, tier)
    _transpose(tile, observations, _FULL_ROW if tier == FULL else _TIP_ROW)


@compiled
def _transpose(tile: Singles, observations: Singles, first_extra: int) -> None:
    """Copy a tile, one row per entry, to observations, one row per arm; a tier's own entries begin at `first_extra`."""
    count, entries = observations.shape
    for j in range(count):
        for k in range(_COMMON):  # a constant, so that LLVM unrolls it
            observations[j, k] = tile[k * LANES + j]
    for k in range(_COMMON, entries):
        for j in range(count):
            observations[j, k] = tile[(first_extra + k - _COMMON) * LANES + j]
