"""Observations of a block of arms, from their sensors and moves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltarm_env.engine import compiled, inlined
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.layout import LANES, RealDrive, StepSettings, load_move, load_plant
from beltarm_env.kernels.sense import encoder_reading, put_tier_entries
from beltarm_env.kernels.tile import put, transpose
from beltarm_env.observation import LOOKAHEADS, index
from beltarm_env.task.reference import TRAPEZOID, reference_at
from beltarm_env.task.sensors import around_half_a_turn
from beltarm_env.timing import CONTROL_PERIOD

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

_REFERENCE = index("reference_angle")
_AHEAD = index("reference_acceleration") + 1
_MOVE = index("start")
_LAST_COMMAND = index("last_command")
_HOLDS_PART = index("holds_part")


@inlined
def _put_common_entries(block: Floats, tile: Singles, lane: int, profile: int) -> None:
    """Put what all sensor tiers observe of an arm, but for the last command and the gripper.

    In the order of `observation.ENTRIES`: the compiler stores a group at once only if nothing else is stored between.
    """
    move, time = load_move(block, lane), block[at.STEP * LANES + lane] * CONTROL_PERIOD
    reference = reference_at(profile, move, time)
    gear = load_plant(block, lane).gear
    angle, speed = encoder_reading(block, lane)
    put(tile, lane, 0, reference.angle * gear - angle)
    put(tile, lane, 1, reference.speed * gear - speed)
    put(tile, lane, 2, speed)
    put(tile, lane, 3, angle)
    sine, cosine = around_half_a_turn(angle)
    put(tile, lane, 4, sine)
    put(tile, lane, 5, cosine)
    put(tile, lane, _REFERENCE, reference.angle)
    put(tile, lane, _REFERENCE + 1, reference.speed)
    put(tile, lane, _REFERENCE + 2, reference.acceleration)
    ahead_0 = reference_at(profile, move, time + LOOKAHEADS[0])
    ahead_1 = reference_at(profile, move, time + LOOKAHEADS[1])
    ahead_2 = reference_at(profile, move, time + LOOKAHEADS[2])
    ahead_3 = reference_at(profile, move, time + LOOKAHEADS[3])
    ahead_4 = reference_at(profile, move, time + LOOKAHEADS[4])
    put(tile, lane, _AHEAD, ahead_0.speed)
    put(tile, lane, _AHEAD + 1, ahead_1.speed)
    put(tile, lane, _AHEAD + 2, ahead_2.speed)
    put(tile, lane, _AHEAD + 3, ahead_3.speed)
    put(tile, lane, _AHEAD + 4, ahead_4.speed)
    put(tile, lane, _AHEAD + 5, ahead_0.acceleration)
    put(tile, lane, _AHEAD + 6, ahead_1.acceleration)
    put(tile, lane, _AHEAD + 7, ahead_2.acceleration)
    put(tile, lane, _AHEAD + 8, ahead_3.acceleration)
    put(tile, lane, _AHEAD + 9, ahead_4.acceleration)
    put(tile, lane, _MOVE, move.start)
    put(tile, lane, _MOVE + 1, move.goal)
    put(tile, lane, _MOVE + 2, move.duration)
    put(tile, lane, _MOVE + 3, move.ramp_time)
    put(tile, lane, _MOVE + 4, time)


@inlined
def _put_last_entries(block: Floats, tile: Singles, count: int, tier: int, real_drive: RealDrive) -> None:
    """Put what does not fill a group of the tile: the last command, the gripper, and what one sensor tier observes."""
    for j in range(count):
        put(tile, j, _LAST_COMMAND, block[at.ACTION * LANES + j])
        put(tile, j, _HOLDS_PART, block[at.HOLDS_PART * LANES + j])
    put_tier_entries(block, tile, count, tier, real_drive)


@inlined
def _put_all(block: Floats, tile: Singles, count: int, profile: int) -> None:
    for j in range(min(count, LANES)):  # a bound, without which the compiler fears that places in the tile overflow
        _put_common_entries(block, tile, j, profile)


@compiled
def observe_block(block: Floats, tile: Singles, observations: Singles, settings: StepSettings) -> None:
    """Write the scaled and clipped observations of the first arms of a block.

    Args:
        block: As `layout` describes.
        tile: Room for `tile.TILE_ROWS` rows.
        observations: Shape (count, size).
        settings: What is common to all arms.
    """
    count = len(observations)
    if (
        settings.profile == TRAPEZOID
    ):  # the usual case as a constant, so that its loop does not compute the other profiles
        _put_all(block, tile, count, TRAPEZOID)
    else:
        _put_all(block, tile, count, settings.profile)
    _put_last_entries(block, tile, count, settings.tier, settings.real_drive)
    transpose(tile, observations, settings.tier)


@compiled
def observe_arms(blocks: Floats, tile: Singles, observations: Singles, settings: StepSettings) -> None:
    """Write the observations of all arms, shape (N, size); arguments as of `observe_block`."""
    for k in range(len(blocks)):
        low = k * LANES
        observe_block(blocks[k], tile, observations[low : low + LANES], settings)


@compiled
def observe_some(
    blocks: Floats, tile: Singles, observations: Singles, arms: NDArray[np.intp], settings: StepSettings
) -> None:
    """Write the observations of some arms, one by one; arguments as of `observe_block`."""
    for arm in arms:
        block, lane = blocks[arm // LANES], arm % LANES  # a block that begins with a lane has this one as its first
        observe_block(block[lane:], tile, observations[arm : arm + 1], settings)
