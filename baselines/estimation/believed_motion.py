"""Motion over a sample of the arm that a filter believes in, `baselines.estimation.believed_arm`.

It is that of the environment's integrator, with stiction and all effects of the drive. Ripple is held over a sample at
its mean. Many arms, or copies of one, are simulated side by side.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from baselines.estimation.believed_arm import (
    DIFFERENCED,
    DISTURBANCE,
    ERROR_SINE,
    REACH,
    SIZE,
    STEPS,
    believe,
    believe_perturbed,
    ripple_torque,
)
from baselines.estimation.felt import mean_acceleration
from beltarm_env import CONTROL_PERIOD
from beltarm_env.arm import COLUMN, FIELDS, plant_of
from beltarm_env.arrays import Floats
from beltarm_env.jit import compiled, inlined
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.advance_driven import DRIVEN_WORK_ROWS, advance_driven_block, begin_drive
from beltarm_env.kernels.layout import LANES, load_drive, load_plant, load_state, store_plant
from beltarm_env.physics.kinematics import TipMotion, tip_motion
from beltarm_env.physics.models import LUMPED
from beltarm_env.physics.substeps import integration_substeps
from beltarm_env.physics.trigonometry import exponential


class Simulation(NamedTuple):
    """Room for `simulate`; what it holds between two calls does not matter."""

    block: Floats  # lanes of arms, shape (layout.ROWS * LANES,)
    work: Floats  # shape (DRIVEN_WORK_ROWS * LANES,)
    actions: Floats  # shape (LANES,)
    velocities: Floats  # of the arm's end where a lane begins, shape (2 * LANES,); (2,) without an accelerometer
    believed: Floats  # constants of the arm that is loaded, shape (len(FIELDS),)
    row: Floats  # the same of a copy of it
    z: Floats  # shape (SIZE or FELT_SIZE,)


def simulation_room(size: int) -> Simulation:
    """Room for simulations of arms of which z has `size` entries."""
    return Simulation(
        np.zeros(at.ROWS * LANES),
        np.zeros(DRIVEN_WORK_ROWS * LANES),
        np.zeros(LANES),
        np.zeros(2 * LANES if size > SIZE else 2),
        np.zeros(len(FIELDS)),
        np.zeros(len(FIELDS)),
        np.zeros(size),
    )


@compiled
def _load(block: Floats, lane: int, z: Floats, row: Floats, commands: Floats, ripple: float, actions: Floats) -> None:
    """Put the arm of a z, with its constants `row`, into a lane, ready to be moved under its past commands.

    Args:
        block: Written.
        lane: Which.
        z: Shape (SIZE or FELT_SIZE,).
        row: From `believe`; changed.
        commands: Of the past [N m], latest first, shape (HISTORY,).
        ripple: Torque that acts over the sample [N m].
        actions: Commanded over the limit, shape (LANES,); written.
    """
    plant = plant_of(row)
    samples = float(row[COLUMN.command_latency]) / CONTROL_PERIOD
    lag = float(row[COLUMN.current_loop_time_constant]) / CONTROL_PERIOD
    late = int(samples)
    row[COLUMN.command_latency] = (samples - late) * CONTROL_PERIOD  # whole samples are in the choice of commands
    store_plant(block, lane, plant)
    begin_drive(block, lane, row)
    block[at.DRIVEN * LANES + lane] = 1.0
    block[at.STEP * LANES + lane] = 0.0
    block[at.SUBSTEPS * LANES + lane] = integration_substeps(plant, LUMPED)
    for i in range(4):
        block[(at.STATE + i) * LANES + lane] = z[i]
    stays, torque = exponential(-1 / lag), commands[late + 1 + REACH]
    for k in range(REACH, 1, -1):
        torque = commands[late + k] + stays * (torque - commands[late + k])
    torque = commands[late + 1] + exponential((samples - late - 1) / lag) * (torque - commands[late + 1])
    unexplained = z[DISTURBANCE] + ripple
    block[at.TORQUE * LANES + lane] = torque + unexplained
    block[at.TARGETS * LANES + lane] = commands[late + 1] + unexplained
    actions[lane] = (commands[late] + unexplained) / plant.torque_limit


@inlined
def _feel(block: Floats, lane: int, velocities: Floats, result: Floats, k: int, arm: int) -> None:
    """Put what an accelerometer feels of a lane beside its x, over a period that began with a velocity of the end."""
    before = TipMotion(0.0, 0.0, velocities[lane], velocities[LANES + lane])
    x, plant, drive = load_state(block, at.STATE, lane), load_plant(block, lane), load_drive(block, lane)
    result[k, 4, arm], result[k, 5, arm] = mean_acceleration(before, x, plant, drive)


@compiled
def simulate(beliefs: Floats, nominal: Floats, commands: Floats, room: Simulation, result: Floats) -> None:
    """Simulate one period from z, and from copies with one of its first entries perturbed by its step in each.

    Args:
        beliefs: z of m arms, shape (SIZE or FELT_SIZE, m).
        nominal: From `nominal_row`.
        commands: Of the past [N m], latest first, shape (m, HISTORY).
        room: Changed.
        result: x after the period, written: that of z alone, shape (1, 4, m), or then those of the copies, shape
            (1 + DIFFERENCED, 4, m). With an accelerometer, what it feels over the period stands beside x, and there are
            more rows: copies for the kinematic error, and what is felt of z where each entry of x is perturbed after
            the period (elsewhere in these rows, nothing is written); shape (1 + DIFFERENCED + 2 + 4, 4 + AXES, m).
    """
    size, count = beliefs.shape
    felt = result.shape[1] > 4
    simulations = len(result) - 4 if felt else len(result)
    block, z, row, ripple = room.block, room.z, room.row, 0.0
    for low in range(0, simulations * count, LANES):
        lanes = min(LANES, simulations * count - low)
        for lane in range(lanes):
            arm, k = (low + lane) // simulations, (low + lane) % simulations
            for i in range(size):
                z[i] = beliefs[i, arm]
            if k == 0:
                believe(z, nominal, room.believed)
                for i in range(len(row)):
                    row[i] = room.believed[i]
                ripple = ripple_torque(beliefs, arm, z[0], z[1])
            else:
                entry = k - 1 if k <= DIFFERENCED else ERROR_SINE + k - 1 - DIFFERENCED
                z[entry] += STEPS[k - 1]
                believe_perturbed(z, entry, nominal, room.believed, row)
            own = ripple_torque(beliefs, arm, z[0], z[1]) if 1 <= k <= 2 else ripple  # of angle and speed
            _load(block, lane, z, row, commands[arm], own, room.actions)
            if felt:
                tip = tip_motion(load_state(block, at.STATE, lane), load_plant(block, lane), load_drive(block, lane))
                room.velocities[lane], room.velocities[LANES + lane] = tip.x_speed, tip.y_speed
        advance_driven_block(block, room.work, room.actions, lanes, LUMPED)
        for lane in range(lanes):
            arm, k = (low + lane) // simulations, (low + lane) % simulations
            for i in range(4):
                result[k, i, arm] = block[(at.STATE + i) * LANES + lane]
            if felt:
                _feel(block, lane, room.velocities, result, k, arm)
                for i in range(4 if k == 0 else 0):
                    state = block[(at.STATE + i) * LANES + lane]
                    block[(at.STATE + i) * LANES + lane] = state + STEPS[i]
                    _feel(block, lane, room.velocities, result, simulations + i, arm)
                    block[(at.STATE + i) * LANES + lane] = state
