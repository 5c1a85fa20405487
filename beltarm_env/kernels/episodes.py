"""Episodes of a batch of arms: how they begin, and what they came to."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltarm_env.arm import plant_of
from beltarm_env.engine import compiled, inlined
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.layout import (
    LANES,
    RealDrive,
    Setup,
    drive_among,
    load_move,
    load_plant,
    load_state,
    store_state,
)
from beltarm_env.kernels.moves import begin_move
from beltarm_env.kernels.sense import begin_sensing
from beltarm_env.physics.drive import drive_of, resting
from beltarm_env.physics.friction import begun_deflection
from beltarm_env.physics.kinematics import tip_error, tip_motion
from beltarm_env.physics.state import ArmState
from beltarm_env.task.cost import MAX_COST
from beltarm_env.task.draws import DRAWS, END_OF_MOVE, FIRST_OF_MOVE, FIRST_OF_SENSORS
from beltarm_env.task.moves import draw_moves
from beltarm_env.task.ranges import draw_table
from beltarm_env.task.reference import reference_at
from beltarm_env.task.streams import Streams, draw
from beltarm_env.timing import CONTROL_PERIOD, EPISODE_STEPS

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Integers = NDArray[np.intp]


class Beginnings(NamedTuple):
    """What n episodes begin with, each its own."""

    table: Floats  # parameters of the arms, shape (n, len(FIELDS))
    moves: Floats  # first moves, shape (n, 4)
    states: Floats  # shape (n, 4); NaN for at rest at the move's start
    draws: Floats  # uniform random numbers, shape (n, DRAWS)


@compiled
def begin_episodes(blocks: Floats, arms: Integers, episodes: Beginnings, setup: Setup) -> int:
    """Begin a new episode in n arms, and return by how many there are more with a real drive.

    Args:
        blocks: The arms, as `layout` describes.
        arms: Which ones, shape (n,).
        episodes: Theirs.
        setup: What all episodes begin with.
    """
    more, (table, moves, states, draws) = 0, episodes
    for i in range(len(arms)):
        block, j = blocks[arms[i] // LANES], arms[i] % LANES
        plant = plant_of(table[i])
        for row in range(at.ROWS):
            block[row * LANES + j] = 0.0
        x = ArmState(states[i, 0], states[i, 1], states[i, 2], states[i, 3])
        if x.motor_angle != x.motor_angle:
            x = resting(moves[i, 0] * plant.gear, plant, drive_of(table[i]))
        store_state(block, at.STATE, j, x)
        now = begin_move(block, j, moves[i], table[i], setup.model)
        block[at.MOVES_LEFT * LANES + j] = setup.num_moves - 1.0
        block[at.FRICTION_LEVEL * LANES + j] = 1.0
        block[at.DEFLECTION * LANES + j] = begun_deflection(x.motor_speed, drive_of(table[i]))
        begin_sensing(block, j, setup.resolution, float(setup.delays[arms[i]]), draws[i, FIRST_OF_SENSORS:])
        more += int(now) - int(setup.real_drives[arms[i]])
        setup.real_drives[arms[i]] = now
    return more


@compiled
def restart_episodes(
    blocks: Floats, arms: Integers, streams: Streams, bounds: Floats, table: Floats, setup: Setup
) -> int:
    """Begin new random episodes in n arms; within `streams.wrapping`. For the result see above.

    Args:
        blocks: The arms, as `layout` describes.
        arms: Which ones, shape (n,).
        streams: Random streams of all arms, shape (N, 4); changed.
        bounds: Of the parameters, shape (2, len(FIELDS)).
        table: Parameters of all arms, shape (N, len(FIELDS)); changed.
        setup: What all episodes begin with.
    """
    count = len(arms)
    draws, drawn, nothing = np.empty((count, DRAWS)), np.empty((count, bounds.shape[1])), np.full((count, 4), np.nan)
    draw(streams, arms, draws)
    draw_table(bounds, draws, drawn)
    for i in range(count):
        table[arms[i]] = drawn[i]
    moves = draw_moves(setup.profile, draws[:, FIRST_OF_MOVE:END_OF_MOVE], nothing)
    return begin_episodes(blocks, arms, Beginnings(drawn, moves, nothing, draws), setup)


@inlined
def totals_so_far(block: Floats, j: int, terminated: bool) -> tuple[float, float, float, float, float, float, float]:
    """Sum up the episode of one lane until now, see `episode_totals`."""
    steps = float(block[at.EARLIER * LANES + j] + block[at.STEP * LANES + j])
    now, before = at.TOTALS * LANES + j, at.EARLIER_TOTALS * LANES + j
    position, velocity = float(block[before] + block[now]), float(block[before + LANES] + block[now + LANES])
    torque_rate = float(block[before + 2 * LANES] + block[now + 2 * LANES])
    left = EPISODE_STEPS * (block[at.MOVES_LEFT * LANES + j] + 1) - block[at.STEP * LANES + j]
    charge = MAX_COST * left if terminated else 0.0
    rms = math.sqrt((block[before + 3 * LANES] + block[now + 3 * LANES]) / steps)
    largest = max(float(block[before + 4 * LANES]), float(block[now + 4 * LANES]))
    return (charge + position + velocity) + torque_rate, position, velocity, torque_rate, steps, rms, largest


@compiled
def episode_totals(blocks: Floats, arms: Integers, terminated: Flags, totals: Floats) -> None:
    """Sum up episodes, into the columns of some arms.

    Args:
        blocks: The arms, as `layout` describes.
        arms: Which ones, shape (n,).
        terminated: Which arms left the workspace and are charged for the steps that are left, shape (N,).
        totals: Cost, its position, velocity and torque-rate terms, steps, RMS and largest tip error [m], shape (7, N).
    """
    for arm in arms:
        totals[:, arm] = totals_so_far(blocks[arm // LANES], arm % LANES, bool(terminated[arm]))


@compiled
def tip_errors(blocks: Floats, errors: Floats, profile: int, real_drive: RealDrive) -> None:
    """Write tip minus reference tip, position [m] and velocity [m/s], x and y each, into `errors`, shape (N, 4)."""
    for i in range(len(errors)):
        block, j = blocks[i // LANES], i % LANES
        plant = load_plant(block, j)
        tip = tip_motion(load_state(block, at.STATE, j), plant, drive_among(block, j, real_drive))
        reference = reference_at(profile, load_move(block, j), block[at.STEP * LANES + j] * CONTROL_PERIOD)
        errors[i, 0], errors[i, 1], errors[i, 2], errors[i, 3] = tip_error(tip, reference.angle, reference.speed, plant)
