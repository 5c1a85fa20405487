"""Observations of a block of arms, from their sensors and moves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltarm_env.jit import compiled, inlined
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.layout import LANES, Driven, load_move, load_plant
from beltarm_env.kernels.sense import encoder_reading, put_tier_entries
from beltarm_env.kernels.tile import put, transpose
from beltarm_env.observation import LOOKAHEADS, index
from beltarm_env.task.reference import TRAPEZOID, MoveShape, reference_at
from beltarm_env.task.sensors import around_half_a_turn
from beltarm_env.timing import CONTROL_PERIOD

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Flags = NDArray[np.bool_]

_AHEAD = len(LOOKAHEADS)
_REFERENCE = index("reference_angle")


@inlined
def _look_ahead(tile: Singles, lane: int, k: int, profile: int, move: MoveShape, time: float) -> None:
    reference = reference_at(profile, move, time + LOOKAHEADS[k])
    put(tile, lane, _REFERENCE + 3 + k, reference.speed)
    put(tile, lane, _REFERENCE + 3 + _AHEAD + k, reference.acceleration)


@inlined
def _motion_entries(block: Floats, tile: Singles, count: int, profile: int) -> None:
    """Put what the encoder measures, and the reference now and ahead, which depends on its profile."""
    for j in range(count):
        gear = load_plant(block, j).gear
        move = load_move(block, j)
        angle, speed = encoder_reading(block, j)
        time = block[at.STEP * LANES + j] * CONTROL_PERIOD
        reference = reference_at(profile, move, time)
        put(tile, j, 0, reference.angle * gear - angle)
        put(tile, j, 1, reference.speed * gear - speed)
        put(tile, j, 2, speed)
        put(tile, j, 3, angle)
        sine, cosine = around_half_a_turn(angle)
        put(tile, j, 4, sine)
        put(tile, j, 5, cosine)
        put(tile, j, _REFERENCE, reference.angle)
        put(tile, j, _REFERENCE + 1, reference.speed)
        put(tile, j, _REFERENCE + 2, reference.acceleration)
        _look_ahead(tile, j, 0, profile, move, time)
        _look_ahead(tile, j, 1, profile, move, time)
        _look_ahead(tile, j, 2, profile, move, time)
        _look_ahead(tile, j, 3, profile, move, time)
        _look_ahead(tile, j, 4, profile, move, time)


@compiled
def _entries(block: Floats, tile: Singles, count: int, profile: int, tier: int, driven: Driven) -> None:
    """Put all observation entries, one row each, in the order of `observation.ENTRIES`."""
    if profile == TRAPEZOID:  # the usual case as a constant, so that its loop does not compute the other profiles
        _motion_entries(block, tile, count, TRAPEZOID)
    else:
        _motion_entries(block, tile, count, profile)
    after = _REFERENCE + 3 + 2 * _AHEAD
    for j in range(count):
        move = load_move(block, j)
        put(tile, j, after, move.start)
        put(tile, j, after + 1, move.goal)
        put(tile, j, after + 2, move.duration)
        put(tile, j, after + 3, move.ramp_time)
        put(tile, j, after + 4, block[at.STEP * LANES + j] * CONTROL_PERIOD)
        put(tile, j, after + 5, block[at.ACTION * LANES + j])
    put_tier_entries(block, tile, count, tier, driven)


@compiled
def observe_block(block: Floats, tile: Singles, observations: Singles, profile: int, tier: int, driven: Driven) -> None:
    """Write the scaled and clipped observations of the first arms of a block.

    Args:
        block: As `layout` describes.
        tile: Room for `tile.TILE_ROWS` rows.
        observations: Shape (count, size).
        profile: Index into `reference.PROFILES`.
        tier: Index into `observation.SENSORS`.
        driven: Whether drives as they are built are among the arms.
    """
    _entries(block, tile, len(observations), profile, tier, driven)
    transpose(tile, observations, tier)


@compiled
def observe_arms(
    blocks: Floats,
    tile: Singles,
    observations: Singles,
    chosen: Flags,
    profile: int,
    tier: int,
    driven: Driven,
) -> None:
    """Write the observations of all arms in those blocks where `chosen`, shape (blocks,), is true."""
    for k in range(len(blocks)):
        if chosen[k]:
            low = k * LANES
            high = min(low + LANES, len(observations))
            observe_block(blocks[k], tile, observations[low:high], profile, tier, driven)
