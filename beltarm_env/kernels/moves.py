"""Moves of an episode: how they begin, and what they came to."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltarm_env.arm import COLUMN, plant_of
from beltarm_env.engine import compiled, inlined
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.drives import begin_drive
from beltarm_env.kernels.layout import LANES, Setup, store_plant
from beltarm_env.physics.models import Model
from beltarm_env.physics.substeps import integration_substeps
from beltarm_env.task.cost import LARGEST_ERROR, still_time
from beltarm_env.task.draws import END_OF_MOVE, FIRST_OF_MOVE
from beltarm_env.task.moves import draw_moves
from beltarm_env.task.ranges import draw_table
from beltarm_env.task.shift import change_row
from beltarm_env.timing import EPISODE_STEPS

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]


@inlined
def begin_move(block: Floats, j: int, move: Any, row: Any, model: Model) -> bool:
    """Put a move into a lane, and what is derived from its arm's row; return whether the drive is a real one."""
    plant = plant_of(row)
    for k in range(4):
        block[(at.MOVE + k) * LANES + j] = move[k]
    block[at.HOLDS_PART * LANES + j] = 1.0 if row[COLUMN.payload_mass] > 0.0 else 0.0
    store_plant(block, j, plant)
    begin_drive(block, j, row)
    block[at.SUBSTEPS * LANES + j] = integration_substeps(plant, model)
    for k in range(4):
        block[(at.SWINGS + k) * LANES + j] = -LARGEST_ERROR
    return block[at.REAL_DRIVE * LANES + j] != 0.0


@inlined
def _close_move(block: Floats, j: int) -> None:
    """Add a lane's move to those before, and start the clock of the next one."""
    for k in range(4):
        block[(at.EARLIER_TOTALS + k) * LANES + j] += block[(at.TOTALS + k) * LANES + j]
    largest, before = block[(at.TOTALS + 4) * LANES + j], block[(at.EARLIER_TOTALS + 4) * LANES + j]
    block[(at.EARLIER_TOTALS + 4) * LANES + j] = largest if largest > before else before
    for k in range(5):
        block[(at.TOTALS + k) * LANES + j] = 0.0
    block[at.EARLIER * LANES + j] += EPISODE_STEPS
    block[at.STEP * LANES + j] = 0.0
    block[at.UNSTILL * LANES + j] = 0.0
    block[at.MOVES_LEFT * LANES + j] -= 1.0


@compiled
def next_moves(
    blocks: Floats, arms: NDArray[np.intp], draws: Floats, bounds: Floats, table: Floats, setup: Setup
) -> int:
    """Begin the next move of n arms, from the states that they have, and return by how many more have a real drive.

    Args:
        blocks: The arms, as `layout` describes.
        arms: Which ones, shape (n,).
        draws: Uniform random numbers, shape (n, DRAWS).
        bounds: Of the parameters, shape (2, len(FIELDS)).
        table: Parameters of all arms, shape (N, len(FIELDS)); changed.
        setup: What all episodes begin with.
    """
    count, more = len(arms), 0
    drawn, given = np.empty((count, bounds.shape[1])), np.full((count, 4), np.nan)
    for i in range(count):
        given[i, 0] = blocks[arms[i] // LANES, (at.MOVE + 1) * LANES + arms[i] % LANES]
    draw_table(bounds, draws, drawn)
    moves = draw_moves(setup.profile, draws[:, FIRST_OF_MOVE:END_OF_MOVE], given)
    for i in range(count):
        block, j = blocks[arms[i] // LANES], arms[i] % LANES
        _close_move(block, j)
        loaded = block[at.EARLIER * LANES + j] % (2 * EPISODE_STEPS) == 0.0
        level = float(block[at.FRICTION_LEVEL * LANES + j])
        was = setup.real_drives[arms[i]]
        if not was:  # nobody keeps the torque of an ideal drive: the motor has what was commanded
            block[at.TORQUE * LANES + j] = block[at.ACTION * LANES + j] * table[arms[i], COLUMN.torque_limit]
        block[at.FRICTION_LEVEL * LANES + j] = change_row(table[arms[i]], drawn[i], level, loaded)
        now = begin_move(block, j, moves[i], table[arms[i]], setup.model)
        more += int(now) - int(was)
        setup.real_drives[arms[i]] = now
    return more


@compiled
def move_totals(blocks: Floats, arms: NDArray[np.intp], totals: Floats) -> None:
    """Sum up moves that are over, into the columns of some arms.

    Args:
        blocks: The arms, as `layout` describes.
        arms: Which ones, shape (n,).
        totals: Cost; RMS, largest tip error, vibration [m]; time until the arm is still [s]; shape (5, N).
    """
    for arm in arms:
        block, j = blocks[arm // LANES], arm % LANES
        swing, last, duration = at.SWINGS * LANES + j, block[at.UNSTILL * LANES + j], block[(at.MOVE + 2) * LANES + j]
        along_x, along_y = block[swing] + block[swing + LANES], block[swing + 2 * LANES] + block[swing + 3 * LANES]
        first = at.TOTALS * LANES + j
        totals[0, arm] = block[first] + block[first + LANES] + block[first + 2 * LANES]
        totals[1, arm] = math.sqrt(block[first + 3 * LANES] / block[at.STEP * LANES + j])
        totals[2, arm] = block[first + 4 * LANES]
        totals[3, arm] = min(max(along_x, along_y), LARGEST_ERROR)
        totals[4, arm] = still_time(float(last), float(duration))
