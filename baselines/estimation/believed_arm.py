"""The arm as a filter believes in it: state, constants and drive as one vector z.

    x               state of eq. (6c)
    ln p            logarithms of six constants over their nominal values: inertia's swing S (with it the payload),
                    belt stiffness K_s, motor inertia M_a1, viscous friction V_a1, Coulomb friction tau_c, inertia M2(0)
    D, T_i          delay from a command to the motion that the encoder shows, and the part of it that is the current
                    loop's time constant [samples]; the rest is pure: latency, and a late encoder
    p, q            friction over the turn of the motor, 1 + p sin(2 theta_a) + q cos(2 theta_a)
    s, b            excess of breakaway and stiffening of the belt, less their nominal values
    g               logarithm of the deflection by which the motor gives before it slips, over its nominal value
    d               torque at the motor that nothing else explains [N m]
    c_n, s_n        torque ripple, the sum over its possible orders n of s_n sin(n theta_a) + c_n cos(n theta_a) [N m]

With an accelerometer on the arm's end (`baselines.estimation.accelerometer`) there are more, and z is longer:

    e_s, e_c        kinematic error of the joint, e_s sin(2 theta_a) + e_c cos(2 theta_a) [rad]
    b               zero-g output of the accelerometer along and across the hand [m/s^2]

The torque constant is not among them: one that differs changes all inertias, stiffness and friction by one factor. Nor
is the kinematic error without an accelerometer: the motor does not feel it.

How it moves is in `baselines.estimation.believed_motion`.
"""

from __future__ import annotations

import math
from collections import namedtuple
from typing import Any, NamedTuple

import numpy as np

from baselines.estimation.accelerometer import AXES
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arm import COLUMN, FIELDS
from beltarm_env.arrays import Floats
from beltarm_env.engine import compiled, inlined
from beltarm_env.kernels.layout import LANES
from beltarm_env.physics.models import Model
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
DELAY, LAG, SINE, COSINE, EXCESS, STIFFENING, GIVING, DISTURBANCE = range(LOGS.stop, LOGS.stop + 8)
RIPPLE = slice(DISTURBANCE + 1, DISTURBANCE + 1 + 2 * len(ORDERS))  # the sines, each followed by its cosine
SIZE = RIPPLE.stop
ERROR_SINE, ERROR_COSINE = SIZE, SIZE + 1
BIAS = SIZE + 2  # along the hand, and after it across
ACCELEROMETER_SIZE = BIAS + AXES
"""Entries of z with an accelerometer."""
DIFFERENCED = RIPPLE.start
"""First entries of z, for which derivatives are differences; those of the ripple follow from that of d."""

STEPS = np.array([1e-2, 1e-1, 1e-4, 1e-2, *[1e-2] * len(IDENTIFIED), *[1e-2] * 7, 1e-3, 1e-4, 1e-4])
"""For these differences, and for those of the kinematic error, shape (DIFFERENCED + 2,)."""
SHORTEST, LONGEST = 0.02, 6.0
"""Delay and, of the former, current loop [samples]. A shorter one would be none, and so would its derivative."""
STIFFEST = 0.6
"""Stiffening of a belt that is believed at most."""
_RIPPLE = [0.02] * (RIPPLE.stop - RIPPLE.start)
_ACCELEROMETER = [2e-3, 2e-3, 2 * ZERO_G, 2 * ZERO_G]
_SYMMETRIC = [0.06, *_RIPPLE, *_ACCELEROMETER]  # of d and of what follows
_LOWEST = [-300, -2000, -2, -200, -0.9, -1.4, -0.5, -2, -2, -0.7, SHORTEST, SHORTEST, -0.6, -0.6, -0.5, -0.3, -1.9]
_HIGHEST = [300, 2000, 2, 200, 1.8, 0.9, 0.6, 1.6, 1.6, 0.9, LONGEST, 2, 0.6, 0.6, 1.5, 0.3, 2.7]
LOWEST = np.array(_LOWEST + [-most for most in _SYMMETRIC])
HIGHEST = np.array(_HIGHEST + _SYMMETRIC)
"""Bounds of z, far beyond any arm of the benchmark: an arm within them can be integrated."""

_EARLIEST = 1e-6  # latency [samples]: all arms take both pieces of a sample, whoever is simulated beside them
REACH = 4
"""Samples over which the current loop remembers commands."""
HISTORY = int(LONGEST) + 2 + REACH
"""Commands of the past that the motion depends on."""
ARMS = 32
"""Arms that are simulated side by side, each with copies of it: up to LANES of both together."""
_ROWS = np.array([FIELDS.index(name) for name in IDENTIFIED])
NOMINAL_DEFLECTION = 0.002
"""Of a motor that gives before it slips, before anything is measured [rad]; it lies within 0.3 and 30 mrad."""
_LEFT_OUT = ("payload_mass", "torque_constant_error", "friction_drift", "torque_ripple", "kinematic_error")


def nominal_row(params: ArmParams) -> Floats:
    """Constants of the arm believed in before anything is measured, shape (len(FIELDS),).

    Its payload is part of its swing; what is not believed in, or by z alone, is zero. Every motor gives before it
    slips: a filter that believes in clean stiction takes a spring for a motor that slides with little friction.
    """
    row = params.row()
    row[COLUMN.arm_inertia_swing] = params.plant().inertia_swing
    for name in _LEFT_OUT:
        row[FIELDS.index(name)] = 0.0
    row[COLUMN.presliding_deflection] = NOMINAL_DEFLECTION
    return row


class Nominal(NamedTuple):
    """Arm that is believed in before anything is measured."""

    row: Floats  # from `nominal_row`
    model: Model  # whose equations of motion it obeys, identified or not


Constants = namedtuple("Constants", FIELDS)
"""All constants of one arm: a row that is not an array."""


@inlined
def constants_of(constants: Floats, lane: int) -> Any:
    """Load the constants of one lane."""
    return Constants._make(constants[k * LANES + lane] for k in range(len(FIELDS)))


@compiled
def believe(z: Floats, arms: int, nominal: Floats, constants: Floats) -> None:
    """Write the constants that z stands for, all but its ripple and d.

    Args:
        z: Of some arms, a row of LANES for each entry, shape (SIZE * LANES,) or (ACCELEROMETER_SIZE * LANES,).
        arms: How many.
        nominal: From `nominal_row`.
        constants: A row of LANES for each of `FIELDS`, shape (len(FIELDS) * LANES,); written.
    """
    for i in range(len(nominal)):
        for lane in range(arms):
            constants[i * LANES + lane] = nominal[i]
    for i in range(len(_ROWS)):
        _believe_log(z, arms, i, nominal, constants)
    _believe_drive(z, arms, nominal, constants)


@compiled
def believe_entry(z: Floats, entry: int, arms: int, nominal: Floats, constants: Floats) -> None:
    """Write the constants that depend on an entry of z; arguments as of `believe`."""
    if entry >= LOGS.stop:
        _believe_drive(z, arms, nominal, constants)
    elif entry >= LOGS.start:
        _believe_log(z, arms, entry - LOGS.start, nominal, constants)


@compiled
def _believe_log(z: Floats, arms: int, k: int, nominal: Floats, constants: Floats) -> None:
    """Write the constant of which the logarithm is LOGS.start + k."""
    own, logs, unit = constants[_ROWS[k] * LANES :], z[(LOGS.start + k) * LANES :], nominal[_ROWS[k]]
    for lane in range(arms):
        own[lane] = unit * exponential(logs[lane])


@compiled
def _believe_drive(z: Floats, arms: int, nominal: Floats, constants: Floats) -> None:
    """Write the constants of the drive alone."""
    for lane in range(arms):
        delay, sine, cosine = z[DELAY * LANES + lane], z[SINE * LANES + lane], z[COSINE * LANES + lane]
        lag = min(z[LAG * LANES + lane], delay)
        excess = nominal[COLUMN.static_friction_excess] + z[EXCESS * LANES + lane]
        stiffening = nominal[COLUMN.belt_stiffening] + z[STIFFENING * LANES + lane]
        constants[COLUMN.current_loop_time_constant * LANES + lane] = lag * CONTROL_PERIOD
        constants[COLUMN.command_latency * LANES + lane] = max(delay - lag, _EARLIEST) * CONTROL_PERIOD
        constants[COLUMN.friction_variation * LANES + lane] = math.sqrt(sine * sine + cosine * cosine)
        constants[COLUMN.friction_variation_phase * LANES + lane] = polar_angle(sine, cosine)
        constants[COLUMN.static_friction_excess * LANES + lane] = max(excess, 0.0)
        constants[COLUMN.belt_stiffening * LANES + lane] = min(max(stiffening, 0.0), STIFFEST)
        deflection = nominal[COLUMN.presliding_deflection] * exponential(z[GIVING * LANES + lane])
        constants[COLUMN.presliding_deflection * LANES + lane] = deflection
    if len(z) > SIZE * LANES:
        for lane in range(arms):
            sine, cosine = z[ERROR_SINE * LANES + lane], z[ERROR_COSINE * LANES + lane]
            constants[COLUMN.kinematic_error * LANES + lane] = math.sqrt(sine * sine + cosine * cosine)
            constants[COLUMN.kinematic_error_phase * LANES + lane] = polar_angle(sine, cosine)


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
def write_ripple(of: Floats, z: Floats, arms: int, shapes: Floats, torques: Floats) -> None:
    """Write the torque ripple [N m] of some arms over a sample.

    Args:
        of: Lanes of which the first two rows are the motor's angle [rad] and speed [rad/s] when it begins.
        z: Of the arms, as of `believe`.
        arms: How many.
        shapes: Sine and cosine of each of ORDERS from `ripple_shape`, a row each, written.
        torques: Shape (LANES,), written.
    """
    for lane in range(arms):
        torques[lane] = 0.0
    for k in range(len(ORDERS)):
        for lane in range(arms):
            sine, cosine = ripple_shape(of[lane], of[LANES + lane], k)
            shapes[2 * k * LANES + lane], shapes[(2 * k + 1) * LANES + lane] = sine, cosine
            by_sine, by_cosine = (RIPPLE.start + 2 * k) * LANES + lane, (RIPPLE.start + 2 * k + 1) * LANES + lane
            torques[lane] += z[by_sine] * sine + z[by_cosine] * cosine


@compiled
def other_torque(z: Floats, angle: float, speed: float) -> float:
    """Torque ripple and d over a sample, what acts on a motor beside its drive and friction [N m].

    Args:
        z: Of the arm, shape (SIZE,) or (ACCELEROMETER_SIZE,).
        angle: Of the motor when the sample begins [rad].
        speed: [rad/s]
    """
    ripple = 0.0
    for k in range(len(ORDERS)):
        sine, cosine = ripple_shape(angle, speed, k)
        ripple += z[RIPPLE.start + 2 * k] * sine + z[RIPPLE.start + 2 * k + 1] * cosine
    return z[DISTURBANCE] + ripple
