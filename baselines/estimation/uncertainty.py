"""What the identification doubts: prior uncertainty of an arm's constants, their drift, and the process noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baselines.estimation.accelerometer import AXES
from baselines.estimation.believed_arm import ACCELEROMETER_SIZE, DISTURBANCE, IDENTIFIED, LOGS, ORDERS, SIZE
from beltarm_env import CONTROL_PERIOD
from beltarm_env.arrays import Floats
from beltarm_env.task.accelerometer import BIAS as ZERO_G

_FRICTION = LOGS.start + IDENTIFIED.index("motor_viscous_friction")  # the Coulomb friction follows


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """Standard deviations: of the constants before anything is measured, their drift, and the process noise."""

    swing: float = 0.3  # of ln S with a part in the gripper, when an episode begins: most of it is the part
    stiffness: float = 0.3  # of ln K_s
    motor_inertia: float = 0.06  # of ln M_a1
    friction: float = 0.2  # of ln V_a1 and ln tau_c
    inertia: float = 0.12  # of ln M2(0)
    torque_constant: float = 0.06  # of ln(1 + k), which all of these have in common
    delay: float = 0.5  # of D [samples]
    lag: float = 0.2  # of T_i [samples]
    variation: float = 0.1  # of p and q
    excess: float = 0.14  # of s
    stiffening: float = 0.1  # of b
    giving: float = 1.0  # of g
    ripple: float = 1e-3  # of s_n and c_n [N m]
    drift: float = 0.01  # growth of all but the ripple's [1/sqrt(s)]
    friction_drift: float = 0.06  # further growth of ln V_a1 and ln tau_c, which drift [1/sqrt(s)]
    torque: float = 3e-3  # at the motor, white [N m]
    sticking: float = 4.0  # that of a motor that sticks and gives, over that of one that slides
    acceleration: float = 1.0  # torsional, white [rad/s^2]
    disturbance: float = 5e-4  # of d [N m]
    memory: float = 0.02  # time in which d decays [s]
    kinematic_error: float = 1.2e-4  # of e_s and e_c [rad]

    def covariance(self) -> Floats:
        """Initial covariance of z, shape (SIZE, SIZE), at rest; without that of the angle, which is the encoder's."""
        constants = [self.swing, self.stiffness, self.motor_inertia, self.friction, self.friction, self.inertia]
        drive = [self.delay, self.lag, self.variation, self.variation, self.excess, self.stiffening, self.giving]
        drive.append(self.disturbance)
        ripple = [self.ripple] * (2 * len(ORDERS))
        result = np.diag(np.square([0.0, 0.0, 1e-4, 1e-4, *constants, *drive, *ripple]))
        result[LOGS, LOGS] += self.torque_constant**2
        return result

    def accelerometer_covariance(self) -> Floats:
        """Initial covariance of z with an accelerometer, shape (ACCELEROMETER_SIZE, ACCELEROMETER_SIZE)."""
        result = np.diag(np.square([*[0.0] * SIZE, *[self.kinematic_error] * 2, *[ZERO_G / 3**0.5] * AXES]))
        result[:SIZE, :SIZE] = self.covariance()
        return result

    @property
    def decay(self) -> float:
        """Share of d that is left after a sample."""
        return float(np.exp(-CONTROL_PERIOD / self.memory))

    def growth(self) -> Floats:
        """Variance that each entry of z gains in a sample, but for x: shape (ACCELEROMETER_SIZE,)."""
        result = np.zeros(ACCELEROMETER_SIZE)
        result[LOGS.start : DISTURBANCE] = self.drift**2 * CONTROL_PERIOD
        result[_FRICTION : _FRICTION + 2] += self.friction_drift**2 * CONTROL_PERIOD
        result[DISTURBANCE] = (1 - self.decay**2) * self.disturbance**2
        return result
