"""State of the arm from encoder and commanded torque: a Kalman filter that models stiction.

The prediction is the nominal arm itself, Coulomb friction included, one control period on:

    x^- = f(x, tau_m + d)

with a slowly changing disturbance torque d at the motor, for friction and inertia that differ from the nominal. The
correction is the error of the predicted encoder angle, weighted,

    [x; d] = [x^-; d] + L(theta_1) (theta_a - x^-_1)

with the steady-state gain L of the linear arm (by the discrete algebraic Riccati equation), tabulated over the joint
angle. The encoder's rounding, a quantum q, counts as white noise of variance q^2 / 12. Process noise is a torque at the
motor, a torsional acceleration (stiffness and inertia that differ) and the random walk of d.

While the motor sticks, the encoder carries no information about the torsion: then only the angle is corrected, and
torsion and its rate follow the model alone. If the encoder moves by more than two counts, the filter takes the motor to
slide. See B. D. O. Anderson, J. B. Moore: Optimal Filtering, 1979.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from scipy.linalg import solve_discrete_are

from baselines.models.linear import ANGLES, at_angle, linear_arm
from baselines.reading import Reading
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arrays import Flags, Floats
from beltarm_env.simulation import ArmSimulation
from beltarm_env.task.sensors import ENCODER_COUNTS

QUANTUM = 2 * np.pi / ENCODER_COUNTS
"""One count of the encoder [rad]."""
_SLIDES = 2 * QUANTUM  # an innovation that a motor at rest cannot cause
_AT_REST = 0.2  # correction of the angle of a motor at rest, per sample
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

    state: Floats  # x = [theta_a, omega_a, theta_s, omega_s], shape (n, 4)
    disturbance: Floats  # d [N m], shape (n,)
    simulation: ArmSimulation = field(repr=False)  # of n nominal arms; has no state of its own


@lru_cache(maxsize=64)
def kalman_gains(params: ArmParams, noise: Noise) -> Floats:
    """Steady-state gains L for [x; d] at each of `ANGLES`, shape (46, 5)."""
    tables = linear_arm(params)
    gains = np.empty((len(ANGLES), 5))
    measured = np.array([[1.0, 0, 0, 0, 0]])
    for k in range(len(ANGLES)):
        transition = np.eye(5)
        transition[:4, :4], transition[:4, 4] = tables.transition[k], tables.by_torque[k]
        covariance = np.zeros((5, 5))
        for by_noise, deviation in ((tables.by_torque, noise.torque), (tables.by_acceleration, noise.acceleration)):
            covariance[:4, :4] += deviation**2 * np.outer(by_noise[k], by_noise[k])
        covariance[4, 4] = noise.disturbance**2 * CONTROL_PERIOD
        before = solve_discrete_are(transition.T, measured.T, covariance, np.array([[QUANTUM**2 / 12]]))
        gains[k] = before[:, 0] / (before[0, 0] + QUANTUM**2 / 12)
    return gains


class StickSlipObserver:
    """Kalman filter for arms with nominal parameters `params`."""

    def __init__(self, params: ArmParams, noise: Noise | None = None) -> None:
        self.params = params
        self._gains = kalman_gains(params, noise or Noise())

    def update(self, estimate: Estimate | None, reading: Reading, begins: Flags) -> Estimate:
        """Bring the estimate up to this sample.

        Args:
            estimate: That of the last sample; None at the beginning.
            reading: Measurements, and the torque held since the last sample.
            begins: Which arms begin an episode, at rest where their encoder is; shape (n,).
        """
        at_rest = np.zeros((len(begins), 4))
        at_rest[:, 0] = reading.motor_angle
        if estimate is None:
            return Estimate(at_rest, np.zeros(len(begins)), ArmSimulation(self.params, len(begins)))
        state, disturbance = self._corrected(estimate, reading)
        state = np.where(begins[:, None], at_rest, state)
        return Estimate(state, np.where(begins, 0.0, disturbance), estimate.simulation)

    def _corrected(self, estimate: Estimate, reading: Reading) -> tuple[Floats, Floats]:
        moving = estimate.state[:, 1] != 0
        torque = reading.last_command + np.where(moving, estimate.disturbance, 0.0)
        predicted = estimate.simulation.advance(estimate.state, torque)
        innovation = reading.motor_angle - predicted[:, 0]
        gains = at_angle(self._gains, predicted[:, 0] / self.params.gear_ratio)
        sticks = (predicted[:, 1] == 0) & (np.abs(innovation) <= _SLIDES)
        gains[sticks] = _AT_REST, 0.0, 0.0, 0.0, 0.0
        state = predicted + gains[:, :4] * innovation[:, None]
        disturbance = estimate.disturbance + gains[:, 4] * innovation
        return np.clip(state, -_LARGEST, _LARGEST), np.clip(disturbance, -_LARGEST_TORQUE, _LARGEST_TORQUE)
