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
over the dead time of the drive (`baselines.models.actuator`) under the commands that are known.

See B. D. O. Anderson, J. B. Moore: Optimal Filtering, 1979.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_discrete_are

from baselines.models.actuator import dead_time
from baselines.models.linear import ANGLES, LinearArm, between, linear_arm, place
from baselines.reading import Reading, Sample
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arm import COLUMN
from beltarm_env.arrays import Flags, Floats
from beltarm_env.engine import compiled, inlined
from beltarm_env.kernels.layout import LANES
from beltarm_env.kernels.simulate import (
    Room,
    advance_arm,
    hold_friction,
    load_arm,
    look_ahead,
    rest_arm,
    room_for_one,
    state_size,
)
from beltarm_env.physics.models import LUMPED
from beltarm_env.simulation import ArmSimulation, X
from beltarm_env.task.sensors import ENCODER_COUNTS

QUANTUM = 2 * np.pi / ENCODER_COUNTS
"""One count of the encoder [rad]."""
SLIDES = 2 * QUANTUM
"""An innovation that a motor at rest cannot cause [rad]."""
AT_REST = 0.2
"""Correction of the angle of a motor at rest, per sample."""
_AT_REST = np.array([AT_REST, 0.0, 0.0, 0.0, 0.0])
LARGEST_TORQUE = 0.05
"""Of d [N m]: beyond any friction's error."""
LARGEST = np.array([300.0, 2000.0, 2.0, 200.0])
"""Of x: keeps an estimate that has diverged finite."""


class ObserverDesign(NamedTuple):
    """What a filter of one arm knows: the design model, and its gains."""

    row: Floats  # constants of the design model, as the fields of `ArmParams`
    gains: Floats  # L at each of `ANGLES`, shape (46, 5)
    delay: float  # dead time of the drive [samples]


class Track(NamedTuple):
    """Memory of a filter of one arm, written in place."""

    state: Floats  # of arm and drive, shape (size,)
    ahead: Floats  # x at the time at which a command of now acts, shape (4,)
    disturbance: Floats  # d [N m], shape (1,)
    moved: Floats  # room for a state, shape (size,)
    room: Room


@inlined
def acting_torque(command: float, motor_speed: float, disturbance: float) -> float:
    """Torque u + d [N m]; a motor that sticks has no disturbance."""
    return command + (disturbance if motor_speed != 0.0 else 0.0)


@inlined
def limited(value: float, largest: float) -> float:
    """The value within its bounds, -largest and largest."""
    return min(max(value, -largest), largest)


@inlined
def sticks(state: Floats, motor_angle: float) -> bool:
    """Whether a motor is taken to stick, by its predicted state, shape (size,), and the encoder [rad]."""
    return (state[1] == 0.0) & (abs(motor_angle - state[0]) <= SLIDES)


@compiled
def correct(design: ObserverDesign, state: Floats, disturbance: float, motor_angle: float) -> float:
    """Correct the predicted state of one arm by its encoder [rad], and return the corrected disturbance [N m]."""
    at_rest, innovation = sticks(state, motor_angle), motor_angle - state[0]
    row, weight = place(state[0] / design.row[COLUMN.gear_ratio])
    for i in range(X):
        gain = _AT_REST[i] if at_rest else between(design.gains[row, i], design.gains[row + 1, i], weight)
        state[i] = limited(state[i] + gain * innovation, LARGEST[i])
    gain = _AT_REST[X] if at_rest else between(design.gains[row, X], design.gains[row + 1, X], weight)
    return limited(disturbance + gain * innovation, LARGEST_TORQUE)


@compiled
def track_arm(design: ObserverDesign, now: Sample, begins: bool, track: Track) -> None:
    """Bring the estimate of one arm up to this sample, see `StickSlipObserver.update`."""
    limit, command = float(design.row[COLUMN.torque_limit]), 0.0 if begins else now.last_command
    if begins:
        load_arm(track.room.blocks, 0, design.row, LUMPED)
        hold_friction(track.room.blocks, 0)
        rest_arm(track.room.blocks, 0, now.motor_angle, track.state)
        track.disturbance[0] = 0.0
    else:
        torque = acting_torque(command, track.state[1], track.disturbance[0])
        advance_arm(track.room, track.state, torque, limit, LUMPED)
        track.disturbance[0] = correct(design, track.state, track.disturbance[0], now.motor_angle)
    torque = acting_torque(command, track.state[1], track.disturbance[0])
    look_ahead(track.room, track.state, torque, limit, design.delay, LUMPED, track.ahead, track.moved)


@compiled
def acting_torques(commands: Floats, begins: Flags, states: Floats, disturbances: Floats, torques: Floats) -> None:
    """Write the torques that act on n arms [N m], see `acting_torque`; those that begin have no command yet."""
    for i in range(len(states)):
        torques[i] = acting_torque(0.0 if begins[i] else commands[i], states[i, 1], disturbances[i])


@compiled
def correct_arms(design: ObserverDesign, states: Floats, last: Floats, angles: Floats, disturbances: Floats) -> None:
    """Correct the predicted states of n arms, and write their disturbances [N m] from those of the last sample."""
    for i in range(len(states)):
        disturbances[i] = correct(design, states[i], last[i], angles[i])


@compiled
def begin_arms(blocks: Floats, motor_angles: Floats, begins: Flags, states: Floats, disturbances: Floats) -> None:
    """Put those of n arms that begin at rest where their encoders are [rad], without a disturbance."""
    for i in range(len(states)):
        if begins[i]:
            rest_arm(blocks[i // LANES], i % LANES, motor_angles[i], states[i])
            disturbances[i] = 0.0


@dataclass(frozen=True, slots=True)
class Noise:
    """Standard deviations of the process noise."""

    torque: float = 3e-3  # at the motor, white [N m]
    acceleration: float = 5.0  # torsional, white [rad/s^2]
    disturbance: float = 0.1  # growth of d [N m / sqrt(s)]


@dataclass(frozen=True)
class Estimate:
    """Estimated states of n arms."""

    arm: Floats  # x = [theta_a, omega_a, theta_s, omega_s] now and the drive's states, as `ArmSimulation` has them
    ahead: Floats  # x at the time at which a command of now acts, shape (n, 4)
    disturbance: Floats  # d [N m], shape (n,)
    simulation: ArmSimulation = field(repr=False)  # of n arms of the design model; has no state of its own

    @property
    def state(self) -> Floats:
        """Estimate of x now, shape (n, 4)."""
        return self.arm[:, :X]


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


class StickSlipObserver:
    """Kalman filter for arms with design parameters `params`.

    Many arms are predicted side by side; `track_arm` does the same for one arm, by the same kernels.
    """

    def __init__(self, params: ArmParams, noise: Noise | None = None) -> None:
        self.params = params
        gains = kalman_gains(params, noise or Noise())
        self.design = ObserverDesign(params.row(), gains, dead_time(params) / CONTROL_PERIOD)

    def track(self) -> Track:
        """Memory of `track_arm`."""
        size = state_size(self.design.row[None])
        return Track(np.zeros(size), np.zeros(X), np.zeros(1), np.zeros(size), room_for_one())

    def update(self, estimate: Estimate | None, reading: Reading, begins: Flags) -> Estimate:
        """Bring the estimate up to this sample.

        Args:
            estimate: That of the last sample; None at the beginning.
            reading: Measurements, and the torque commanded since the last sample.
            begins: Which arms begin an episode, at rest where their encoder is; shape (n,).
        """
        count, commands = len(begins), reading.last_command
        simulation = estimate.simulation if estimate else ArmSimulation(self.params, count)
        torques, disturbances = np.empty(count), np.zeros(count)
        if estimate is None:
            begins, states = np.ones(count, np.bool_), np.zeros((count, simulation.size))
        else:
            acting_torques(commands, begins, estimate.arm, estimate.disturbance, torques)
            states = simulation.advance(estimate.arm, torques)
            self._correct(estimate, reading, states, disturbances)
        begin_arms(simulation.room.blocks, reading.motor_angle, begins, states, disturbances)
        acting_torques(commands, begins, states, disturbances, torques)
        ahead = simulation.ahead(states, torques, np.full(count, self.design.delay))
        return Estimate(states, ahead, disturbances, simulation)

    def _correct(self, estimate: Estimate, reading: Reading, states: Floats, disturbances: Floats) -> None:
        """Correct states, shape (n, size), predicted from the last sample's estimate, and write disturbances, (n,)."""
        correct_arms(self.design, states, estimate.disturbance, reading.motor_angle, disturbances)
