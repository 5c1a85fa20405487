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

from baselines.estimation.tracking import (
    QUANTUM,
    ObserverDesign,
    Track,
    acting_torques,
    begin_arms,
    correct_arms,
)
from baselines.models.actuator import dead_time
from baselines.models.linear import ANGLES, LinearArms, linear_arm
from baselines.reading import Reading
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arrays import Flags, Floats
from beltarm_env.kernels.simulate import room_for_one, state_size
from beltarm_env.simulation import ArmSimulation, X


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
    arm: LinearArms, torque: float, acceleration: float, decay: float, growth: float, open_to: float = 0.0
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
    transition, covariance = np.diag([0.0, 0.0, 0.0, 0.0, decay]), np.zeros((5, 5))
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
            self._correct(estimate, reading, begins, states, disturbances)
        begin_arms(simulation.room.blocks, reading.motor_angle, begins, states, disturbances)
        acting_torques(commands, begins, states, disturbances, torques)
        ahead = simulation.ahead(states, torques, np.full(count, self.design.delay))
        return Estimate(states, ahead, disturbances, simulation)

    def _correct(
        self, estimate: Estimate, reading: Reading, begins: Flags, states: Floats, disturbances: Floats
    ) -> None:
        """Correct predicted states, shape (n, size), and write the disturbances, shape (n,).

        Args:
            estimate: That of the last sample.
            reading: Measurements.
            begins: Arms whose numbers do not matter.
            states: Predicted from `estimate`, written.
            disturbances: Written.
        """
        correct_arms(self.design, states, estimate.disturbance, reading.motor_angle, begins, disturbances)
