"""One control sample for a block of arms, from the torque commands to the observations.

`step_arms` serves a batch and `step_arm` a single arm; both run `_step_block`, so there is one copy of the dynamics, of
the sensors, of the cost and of the observation. Each phase is a flat loop over the lanes of a block that the
compiler vectorises.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltarm_env.engine import compiled, inlined
from beltarm_env.engine.blocks import take_block
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.advance import WORK_ROWS, advance_block
from beltarm_env.kernels.episodes import totals_so_far
from beltarm_env.kernels.layout import (
    LANES,
    RealDrive,
    StepSettings,
    aligned_rows,
    drive_among,
    load_move,
    load_plant,
    load_state,
)
from beltarm_env.kernels.observe import observe_block
from beltarm_env.kernels.sense import sense_block
from beltarm_env.kernels.tile import TILE_ROWS
from beltarm_env.physics.kinematics import outside_workspace, tip_motion
from beltarm_env.task.cost import MAX_COST, STILL_BAND, StepCost, step_cost
from beltarm_env.task.reference import TRAPEZOID, reference_at
from beltarm_env.timing import CONTROL_PERIOD, EPISODE_STEPS

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Flags = NDArray[np.bool_]
Integers = NDArray[np.int64]

HUGE = 1e300
"""Beyond every action."""

# Scratch rows of a step.
ACTION = 0  # torque over its limit
TERMS = ACTION + 1  # tip error and the three cost terms
REWARD = TERMS + 4
TERMINATED = REWARD + 1
TRUNCATED = TERMINATED + 1
_WORK = TRUNCATED + 1  # rows of `advance`
SCRATCH_ROWS = _WORK + WORK_ROWS


class Rooms(NamedTuple):
    """What the kernels work in, a row for each thread."""

    scratches: Floats
    tiles: Singles


class Exchange(NamedTuple):
    """What N arms are told in a step, and what comes of it, which is written."""

    actions: Floats  # torque over the torque limit, shape (N,), cut to [-1, 1]
    observations: Singles  # shape (N, size)
    rewards: Floats  # shape (N,)
    terminated: Flags  # shape (N,)
    truncated: Flags  # shape (N,)
    terms: Floats  # tip error [m] and the three cost terms, shape (4, N)


def new_rooms(threads: int, lanes: int = LANES) -> Rooms:
    """Allocate rooms; once, because allocation takes time."""
    tiles = aligned_rows(threads, -(-TILE_ROWS // 2) * lanes).view(np.float32)
    return Rooms(aligned_rows(threads, SCRATCH_ROWS * lanes), tiles)


@inlined
def _note_rest(block: Floats, j: int, cost: StepCost, step: float) -> None:
    """Note how far the tip swings after the move's end, and the last step after which it was not still."""
    after = step * CONTROL_PERIOD >= block[(at.MOVE + 2) * LANES + j]
    for k, error in enumerate((cost.x, -cost.x, cost.y, -cost.y)):
        most = block[(at.SWINGS + k) * LANES + j]
        block[(at.SWINGS + k) * LANES + j] = error if after & (error > most) else most
    last = block[at.UNSTILL * LANES + j]
    block[at.UNSTILL * LANES + j] = step if cost.tip_error > STILL_BAND else last


@inlined
def _charge_profile(block: Floats, scratch: Floats, count: int, profile: int, real_drive: RealDrive) -> None:
    """Charge the cost of the step, add to the move's totals, and find whether it is over."""
    for j in range(count):
        x = load_state(block, at.STATE, j)
        plant = load_plant(block, j)
        action = scratch[ACTION * LANES + j]
        step = block[at.STEP * LANES + j] + 1.0
        reference = reference_at(profile, load_move(block, j), step * CONTROL_PERIOD)
        tip = tip_motion(x, plant, drive_among(block, j, real_drive))
        cost = step_cost(tip, reference.angle, reference.speed, action, block[at.ACTION * LANES + j], plant)
        block[at.STEP * LANES + j] = step
        block[at.ACTION * LANES + j] = action
        scratch[TERMS * LANES + j] = cost.tip_error
        scratch[(TERMS + 1) * LANES + j] = cost.position
        scratch[(TERMS + 2) * LANES + j] = cost.velocity
        scratch[(TERMS + 3) * LANES + j] = cost.torque_rate
        block[at.TOTALS * LANES + j] += cost.position
        block[(at.TOTALS + 1) * LANES + j] += cost.velocity
        block[(at.TOTALS + 2) * LANES + j] += cost.torque_rate
        block[(at.TOTALS + 3) * LANES + j] += cost.tip_error * cost.tip_error
        largest = block[(at.TOTALS + 4) * LANES + j]
        block[(at.TOTALS + 4) * LANES + j] = cost.tip_error if cost.tip_error > largest else largest
        _note_rest(block, j, cost, step)
        outside = outside_workspace(x, plant)
        remaining = EPISODE_STEPS - step if outside else 0.0
        scratch[REWARD * LANES + j] = -(cost.position + cost.velocity + cost.torque_rate + MAX_COST * remaining)
        scratch[TERMINATED * LANES + j] = 1.0 if outside else 0.0
        scratch[TRUNCATED * LANES + j] = 1.0 if step >= EPISODE_STEPS else 0.0


@inlined
def _consider_further_moves(block: Floats, scratch: Floats, count: int) -> None:
    """Charge arms that left their workspace for further moves, too; others go on where there are some.

    In a loop of its own, for few steps end a move: the loop over all arms is quicker without the moves that are left.
    """
    for j in range(count):
        left = block[at.MOVES_LEFT * LANES + j]
        further = MAX_COST * EPISODE_STEPS * left if scratch[TERMINATED * LANES + j] != 0.0 else 0.0
        scratch[REWARD * LANES + j] -= further
        scratch[TRUNCATED * LANES + j] = 0.0 if left > 0.0 else scratch[TRUNCATED * LANES + j]


@compiled
def charge(block: Floats, scratch: Floats, count: int, profile: int, real_drive: RealDrive) -> None:
    """Charge the first arms of a block for a step: its cost, the episode's totals, and whether the episode is over.

    Args:
        block: As `layout` describes.
        scratch: Rows of a step, with the actions; the results are written.
        count: Number of arms.
        profile: Index into `reference.PROFILES`.
        real_drive: Whether real drives are among the arms.
    """
    if profile == TRAPEZOID:  # the usual case as a constant, so that its loop does not compute the other profiles
        _charge_profile(block, scratch, count, TRAPEZOID, real_drive)
    else:
        _charge_profile(block, scratch, count, profile, real_drive)
    ended = 0
    for j in range(count):
        ended += 1 if scratch[TERMINATED * LANES + j] + scratch[TRUNCATED * LANES + j] > 0.0 else 0
    if ended > 0:
        _consider_further_moves(block, scratch, count)


@compiled
def _step_block(block: Floats, scratch: Floats, tile: Singles, observations: Singles, settings: StepSettings) -> None:
    """Step the arms of one block by one control period; actions are in scratch, results go to scratch."""
    count, real_drive = len(observations), settings.real_drive
    if settings.integrate:
        work, actions = scratch[_WORK * LANES :], scratch[ACTION * LANES : (ACTION + 1) * LANES]
        advance_block(block, work, actions, count, settings.model, real_drive)
    sense_block(block, count, settings.tier, real_drive)
    charge(block, scratch, count, settings.profile, real_drive)
    observe_block(block, tile, observations, settings)


@compiled
def step_arms(
    thread: int,
    blocks: Floats,
    taken: Integers,
    rooms: Rooms,
    exchange: Exchange,
    settings: StepSettings,
) -> None:
    """Step N arms by one control period, those of the blocks that a thread takes; results are written in place.

    Args:
        thread: Index of the thread.
        blocks: The arms, as `layout` describes.
        taken: Of `none_taken`, for as many threads as there are.
        rooms: To work in.
        exchange: Actions, and what comes of them.
        settings: What is common to all arms.
    """
    scratch, tile = rooms.scratches[thread], rooms.tiles[thread]
    while True:
        k = take_block(taken, thread, len(blocks))
        if k < 0:
            break
        low = k * LANES
        high = min(low + LANES, len(exchange.actions))
        _take_actions(exchange.actions[low:high], scratch)
        _step_block(blocks[k], scratch, tile, exchange.observations[low:high], settings)
        _give_flags(scratch, TERMINATED, exchange.terminated[low:high])
        _give_flags(scratch, TRUNCATED, exchange.truncated[low:high])
        _give(scratch, REWARD, exchange.rewards[low:high])
        for row in range(len(exchange.terms)):
            _give(scratch, TERMS + row, exchange.terms[row, low:high])


@compiled
def _take_actions(actions: Floats, scratch: Floats) -> None:
    for j in range(len(actions)):
        scratch[ACTION * LANES + j] = min(max(actions[j], -1.0), 1.0)


@compiled
def _give(scratch: Floats, row: int, values: Floats) -> None:
    source = scratch[row * LANES : (row + 1) * LANES]
    for j in range(len(values)):
        values[j] = source[j]


@compiled
def _give_flags(scratch: Floats, row: int, flags: Flags) -> None:
    source = scratch[row * LANES : (row + 1) * LANES]
    for j in range(len(flags)):
        flags[j] = source[j] != 0.0


@compiled
def step_arm(
    blocks: Floats, scratch: Floats, tile: Singles, settings: StepSettings, action: float, observation: Singles
) -> tuple[Singles, float, bool, bool, dict[str, float]]:
    """Step a single arm, lane 0 of the first block, by one control period.

    Args:
        blocks: The arm, as `layout` describes.
        scratch: Row of a room.
        tile: Row of a room.
        settings: What is common to all arms.
        action: Torque over the torque limit, cut to [-1, 1].
        observation: Written in place, shape (size,).

    Raises:
        ValueError: If the action is not finite, or beyond `HUGE`; the arm is then left as it was.

    Returns:
        The observation, reward, terminated, truncated, and what the environment tells in its `info`: totals, too, in
        every step, because a wrapper may end the episode.
    """
    if not -HUGE < action < HUGE:
        raise ValueError("the action is not finite")
    scratch[ACTION * LANES] = min(max(action, -1.0), 1.0)
    _step_block(blocks[0], scratch, tile, observation.reshape(1, -1), settings)
    terminated = bool(scratch[TERMINATED * LANES] != 0.0)
    total, position, velocity, torque_rate, steps, rms, largest = totals_so_far(blocks[0], 0, terminated)
    info = {
        "tip_error": float(scratch[TERMS * LANES]),
        "cost_position": float(scratch[(TERMS + 1) * LANES]),
        "cost_velocity": float(scratch[(TERMS + 2) * LANES]),
        "cost_torque_rate": float(scratch[(TERMS + 3) * LANES]),
        "total_cost": total,
        "total_cost_position": position,
        "total_cost_velocity": velocity,
        "total_cost_torque_rate": torque_rate,
        "episode_steps": steps,
        "tip_error_rms": rms,
        "tip_error_max": largest,
    }
    truncated = bool(scratch[TRUNCATED * LANES] != 0.0)
    return observation, float(scratch[REWARD * LANES]), terminated, truncated, info
