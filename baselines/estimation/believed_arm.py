"""The arm as a filter believes in it: state, constants and drive as one vector z, and its motion over a sample.

    x               state of eq. (6c)
    ln p            logarithms of six constants over their nominal values: inertia's swing S (with it the payload),
                    belt stiffness K_s, motor inertia M_a1, viscous friction V_a1, Coulomb friction tau_c, inertia M2(0)
    D, T_i          delay from a command to the motion that the encoder shows, and the part of it that is the current
                    loop's time constant [samples]; the rest is pure: latency, and a late encoder
    p, q            friction over the turn of the motor, 1 + p sin(2 theta_a) + q cos(2 theta_a)
    s, b            excess of breakaway and stiffening of the belt, less their nominal values
    d               torque at the motor that nothing else explains [N m]
    c_n, s_n        torque ripple, the sum over its possible orders n of s_n sin(n theta_a) + c_n cos(n theta_a) [N m]

With an accelerometer on the arm's end (`baselines.estimation.felt`) there are more, and z is longer:

    e_s, e_c        kinematic error of the joint, e_s sin(2 theta_a) + e_c cos(2 theta_a) [rad]
    b               zero-g output of the accelerometer along and across the hand [m/s^2]

The torque constant is not among them: one that differs changes all inertias, stiffness and friction by one factor. Nor
is the kinematic error without an accelerometer: the motor does not feel it.

The motion is that of the environment's integrator, with stiction and all effects of the drive. Ripple is held over a
sample at its mean.
"""

from __future__ import annotations

import numpy as np

from baselines.estimation.felt import AXES, mean_acceleration
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arm import COLUMN, FIELDS, plant_of
from beltarm_env.arrays import Floats
from beltarm_env.jit import compiled, inlined
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.advance_driven import DRIVEN_WORK_ROWS, advance_driven_block, begin_drive
from beltarm_env.kernels.layout import LANES, load_drive, load_plant, load_state, store_plant
from beltarm_env.physics.kinematics import TipMotion, tip_motion
from beltarm_env.physics.models import LUMPED
from beltarm_env.physics.substeps import integration_substeps
from beltarm_env.physics.trigonometry import sin_cos, wrapped
from beltarm_env.task.accelerometer import BIAS as ZERO_G

IDENTIFIED = (
    "arm_inertia_swing",
    "belt_stiffness",
    "motor_inertia",
    "motor_viscous_friction",
    "coulomb_friction",
    "arm_inertia",
)
"""Constants of which the logarithms are estimated."""
ORDERS = np.arange(4, 13)
"""Periods of the ripple per turn of the motor that are possible."""

LOGS = slice(4, 4 + len(IDENTIFIED))
DELAY, LAG, SINE, COSINE, EXCESS, STIFFENING, DISTURBANCE = range(LOGS.stop, LOGS.stop + 7)
RIPPLE = slice(DISTURBANCE + 1, DISTURBANCE + 1 + 2 * len(ORDERS))  # the sines, each followed by its cosine
SIZE = RIPPLE.stop
ERROR_SINE, ERROR_COSINE = SIZE, SIZE + 1
BIAS = SIZE + 2  # along the hand, and after it across
FELT_SIZE = BIAS + AXES
"""Entries of z with an accelerometer."""
DIFFERENCED = RIPPLE.start
"""First entries of z, for which derivatives are differences; those of the ripple follow from that of d."""

STEPS = np.array([1e-2, 1e-1, 1e-4, 1e-2, *[1e-2] * len(IDENTIFIED), *[1e-2] * 6, 1e-3, 1e-4, 1e-4])
"""For these differences, and for those of the kinematic error, shape (DIFFERENCED + 2,)."""
SHORTEST, LONGEST = 0.02, 6.0
"""Delay and, of the former, current loop [samples]. A shorter one would be none, and so would its derivative."""
_RIPPLE = [0.02] * (RIPPLE.stop - RIPPLE.start)
_FELT = [2e-3, 2e-3, 2 * ZERO_G, 2 * ZERO_G]
LOWEST = np.array(
    [-300, -2000, -2, -200, -0.9, -1.4, -0.5, -2, -2, -0.7, SHORTEST, SHORTEST, -0.6, -0.6, -0.5, -0.3, -0.06]
    + [-most for most in (*_RIPPLE, *_FELT)]
)
HIGHEST = np.array(
    [300, 2000, 2, 200, 1.8, 0.9, 0.6, 1.6, 1.6, 0.9, LONGEST, 2, 0.6, 0.6, 1.5, 0.3, 0.06, *_RIPPLE, *_FELT]
)
"""Bounds of z, far beyond any arm of the benchmark: an arm within them can be integrated."""

_EARLIEST = 1e-6  # latency [samples]: all arms take both pieces of a sample, whoever is simulated beside them
_REACH = 4  # samples over which the current loop remembers commands
HISTORY = int(LONGEST) + 2 + _REACH
"""Commands of the past that the motion depends on."""
_ROWS = np.array([FIELDS.index(name) for name in IDENTIFIED])
_LEFT_OUT = ("payload_mass", "torque_constant_error", "friction_drift", "torque_ripple", "kinematic_error")


def nominal_row(params: ArmParams) -> Floats:
    """Constants of the arm believed in before anything is measured, shape (len(FIELDS),).

    Its payload is part of its swing; what is not believed in, or by z alone, is zero.
    """
    row = params.row()
    row[COLUMN.arm_inertia_swing] = params.plant().inertia_swing
    for name in _LEFT_OUT:
        row[FIELDS.index(name)] = 0.0
    return row


@compiled
def believe(z: Floats, nominal: Floats, row: Floats) -> None:
    """Write the constants that a z stands for, shape (len(FIELDS),), all but its ripple and d.

    Args:
        z: Shape (SIZE or FELT_SIZE,).
        nominal: From `nominal_row`.
        row: Written.
    """
    row[:] = nominal
    for i in range(len(_ROWS)):
        row[_ROWS[i]] *= np.exp(z[LOGS.start + i])
    lag = min(z[LAG], z[DELAY])
    row[COLUMN.current_loop_time_constant] = lag * CONTROL_PERIOD
    row[COLUMN.command_latency] = max(z[DELAY] - lag, _EARLIEST) * CONTROL_PERIOD
    row[COLUMN.friction_variation] = np.hypot(z[SINE], z[COSINE])
    row[COLUMN.friction_variation_phase] = np.arctan2(z[COSINE], z[SINE]) % (2 * np.pi)
    row[COLUMN.static_friction_excess] = max(nominal[COLUMN.static_friction_excess] + z[EXCESS], 0.0)
    row[COLUMN.belt_stiffening] = min(max(nominal[COLUMN.belt_stiffening] + z[STIFFENING], 0.0), 0.6)
    if len(z) > SIZE:
        row[COLUMN.kinematic_error] = np.hypot(z[ERROR_SINE], z[ERROR_COSINE])
        row[COLUMN.kinematic_error_phase] = np.arctan2(z[ERROR_COSINE], z[ERROR_SINE]) % (2 * np.pi)


@inlined
def ripple_shape(angle: float, speed: float, k: int) -> tuple[float, float]:
    """Mean sine and cosine of the ripple of ORDERS[k] over a sample that begins at a motor angle [rad], at a speed."""
    half = 0.5 * CONTROL_PERIOD * speed
    turn = ORDERS[k] * half
    sine_of_turn, _ = sin_cos(wrapped(turn))
    mean = sine_of_turn / turn if abs(turn) > 1e-3 else 1.0
    sine, cosine = sin_cos(wrapped(ORDERS[k] * (angle + half)))
    return mean * sine, mean * cosine


@inlined
def ripple_torque(z: Floats, angle: float, speed: float) -> float:
    """Torque ripple [N m] over a sample that begins at a motor angle [rad], at a speed."""
    total = 0.0
    for k in range(len(ORDERS)):
        sine, cosine = ripple_shape(angle, speed, k)
        total += z[RIPPLE.start + 2 * k] * sine + z[RIPPLE.start + 2 * k + 1] * cosine
    return total


@compiled
def _load(block: Floats, lane: int, z: Floats, row: Floats, commands: Floats, actions: Floats) -> None:
    """Put the arm of a z, with its constants `row`, into a lane, ready to be moved under its past commands."""
    plant = plant_of(row)
    samples, lag = row[COLUMN.command_latency] / CONTROL_PERIOD, row[COLUMN.current_loop_time_constant] / CONTROL_PERIOD
    late = int(samples)
    row[COLUMN.command_latency] = (samples - late) * CONTROL_PERIOD  # whole samples are in the choice of commands
    store_plant(block, lane, plant)
    begin_drive(block, lane, row)
    block[at.DRIVEN * LANES + lane] = 1.0
    block[at.SUBSTEPS * LANES + lane] = integration_substeps(plant, LUMPED)
    for i in range(4):
        block[(at.STATE + i) * LANES + lane] = z[i]
    stays, torque = np.exp(-1 / lag), commands[late + 1 + _REACH]
    for k in range(_REACH, 1, -1):
        torque = commands[late + k] + stays * (torque - commands[late + k])
    torque = commands[late + 1] + np.exp((samples - late - 1) / lag) * (torque - commands[late + 1])
    unexplained = z[DISTURBANCE] + ripple_torque(z, z[0], z[1])
    block[at.TORQUE * LANES + lane] = torque + unexplained
    block[at.TARGETS * LANES + lane] = commands[late + 1] + unexplained
    actions[lane] = (commands[late] + unexplained) / plant.torque_limit


@inlined
def _feel(block: Floats, lane: int, velocity: Floats, result: Floats) -> None:
    """Put what an accelerometer feels of a lane beside its x, over a period that began with a velocity of the end."""
    before = TipMotion(0.0, 0.0, velocity[0], velocity[1])
    x, plant, drive = load_state(block, at.STATE, lane), load_plant(block, lane), load_drive(block, lane)
    result[4], result[5] = mean_acceleration(before, x, plant, drive)


@compiled
def simulated(beliefs: Floats, nominal: Floats, commands: Floats, perturbed: bool) -> Floats:
    """Simulate one period from z, and from copies with one of its first entries perturbed by its step in each.

    Args:
        beliefs: z of m arms, shape (SIZE or FELT_SIZE, m).
        nominal: From `nominal_row`.
        commands: Of the past [N m], latest first, shape (m, HISTORY).
        perturbed: Whether there are copies.

    Returns:
        x after the period: that of z, then those of the copies; shape (1 + DIFFERENCED or 1, 4, m). With an
        accelerometer, what it feels over the period stands beside x, and there are more rows: copies for the kinematic
        error, and what is felt of z where each entry of x is perturbed after the period; shape
        (1 + DIFFERENCED + 2 + 4, 4 + AXES, m).
    """
    size, count = beliefs.shape
    felt = perturbed and size > SIZE
    simulations = (1 + DIFFERENCED + (2 if felt else 0)) if perturbed else 1
    result = np.zeros((simulations + 4, 4 + AXES, count)) if felt else np.empty((simulations, 4, count))
    block, work, actions = np.zeros(at.ROWS * LANES), np.zeros(DRIVEN_WORK_ROWS * LANES), np.zeros(LANES)
    row, z, velocities = np.empty(len(nominal)), np.empty(size), np.empty((LANES, 2))
    for low in range(0, simulations * count, LANES):
        lanes = min(LANES, simulations * count - low)
        for lane in range(lanes):
            arm, k = (low + lane) // simulations, (low + lane) % simulations
            z[:] = beliefs[:, arm]
            if k > 0:
                z[k - 1 if k <= DIFFERENCED else ERROR_SINE + k - 1 - DIFFERENCED] += STEPS[k - 1]
            believe(z, nominal, row)
            _load(block, lane, z, row, commands[arm], actions)
            if felt:
                tip = tip_motion(load_state(block, at.STATE, lane), load_plant(block, lane), load_drive(block, lane))
                velocities[lane, 0], velocities[lane, 1] = tip.x_speed, tip.y_speed
        advance_driven_block(block, work, actions, lanes, LUMPED)
        for lane in range(lanes):
            arm, k = (low + lane) // simulations, (low + lane) % simulations
            for i in range(4):
                result[k, i, arm] = block[(at.STATE + i) * LANES + lane]
            if felt:
                _feel(block, lane, velocities[lane], result[k, :, arm])
                for i in range(4 if k == 0 else 0):
                    state = block[(at.STATE + i) * LANES + lane]
                    block[(at.STATE + i) * LANES + lane] = state + STEPS[i]
                    _feel(block, lane, velocities[lane], result[simulations + i, :, arm])
                    block[(at.STATE + i) * LANES + lane] = state
    return result


@compiled
def believed_table(beliefs: Floats, nominal: Floats) -> Floats:
    """Constants of m arms, columns as `ArmParams`, shape (m, len(FIELDS)), from their z, shape (SIZE, m)."""
    table = np.empty((beliefs.shape[1], len(nominal)))
    for arm in range(len(table)):
        believe(beliefs[:, arm], nominal, table[arm])
    return table


@compiled
def other_torques(beliefs: Floats, states: Floats) -> Floats:
    """Torque ripple and d, what acts on motors beside their drives and friction [N m], shape (m,).

    Args:
        beliefs: z of m arms, shape (SIZE, m).
        states: x at the beginning of the sample that is asked for, shape (m, 4).
    """
    torques = np.empty(len(states))
    for arm in range(len(states)):
        z = beliefs[:, arm]
        torques[arm] = z[DISTURBANCE] + ripple_torque(z, states[arm, 0], states[arm, 1])
    return torques
