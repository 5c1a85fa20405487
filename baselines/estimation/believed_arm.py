"""The arm as a filter believes in it: state, constants and drive as one vector z.

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

How it moves is in `baselines.estimation.believed_motion`.
"""

from __future__ import annotations

import math

import numpy as np

from baselines.estimation.felt import AXES
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arm import COLUMN, FIELDS
from beltarm_env.arrays import Floats
from beltarm_env.jit import compiled, inlined
from beltarm_env.physics.trigonometry import exponential, polar_angle, sin_cos, wrapped
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
REACH = 4
"""Samples over which the current loop remembers commands."""
HISTORY = int(LONGEST) + 2 + REACH
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
    for i in range(len(nominal)):
        row[i] = nominal[i]
    for i in range(len(_ROWS)):
        row[_ROWS[i]] = nominal[_ROWS[i]] * exponential(z[LOGS.start + i])
    _believe_drive(z, nominal, row)


@compiled
def _believe_drive(z: Floats, nominal: Floats, row: Floats) -> None:
    """Write the constants of the drive alone."""
    lag = min(z[LAG], z[DELAY])
    row[COLUMN.current_loop_time_constant] = lag * CONTROL_PERIOD
    row[COLUMN.command_latency] = max(z[DELAY] - lag, _EARLIEST) * CONTROL_PERIOD
    row[COLUMN.friction_variation] = math.sqrt(z[SINE] * z[SINE] + z[COSINE] * z[COSINE])
    row[COLUMN.friction_variation_phase] = polar_angle(z[SINE], z[COSINE])
    row[COLUMN.static_friction_excess] = max(nominal[COLUMN.static_friction_excess] + z[EXCESS], 0.0)
    row[COLUMN.belt_stiffening] = min(max(nominal[COLUMN.belt_stiffening] + z[STIFFENING], 0.0), 0.6)
    if len(z) > SIZE:
        sine, cosine = z[ERROR_SINE], z[ERROR_COSINE]
        row[COLUMN.kinematic_error] = math.sqrt(sine * sine + cosine * cosine)
        row[COLUMN.kinematic_error_phase] = polar_angle(sine, cosine)


@inlined
def believe_perturbed(z: Floats, entry: int, nominal: Floats, believed: Floats, row: Floats) -> None:
    """Write the constants as `believe`, from those believed in where z has not been perturbed in one entry."""
    for i in range(len(nominal)):
        row[i] = believed[i]
    if entry >= LOGS.stop:
        _believe_drive(z, nominal, row)
    elif entry >= LOGS.start:
        column = _ROWS[entry - LOGS.start]
        row[column] = nominal[column] * exponential(z[entry])


@inlined
def ripple_shape(angle: float, speed: float, k: int) -> tuple[float, float]:
    """Mean sine and cosine of the ripple of ORDERS[k] over a sample that begins at a motor angle [rad], at a speed."""
    half = 0.5 * CONTROL_PERIOD * speed
    turn = ORDERS[k] * half
    sine_of_turn, _ = sin_cos(wrapped(turn))
    mean = sine_of_turn / turn if abs(turn) > 1e-3 else 1.0
    sine, cosine = sin_cos(wrapped(ORDERS[k] * (angle + half)))
    return mean * sine, mean * cosine


@compiled
def ripple_torque(beliefs: Floats, arm: int, angle: float, speed: float) -> float:
    """Torque ripple [N m] over a sample that begins at a motor angle [rad], at a speed.

    Args:
        beliefs: z of m arms, shape (SIZE or FELT_SIZE, m).
        arm: Which of them.
        angle: [rad]
        speed: [rad/s]
    """
    total = 0.0
    for k in range(len(ORDERS)):
        sine, cosine = ripple_shape(angle, speed, k)
        total += beliefs[RIPPLE.start + 2 * k, arm] * sine + beliefs[RIPPLE.start + 2 * k + 1, arm] * cosine
    return total


@inlined
def other_torque(beliefs: Floats, arm: int, angle: float, speed: float) -> float:
    """Torque ripple and d, what acts on a motor beside its drive and friction [N m]; arguments as `ripple_torque`."""
    return beliefs[DISTURBANCE, arm] + ripple_torque(beliefs, arm, angle, speed)


@compiled
def write_believed(beliefs: Floats, nominal: Floats, z: Floats, table: Floats) -> None:
    """Write the constants of m arms, columns as `ArmParams`, shape (m, len(FIELDS)).

    Args:
        beliefs: z of the arms, shape (SIZE or FELT_SIZE, m).
        nominal: From `nominal_row`.
        z: Room for that of one arm.
        table: Written.
    """
    for arm in range(len(table)):
        for i in range(len(z)):
            z[i] = beliefs[i, arm]
        believe(z, nominal, table[arm])
