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

import numpy as np
from scipy.linalg import solve_discrete_are

from baselines.models.actuator import dead_time
from baselines.models.linear import ANGLES, LinearArms, at_angle, linear_arm
from baselines.reading import Reading
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arrays import Flags, Floats
from beltarm_env.simulation import ArmSimulation, X
from beltarm_env.task.sensors import ENCODER_COUNTS

QUANTUM = 2 * np.pi / ENCODER_COUNTS
"""One count of the encoder [rad]."""
_SLIDES = 2 * QUANTUM  # an innovation that a motor at rest cannot cause
AT_REST = 0.2
"""Correction of the angle of a motor at rest, per sample."""
_LARGEST_TORQUE = 0.05  # of d [N m]; beyond any friction's error
_LARGEST = np.array([300.0, 2000.0, 2.0, 200.0])  # of the state: keeps an estimate that has diverged finite


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


def steady_gain(
    arm: LinearArms, torque: float, acceleration: float, kept: float, growth: float, open_to: float = 0.0
) -> Floats:
    """Steady-state Kalman gain for [x; d], shape (5,), of an encoder with its usual rounding.

    Args:
        arm: One linear arm at one angle.
        torque: White noise at the motor, its standard deviation [N m].
        acceleration: White noise of the torsion [rad/s^2].
        kept: Share of d that is left after a sample.
        growth: Variance that d gains in a sample [(N m)^2].
        open_to: Variance that the motor's angle gains beside that [rad^2].
    """
    transition, covariance = np.diag([0.0, 0.0, 0.0, 0.0, kept]), np.zeros((5, 5))
    transition[:4, :4], transition[:4, 4] = arm.transition, arm.by_torque
    for by_noise, deviation in ((arm.by_torque, torque), (arm.by_acceleration, acceleration)):
        covariance[:4, :4] += deviation**2 * np.outer(by_noise, by_noise)
    covariance[0, 0] += open_to
    covariance[4, 4] = growth
    rounding = QUANTUM**2 / 12
    before = solve_discrete_are(transition.T, np.eye(5, 1), covariance, np.array([[rounding]]))
    return before[:, 0] / (before[0, 0] + rounding)


@lru_cache(maxsize=64)
def kalman_gains(params: ArmParams, noise: Noise) -> Floats:
    """Steady-state gains L for [x; d] at each of `ANGLES`, shape (46, 5)."""
    arms, growth = linear_arm(params), noise.disturbance**2 * CONTROL_PERIOD
    rows = [LinearArms(*(part[k] for part in arms)) for k in range(len(ANGLES))]
    return np.array([steady_gain(arm, noise.torque, noise.acceleration, 1.0, growth) for arm in rows])


class StickSlipObserver:
    """Kalman filter for arms with design parameters `params`."""

    def __init__(self, params: ArmParams, noise: Noise | None = None) -> None:
        self.params = params
        self._gains = kalman_gains(params, noise or Noise())
        self._delay = dead_time(params) / CONTROL_PERIOD

    def update(self, estimate: Estimate | None, reading: Reading, begins: Flags) -> Estimate:
        """Bring the estimate up to this sample.

        Args:
            estimate: That of the last sample; None at the beginning.
            reading: Measurements, and the torque commanded since the last sample.
            begins: Which arms begin an episode, at rest where their encoder is; shape (n,).
        """
        simulation = estimate.simulation if estimate else ArmSimulation(self.params, len(begins))
        at_rest = simulation.at_rest(reading.motor_angle)
        if estimate is None:
            return Estimate(at_rest, at_rest[:, :X], np.zeros(len(begins)), simulation)
        arm, disturbance = self._corrected(estimate, reading)
        arm, disturbance = np.where(begins[:, None], at_rest, arm), np.where(begins, 0.0, disturbance)
        held = np.where(begins, 0.0, reading.last_command) + np.where(arm[:, 1] != 0, disturbance, 0.0)
        ahead = simulation.ahead(arm, held, np.full(len(begins), self._delay))
        return Estimate(arm, ahead, disturbance, simulation)

    def _corrected(self, estimate: Estimate, reading: Reading) -> tuple[Floats, Floats]:
        moving = estimate.arm[:, 1] != 0
        torque = reading.last_command + np.where(moving, estimate.disturbance, 0.0)
        predicted = estimate.simulation.advance(estimate.arm, torque)
        sticks = (predicted[:, 1] == 0) & (np.abs(reading.motor_angle - predicted[:, 0]) <= _SLIDES)
        correction = self._correction(estimate, reading, predicted, sticks)
        predicted[:, :X] = np.clip(predicted[:, :X] + correction[:, :X], -_LARGEST, _LARGEST)
        disturbance = estimate.disturbance + correction[:, X]
        return predicted, np.clip(disturbance, -_LARGEST_TORQUE, _LARGEST_TORQUE)

    def _correction(self, estimate: Estimate, reading: Reading, predicted: Floats, sticks: Flags) -> Floats:
        """What the readings add to the predicted [x; d], shape (n, 5).

        Args:
            estimate: That of the last sample.
            reading: Measurements.
            predicted: From `estimate`, shape (n, size).
            sticks: Which motors stick, shape (n,).
        """
        gains = at_angle(self._gains, predicted[:, 0] / self.params.gear_ratio)
        gains[sticks] = AT_REST, 0.0, 0.0, 0.0, 0.0
        return gains * (reading.motor_angle - predicted[:, 0])[:, None]
