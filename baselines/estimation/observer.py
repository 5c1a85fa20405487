"""State of the arm from encoder and commanded torque: a Kalman filter that models stiction.

The prediction is the design model itself, its drive and its friction included, one control period on:

    x^- = f(x, u + d)

with a slowly changing disturbance torque d at the motor, for friction and inertia that differ from the nominal. The
correction is the error of the predicted encoder angle, weighted,

    [x; d] = [x^-; d] + L(theta_1) (theta_a - x^-_1)

with the steady-state gain L of the linear arm (by the discrete algebraic Riccati equation), tabulated over the joint
angle. The motor's torque and the commands that are under way are states of f too, and known: they are not corrected.
The encoder's rounding, a quantum q, counts as white noise of variance q^2 / 12. Process noise is a torque at the motor,
a torsional acceleration (stiffness and inertia that differ) and the random walk of d.

While the motor sticks, the encoder carries no information about the torsion: then only the angle is corrected, and
torsion and its rate follow the model alone. If the encoder moves by more than two counts, the filter takes the motor to
slide.

The estimate is that of now. Beside it stands the state at the time at which a command of now will act, predicted by f
over the dead time of the drive (`baselines.models.linear`) under the commands that are known.

See B. D. O. Anderson, J. B. Moore: Optimal Filtering, 1979.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import solve_discrete_are

from baselines.models.linear import ANGLES, LinearArm, between, dead_time, linear_arm, place
from baselines.reading import Sample
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arm import COLUMN
from beltarm_env.arrays import Flags, Floats
from beltarm_env.engine import compiled, inlined
from beltarm_env.kernels.layout import LANES
from beltarm_env.kernels.simulate import (
    DRIVE_STATES,
    Room,
    X,
    action_of,
    advance_arms,
    hold_friction,
    load_arm,
    look_ahead_arms,
    rest_arm,
)
from beltarm_env.physics.models import LUMPED
from beltarm_env.task.sensors import ENCODER_COUNTS

QUANTUM = 2 * np.pi / ENCODER_COUNTS
"""One count of the encoder [rad]."""
SLIDES = 2 * QUANTUM
"""An innovation that a motor at rest cannot cause [rad]."""
AT_REST = 0.2
"""Correction of the angle of a motor at rest, per sample."""
_AT_REST = np.array([AT_REST, 0.0, 0.0, 0.0, 0.0])
LARGEST = np.array([300.0, 2000.0, 2.0, 200.0, 0.05])
"""Of x: keeps an estimate that has diverged finite. Of d [N m]: beyond any friction's error."""
STATE, AHEAD, DISTURBANCE = slice(X + DRIVE_STATES), slice(X + DRIVE_STATES, 2 * X + DRIVE_STATES), 2 * X + DRIVE_STATES
"""Entries of an estimate: of arm and drive, as `ArmSimulation` has them, of which the first are x now; x at the time at
which a command of now acts; and d [N m]."""
ESTIMATE_SIZE = DISTURBANCE + 1


class ObserverDesign(NamedTuple):
    """What a filter knows: the design model, and its gains."""

    row: Floats  # constants of the design model, as the fields of `ArmParams`
    gains: Floats  # L at each of `ANGLES`, shape (46, 5)
    delay: float  # dead time of the drive [samples]


class Measured(NamedTuple):
    """What n arms measure in one sample."""

    angle: Floats  # of the motor [rad], shape (n,)
    command: Floats  # of the last sample [N m], shape (n,)
    acceleration: Any = None  # of the tip, see `accelerometer.unfiltered`, less b; NaN where it tells none; (n, AXES)


Correction = Callable[[Any, Measured, int, Floats, Floats], None]
"""See `correct`."""


@inlined
def acting_torque(command: float, estimate: Floats) -> float:
    """Torque u + d [N m]; a motor that sticks has no disturbance."""
    return command + (estimate[DISTURBANCE] if estimate[1] != 0.0 else 0.0)


@inlined
def add_correction(estimate: Floats, i: int, correction: float) -> None:
    """Add a correction to the i-th entry of [x; d], within its bounds."""
    entry = i if i < X else DISTURBANCE
    estimate[entry] = min(max(estimate[entry] + correction, -LARGEST[i]), LARGEST[i])


@inlined
def sticks(estimate: Floats, motor_angle: float) -> bool:
    """Whether a motor is taken to stick, by its predicted state and the encoder [rad]."""
    return (estimate[1] == 0.0) & (abs(motor_angle - estimate[0]) <= SLIDES)


@compiled
def correct(design: ObserverDesign, measured: Measured, arm: int, predicted: Floats, estimate: Floats) -> None:
    """Replace the last sample's estimate for one arm by the predicted state, corrected by the encoder."""
    estimate[STATE] = predicted
    at_rest, innovation = sticks(estimate, measured.angle[arm]), measured.angle[arm] - estimate[0]
    row, weight = place(estimate[0] / design.row[COLUMN.gear_ratio])
    for i in range(X + 1):
        gain = _AT_REST[i] if at_rest else between(design.gains[row, i], design.gains[row + 1, i], weight)
        add_correction(estimate, i, gain * innovation)


@compiled
def observe(
    correct: Correction, design: ObserverDesign, measured: Measured, begins: Flags, estimates: Floats, room: Room
) -> None:
    """Bring the estimates for n arms up to this sample, together: one after the other takes three times as long.

    Args:
        correct: By what is measured.
        design: What the filter knows, and whatever else `correct` needs.
        measured: By the arms.
        begins: Which arms begin a move, taken to rest where their encoder is; shape (n,).
        estimates: Shape (n, ESTIMATE_SIZE or more), written.
        room: Of an `ArmSimulation` of n arms or more.
    """
    count, limit, size = len(begins), float(design.row[COLUMN.torque_limit]), X + DRIVE_STATES
    delays, actions, predicted = np.full(count, design.delay), np.empty(count), np.empty((count, size))
    for i in range(count):
        if begins[i]:
            rest_arm(room.blocks[i // LANES], i % LANES, measured.angle[i], estimates[i, STATE])
            estimates[i, DISTURBANCE] = 0.0
        actions[i] = action_of(acting_torque(0.0 if begins[i] else measured.command[i], estimates[i]), limit)
    advance_arms(room, estimates[:, STATE], actions, LUMPED, predicted)
    for i in range(count):
        if not begins[i]:
            correct(design, measured, i, predicted[i], estimates[i])
            actions[i] = action_of(acting_torque(measured.command[i], estimates[i]), limit)
    look_ahead_arms(room, estimates[:, STATE], actions, delays, LUMPED, estimates[:, AHEAD])


class ObservedArm(NamedTuple):
    """Memory of observer and law of one arm, written in place."""

    rows: Floats  # estimate, and what the law keeps besides, shape (1, size)
    room: Room


@compiled
def observe_arm(design: ObserverDesign, now: Sample, begins: bool, rows: Floats, room: Room) -> None:
    """Bring the estimate for one arm up to this sample, from its encoder."""
    if begins:
        load_arm(room.blocks[0], 0, design.row, LUMPED)
        hold_friction(room.blocks[0], 0)
    measured = Measured(np.full(1, now.motor_angle), np.full(1, now.last_command))
    observe(correct, design, measured, np.full(1, begins), rows, room)


class Noise(NamedTuple):
    """Standard deviations of the process noise."""

    torque: float  # at the motor, white [N m]
    acceleration: float  # torsional, white [rad/s^2]
    disturbance: float  # growth of d [N m / sqrt(s)]


def with_disturbance(arm: LinearArm, torque: float, acceleration: float, decay: float) -> tuple[Floats, Floats]:
    """Transition of [x; d] and covariance of its noise, but for that of d, see `steady_gain`."""
    transition, covariance = np.diag([0.0, 0.0, 0.0, 0.0, decay]), np.zeros((5, 5))
    transition[:4, :4], transition[:4, 4] = arm.transition, arm.by_torque
    for by_noise, deviation in ((arm.by_torque, torque), (arm.by_acceleration, acceleration)):
        covariance[:4, :4] += deviation**2 * np.outer(by_noise, by_noise)
    return transition, covariance


def steady_gain(
    arm: LinearArm, torque: float, acceleration: float, decay: float, growth: float, open_to: float = 0.0
) -> Floats:
    """Steady-state Kalman gain for [x; d], shape (5,), of an encoder with its usual rounding.

    Args:
        arm: One linear arm at one angle.
        torque: White noise at the motor, its standard deviation [N m].
        acceleration: White noise of the torsion [rad/s^2].
        decay: Share of d that is left after a sample.
        growth: Variance that d gains in a sample [(N m)^2].
        open_to: Variance that the motor's angle gains beside that [rad^2].
    """
    transition, covariance = with_disturbance(arm, torque, acceleration, decay)
    covariance[0, 0] += open_to
    covariance[4, 4] = growth
    rounding = QUANTUM**2 / 12
    before = solve_discrete_are(transition.T, np.eye(5, 1), covariance, np.array([[rounding]]))
    return before[:, 0] / (before[0, 0] + rounding)


@lru_cache(maxsize=64)
def kalman_gains(params: ArmParams, noise: Noise) -> Floats:
    """Steady-state gains L for [x; d] at each of `ANGLES`, shape (46, 5)."""
    arms, growth = linear_arm(params), noise.disturbance**2 * CONTROL_PERIOD
    rows = [arms.at(k) for k in range(len(ANGLES))]
    return np.array([steady_gain(arm, noise.torque, noise.acceleration, 1.0, growth) for arm in rows])


def observer_design(params: ArmParams, noise: Noise) -> ObserverDesign:
    """Filter of arms with design parameters `params`."""
    return ObserverDesign(params.row(), kalman_gains(params, noise), dead_time(params) / CONTROL_PERIOD)
