"""Motion over a sample of the arm that a filter believes in, `baselines.estimation.believed_arm`.

It is that of the environment's integrator, with stiction and all effects of the drive. Ripple is held over a sample at
its mean. Many arms, and copies of each with one entry of z perturbed, are simulated side by side, in lanes. A copy
begins as the arm itself, and only what its entry changes is derived anew. A copy of each arm is in as many lanes as
there are arms, which follow one another: so all loops are over lanes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from baselines.estimation import believed_arm as z_at
from baselines.estimation.accelerometer import mean_acceleration
from baselines.estimation.believed_arm import Nominal, believe, believe_entry, constants_of, write_ripple
from beltarm_env import CONTROL_PERIOD
from beltarm_env.arm import FIELDS, Plant, plant_of
from beltarm_env.arrays import Floats
from beltarm_env.engine import compiled, inlined
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.advance import REAL_WORK_ROWS, advance_real_block
from beltarm_env.kernels.drives import begin_friction, begin_lag
from beltarm_env.kernels.layout import LANES, Rows, load_drive, load_plant, load_state, store_drive, store_plant
from beltarm_env.physics.drive import drive_of
from beltarm_env.physics.kinematics import TipMotion, tip_motion
from beltarm_env.physics.models import Model
from beltarm_env.physics.substeps import integration_substeps
from beltarm_env.physics.trigonometry import exponential

# Rows of a block: as in `layout`, then
_WHOLE = at.ROWS  # samples by which a command is late, without their fraction
_STAYS = _WHOLE + 1  # what a sample leaves of the difference between the motor's torque and its target
_LEFT = _STAYS + 1  # what is left of it when a sample begins in which the command before has arrived
_COMMAND = _LEFT + 1  # that arrives in this sample [N m]
_BEFORE = _COMMAND + 1  # that arrived in the one before [N m]
_PAST = _BEFORE + 1  # torque of the motor by all commands of the past [N m]
_ROWS = _PAST + 1
_LIMIT = at.PLANT + Plant._fields.index("torque_limit")


class Simulation(NamedTuple):
    """Room for `simulate`; what it holds between two calls does not matter."""

    loaded: Rows  # arms as they are believed in, shape (_ROWS * LANES,)
    block: Rows  # copies of them, likewise
    work: Rows  # shape (REAL_WORK_ROWS * LANES,)
    actions: Rows  # shape (LANES,)
    velocities: Floats  # of the arm's end where a lane begins, shape (2 * LANES,); (2,) without an accelerometer
    z: Rows  # of the arms, see `believe`
    constants: Rows  # of them, likewise
    perturbed: Rows  # the same of a copy
    shapes: Rows  # of the arms' ripple, see `write_ripple`
    other_shapes: Rows  # of a copy's
    ripple: Rows  # of the arms [N m], shape (LANES,)
    other_ripple: Rows  # of a copy [N m]


def simulation_room(size: int, threads: tuple[int, ...] = ()) -> Simulation:
    """Room for simulations of arms of which z has `size` entries; of several threads, as the first axis."""
    shapes, fields = 2 * len(z_at.ORDERS), len(FIELDS)
    rows = (_ROWS, _ROWS, REAL_WORK_ROWS, 1, 2, size, fields, fields, shapes, shapes, 1, 1)
    room = Simulation._make(np.zeros((*threads, count * LANES)) for count in rows)
    return room if size > z_at.SIZE else room._replace(velocities=np.zeros((*threads, 2)))


@compiled
def _load_coefficients(block: Floats, arms: int, constants: Floats, model: Model) -> None:
    """Put what follows from constants, but delay and lag, into lanes."""
    for lane in range(arms):
        row = constants_of(constants, lane)
        plant = plant_of(row)
        store_plant(block, lane, plant)
        store_drive(block, lane, drive_of(row))
        begin_friction(block, lane, row)
        block[at.SUBSTEPS * LANES + lane] = integration_substeps(plant, model)


@compiled
def _load_delays(block: Floats, arms: int, constants: Floats) -> None:
    """Put what follows from delay and lag into lanes."""
    for lane in range(arms):
        row = constants_of(constants, lane)
        samples = row.command_latency / CONTROL_PERIOD
        lag = row.current_loop_time_constant / CONTROL_PERIOD
        late = np.floor(samples)
        # Whole samples are in the choice of commands.
        begin_lag(block, lane, row.current_loop_time_constant, (samples - late) * CONTROL_PERIOD)
        block[_WHOLE * LANES + lane] = late
        block[_STAYS * LANES + lane] = exponential(-1 / lag)
        block[_LEFT * LANES + lane] = exponential((samples - late - 1) / lag)


@compiled
def load_commands(block: Floats, commands: Floats, held: int) -> None:
    """Put commands, and the motor's torque by those of the past, into lanes.

    Args:
        block: Written.
        commands: See `Belief`.
        held: Samples for which the last command has been held since.
    """
    for lane in range(len(commands)):
        late = int(block[_WHOLE * LANES + lane]) - held
        torque, stays = commands[lane, max(late + 1 + z_at.REACH, 0)], block[_STAYS * LANES + lane]
        for k in range(z_at.REACH, 1, -1):
            command = commands[lane, max(late + k, 0)]
            torque = command + stays * (torque - command)
        command = commands[lane, max(late + 1, 0)]
        block[_PAST * LANES + lane] = command + block[_LEFT * LANES + lane] * (torque - command)
        block[_BEFORE * LANES + lane] = command
        block[_COMMAND * LANES + lane] = commands[lane, max(late, 0)]


@compiled
def load_torques(block: Floats, arms: int, z: Floats, ripple: Floats, actions: Floats) -> None:
    """Add d and ripple to the torques of lanes, and write their actions."""
    for lane in range(arms):
        unexplained = z[z_at.DISTURBANCE * LANES + lane] + ripple[lane]
        block[at.TORQUE * LANES + lane] = block[_PAST * LANES + lane] + unexplained
        block[at.TARGETS * LANES + lane] = block[_BEFORE * LANES + lane] + unexplained
        command = block[_COMMAND * LANES + lane] + unexplained
        actions[lane] = command / block[_LIMIT * LANES + lane]


@compiled
def load(beliefs: Floats, nominal: Nominal, deflections: Floats, room: Simulation) -> None:
    """Load arms as they are believed in, all but their commands.

    Args:
        beliefs: z of up to `ARMS` arms, shape (arms, SIZE or more).
        nominal: Arm believed in before anything is measured.
        deflections: See `Belief`.
        room: Changed.
    """
    arms = len(beliefs)
    for lane in range(arms):
        for i in range(len(room.z) // LANES):
            room.z[i * LANES + lane] = beliefs[lane, i]
    believe(room.z, arms, nominal.row, room.constants)
    for lane in range(arms):
        room.loaded[at.REAL_DRIVE * LANES + lane] = 1.0
        room.loaded[at.STEP * LANES + lane] = 0.0
        room.loaded[at.DEFLECTION * LANES + lane] = deflections[lane]
        for i in range(4):
            room.loaded[(at.STATE + i) * LANES + lane] = room.z[i * LANES + lane]
    _load_coefficients(room.loaded, arms, room.constants, nominal.model)
    _load_delays(room.loaded, arms, room.constants)


@inlined  # with rows that are constants: only then the compiler sees that no index is below zero, and vectorises
def _copy(source: Floats, target: Floats, arms: int, begin: int, end: int) -> None:
    """Copy rows of lanes."""
    for row in range(begin, end):
        for lane in range(arms):
            target[row * LANES + lane] = source[row * LANES + lane]


@compiled
def load_copy(k: int, first: int, beliefs: Floats, nominal: Nominal, commands: Floats, room: Simulation) -> None:
    """Put copies of loaded arms into the block's lanes from `first` on, and the actions of these lanes into theirs.

    They are as the arms or, for k > 0, have entry k - 1 perturbed. Other arguments are those of `simulate`.
    """
    arms, z, ripple, block, actions = len(beliefs), room.z, room.ripple, room.block[first:], room.actions[first:]
    _copy(room.loaded, block, arms, 0, at.MOVE)
    _copy(room.loaded, block, arms, at.STEP, at.STEP + 1)
    _copy(room.loaded, block, arms, at.SUBSTEPS, at.SUBSTEPS + 1)
    _copy(room.loaded, block, arms, at.REAL_DRIVE, _ROWS)
    entry = k - 1 if k <= z_at.DIFFERENCED else z_at.ERROR_SINE + k - 1 - z_at.DIFFERENCED
    for lane in range(arms if k > 0 else 0):
        z[entry * LANES + lane] += z_at.STEPS[k - 1]
    if 1 <= k <= 4:
        for lane in range(arms):
            block[(at.STATE + entry) * LANES + lane] = z[entry * LANES + lane]
    if 1 <= k <= 2:  # angle and speed
        write_ripple(z, z, arms, room.other_shapes, room.other_ripple)
        ripple = room.other_ripple
    if k > z_at.LOGS.start and entry != z_at.DISTURBANCE:
        _copy(room.constants, room.perturbed, arms, 0, len(FIELDS))
        believe_entry(z, entry, arms, nominal.row, room.perturbed)
        if entry == z_at.DELAY or entry == z_at.LAG:
            _load_delays(block, arms, room.perturbed)
            load_commands(block, commands, 0)
        else:
            _load_coefficients(block, arms, room.perturbed, nominal.model)
    load_torques(block, arms, z, ripple, actions)
    for lane in range(arms if k > 0 else 0):
        z[entry * LANES + lane] = beliefs[lane, entry]


@compiled
def move_on(commands: Floats, held: int, model: Model, room: Simulation) -> None:
    """Move loaded arms by one period, their last command having been held for some samples; x is in `room.loaded`."""
    arms = len(commands)
    load_commands(room.loaded, commands, held)
    write_ripple(room.loaded, room.z, arms, room.shapes, room.ripple)
    load_torques(room.loaded, arms, room.z, room.ripple, room.actions)
    advance_real_block(room.loaded, room.work, room.actions, arms, model)


@inlined
def _put_acceleration(block: Floats, lane: int, velocities: Floats, result: Floats, arm: int, k: int) -> None:
    """Put what an accelerometer feels of a lane below its x, over a period that began with a velocity of the end."""
    before = TipMotion(0.0, 0.0, velocities[lane], velocities[LANES + lane])
    x, plant, drive = load_state(block, at.STATE, lane), load_plant(block, lane), load_drive(block, lane)
    result[arm, 4, k], result[arm, 5, k] = mean_acceleration(before, x, plant, drive)


@compiled
def simulate(
    beliefs: Floats, nominal: Nominal, commands: Floats, deflections: Floats, room: Simulation, result: Floats
) -> None:
    """Simulate one period from z, and from copies with one of its first entries perturbed by its step in each.

    Args:
        beliefs: z of up to `ARMS` arms, shape (arms, SIZE or more).
        nominal: Arm believed in before anything is measured.
        commands: Of the past, see `Belief`.
        deflections: See `Belief`; changed to those after the period.
        room: Changed; holds the shapes of the arms' ripple then.
        result: x after the period, written: that of z, and then those of the copies, shape (arms or more, 4,
            1 + DIFFERENCED). With an accelerometer, its readings over the period stand below x, and there are more
            columns: copies for the kinematic error, and the readings where each entry of x is perturbed after the
            period (elsewhere in these columns, nothing is written); shape (..., 4 + AXES, 1 + DIFFERENCED + 2 + 4).
    """
    arms, accelerometer, block = len(beliefs), result.shape[1] > 4, room.block
    simulations = result.shape[2] - 4 if accelerometer else result.shape[2]
    load(beliefs, nominal, deflections, room)
    load_commands(room.loaded, commands, 0)
    write_ripple(room.z, room.z, arms, room.shapes, room.ripple)
    at_once = max(LANES // arms, 1)
    for part in range((simulations + at_once - 1) // at_once):
        begin, end = part * at_once, min(part * at_once + at_once, simulations)
        for k in range(begin, end):
            load_copy(k, (k - begin) * arms, beliefs, nominal, commands, room)
        for lane in range((end - begin) * arms if accelerometer else 0):
            tip = tip_motion(load_state(block, at.STATE, lane), load_plant(block, lane), load_drive(block, lane))
            room.velocities[lane], room.velocities[LANES + lane] = tip.x_speed, tip.y_speed
        advance_real_block(block, room.work, room.actions, (end - begin) * arms, nominal.model)
        for k in range(begin, end):
            for arm in range(arms):
                lane = (k - begin) * arms + arm
                if k == 0:
                    deflections[arm] = block[at.DEFLECTION * LANES + lane]
                for i in range(4):
                    result[arm, i, k] = block[(at.STATE + i) * LANES + lane]
                if accelerometer:
                    _put_acceleration(block, lane, room.velocities, result, arm, k)
                    for i in range(4 if k == 0 else 0):
                        state = block[(at.STATE + i) * LANES + lane]
                        block[(at.STATE + i) * LANES + lane] = state + z_at.STEPS[i]
                        _put_acceleration(block, lane, room.velocities, result, arm, simulations + i)
                        block[(at.STATE + i) * LANES + lane] = state
