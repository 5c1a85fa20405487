"""Inverse dynamics of the arm with a rigid belt, and errors of the motor from a motion of the joint.

With a rigid belt (phi = theta_1 = theta_a / G), (5a) and the completed (5b) add up to one equation at the motor shaft:

    tau_m = (M_a1 + M2 / G^2) theta_a'' + 1/2 M2' theta_1'^2 / G + V_a1 theta_a' + tau_f
    M2 = M2(0) + S sin^2(theta_1),    1/2 M2' = 1/2 S sin(2 theta_1)

with the inertias M_a1 of the motor and M2 of the links about joint 1 [kg m^2], the gear ratio G, viscous friction
V_a1 [N m s/rad] and Coulomb friction tau_f [N m]. Leaving the middle term out, this is the paper's (4).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from baselines.reading import Reading
from beltarm_env import ArmParams
from beltarm_env.arrays import Floats


class Motion(NamedTuple):
    """A motion of the joint at one instant; arrays of shape (n,)."""

    angle: Floats  # [rad]
    speed: Floats  # [rad/s]
    acceleration: Floats  # [rad/s^2]


def motor_errors(now: Reading, wanted: Motion, params: ArmParams) -> tuple[Floats, Floats]:
    """Errors of the motor's angle [rad] and speed [rad/s]: those of a motion of the joint minus the measured ones.

    The angle's is the observed one, to which the motion's distance from the task's reference is added: small numbers,
    whose last digits float32 keeps.
    """
    gear = params.gear_ratio
    error = now.angle_error + gear * (wanted.angle - now.reference_angle)
    return error, gear * wanted.speed - now.motor_speed


class RigidArm:
    """Inverse dynamics of the arm with a rigid belt."""

    def __init__(self, params: ArmParams) -> None:
        self._params, self._plant = params, params.plant()

    def link_inertia(self, angle: Floats) -> Floats:
        """M2 at joint angles [rad]: inertia of the links about joint 1 [kg m^2]."""
        return self._plant.inertia + self._plant.inertia_swing * np.sin(angle) ** 2

    def inertia(self, angle: Floats) -> Floats:
        """M_a1 + M2 / G^2 at joint angles [rad]: all inertia, at the motor shaft [kg m^2]."""
        return self._params.motor_inertia + self.link_inertia(angle) / self._params.gear_ratio**2

    def link_torque(self, motion: Motion) -> Floats:
        """Motor torque that moves the links alone [N m]."""
        half_slope = 0.5 * self._plant.inertia_swing * np.sin(2 * motion.angle)
        belt = self.link_inertia(motion.angle) * motion.acceleration + half_slope * motion.speed * motion.speed
        return belt / self._params.gear_ratio

    def torque(self, motion: Motion) -> Floats:
        """Motor torque of a motion, but for friction [N m]."""
        return self._params.motor_inertia * self._params.gear_ratio * motion.acceleration + self.link_torque(motion)
