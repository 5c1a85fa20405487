"""Motion of arms without sensors, reference and episodes: for controllers and observers that simulate their arm.

Many arms are simulated side by side, as `beltarm_env.simulation` describes; one arm is a block of one lane. A state has
4 entries, x, or 9 with the drive's beside them.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from beltarm_env.arm import plant_of
from beltarm_env.arrays import Floats
from beltarm_env.engine import compiled, inlined
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.advance import WORK_ROWS, advance_block
from beltarm_env.kernels.drives import begin_drive
from beltarm_env.kernels.layout import (
    IDEAL,
    LANES,
    REAL,
    Rows,
    aligned_zeros,
    empty_blocks,
    load_drive,
    load_plant,
    load_state,
    store_plant,
    store_state,
)
from beltarm_env.physics.drive import DRIVE_COLUMNS, resting
from beltarm_env.physics.models import Model
from beltarm_env.physics.state import ArmState
from beltarm_env.physics.substeps import integration_substeps
from beltarm_env.timing import LATENCY_SAMPLES

X = 4
"""Entries of an arm's state x."""
DRIVE_STATES = 2 + LATENCY_SAMPLES
"""Entries beside x: torque of the motor, past commands, and the deflection of a motor that gives before it slips."""


class Room(NamedTuple):
    """What the kernels of a simulation work in; the constants of the arms are in the blocks."""

    blocks: Rows  # shape (blocks, ROWS * LANES)
    work: Rows
    actions: Rows  # shape (LANES,)


def room_for(count: int) -> Room:
    """Room for n arms, whatever their drives."""
    return Room(empty_blocks(count), aligned_zeros(WORK_ROWS * LANES), aligned_zeros(LANES))


def state_size(table: Floats) -> int:
    """Entries of the states of arms: 9 where one among them has a real drive; columns as `ArmParams`."""
    return X + DRIVE_STATES if table[:, DRIVE_COLUMNS].any() else X


@compiled
def load_arm(block: Floats, lane: int, row: Any, model: Model) -> None:
    """Put an arm at the beginning of an episode into a lane, from its constants, the fields of `ArmParams`."""
    plant = plant_of(row)
    store_plant(block, lane, plant)
    block[at.SUBSTEPS * LANES + lane] = integration_substeps(plant, model)
    block[at.STEP * LANES + lane] = 0.0
    begin_drive(block, lane, row)


@inlined
def hold_friction(block: Floats, lane: int) -> None:
    """Let the friction of an arm be what it is at the beginning."""
    block[at.DRIFT * LANES + lane] = 0.0


@compiled
def rest_arm(block: Floats, lane: int, motor_angle: float, state: Floats) -> None:
    """Write the state at rest at a motor angle [rad], without torque in motor or belt; shape (size,)."""
    x = resting(motor_angle, load_plant(block, lane), load_drive(block, lane))
    state[:] = 0.0
    state[0], state[1], state[2], state[3] = x.motor_angle, x.motor_speed, x.torsion, x.torsion_speed


@inlined
def _beside(column: int) -> int:
    """Return the row of an entry of a state beside x."""
    return at.DEFLECTION if column == X + DRIVE_STATES - 1 else at.TORQUE + column - X


@inlined
def _put(block: Floats, lane: int, state: Floats) -> None:
    store_state(block, at.STATE, lane, ArmState(state[0], state[1], state[2], state[3]))
    for column in range(X, state.shape[0]):
        block[_beside(column) * LANES + lane] = state[column]


@inlined
def _take(block: Floats, lane: int, state: Floats) -> None:
    x = load_state(block, at.STATE, lane)
    state[0], state[1], state[2], state[3] = x.motor_angle, x.motor_speed, x.torsion, x.torsion_speed
    for column in range(X, state.shape[0]):
        state[column] = block[_beside(column) * LANES + lane]


@inlined
def action_of(torque: float, limit: float) -> float:
    """Return the action of a torque [N m]: it over its limit, cut to [-1, 1]."""
    return min(max(torque / limit, -1.0), 1.0)


@inlined
def move_towards(x: Floats, before: Floats, after: Floats, samples: float, k: int) -> None:
    """Move an arm's x on by what of a time ahead [samples] lies in the sample after k, from its states around that."""
    share = min(max(samples - k, 0.0), 1.0)
    for i in range(X):
        x[i] += share * (after[i] - before[i])


@compiled
def load_arms(blocks: Floats, table: Floats, steps: Floats, model: Model) -> None:
    """Load n arms; `steps` are the samples of the move that they are at, or empty for friction that is held."""
    for i in range(len(table)):
        block, lane = blocks[i // LANES], i % LANES
        load_arm(block, lane, table[i], model)
        if len(steps) == 0:
            hold_friction(block, lane)
        else:
            block[at.STEP * LANES + lane] = steps[i]


@compiled
def rest_arms(blocks: Floats, angles: Floats, states: Floats) -> None:
    """Write the states of n arms at rest, shape (n, size), see `rest_arm`."""
    for i in range(len(angles)):
        rest_arm(blocks[i // LANES], i % LANES, angles[i], states[i])


@compiled
def advance_arms(room: Room, states: Floats, actions: Floats, model: Model, result: Floats) -> None:
    """Write the states of n arms one control period later, shape (n, size); see `ArmSimulation.advance`."""
    count, size = states.shape
    for k in range((count + LANES - 1) // LANES):
        low, high = k * LANES, min(k * LANES + LANES, count)
        block = room.blocks[k]
        for i in range(low, high):
            _put(block, i - low, states[i])
            room.actions[i - low] = actions[i]
        if size > X:
            advance_block(block, room.work, room.actions, high - low, model, REAL)
        else:
            advance_block(block, room.work, room.actions, high - low, model, IDEAL)
        for i in range(low, high):
            _take(block, i - low, result[i])


@compiled
def look_ahead_arms(room: Room, states: Floats, actions: Floats, samples: Floats, model: Model, ahead: Floats) -> None:
    """Write x of n arms at times to come, shape (n, 4); see `ArmSimulation.ahead`."""
    count, size = states.shape
    before, after, longest = np.empty((count, size)), np.empty((count, size)), 0.0
    for i in range(count):
        for column in range(size):
            before[i, column] = states[i, column]
        for column in range(X):
            ahead[i, column] = states[i, column]
        longest = max(longest, samples[i])
    for k in range(math.ceil(longest)):
        advance_arms(room, before, actions, model, after)
        for i in range(count):
            move_towards(ahead[i], before[i], after[i], samples[i], k)
        before, after = after, before
