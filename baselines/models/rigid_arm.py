"""What servo controllers share: computed torque of the rigid arm and compensation of Coulomb friction.

With a rigid belt (phi = theta_1 = theta_a / G), (5a) and the completed (5b) add up to one equation at the motor shaft:

    tau_m = (M_a1 + M2 / G^2) theta_a'' + 1/2 M2' theta_1'^2 / G + V_a1 theta_a' + tau_f
    M2 = M2(0) + S sin^2(theta_1),    1/2 M2' = 1/2 S sin(2 theta_1)

with the inertias M_a1 of the motor and M2 of the links about joint 1 [kg m^2], the gear ratio G, viscous friction
V_a1 [N m s/rad] and Coulomb friction tau_f [N m]. Leaving the middle term out, this is the paper's (4).

While the motor turns, tau_f is tau_c against the motion. It is compensated by the *commanded* direction, which is known
without noise. Where the reference rests, there is none, and what is compensated is the friction against which the
feedback pushes, over a ramp through zero:

    tau_f = c tau_c sign(theta_ref')                 while the reference moves
    tau_f = c tau_c clip(push / width, -1, 1)        while it rests

A push beyond `width` [N m] then breaks the motor away from where it sticks; one of a few encoder counts does not. c is
the share of the nominal tau_c that is compensated: too little leaves the motor stuck off its goal, too much makes it
hunt around it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.gains import Gains, tunable
from baselines.reading import Reading
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arm import FIELDS, Plant, plant_of

Floats = NDArray[np.float64]

_RESTING = 1e-6  # joint speed below which a reference rests [rad/s]: planned speeds end at zero but for rounding


class Motion(NamedTuple):
    """A motion of the joint at one instant; arrays of shape (n,)."""

    angle: Floats  # [rad]
    speed: Floats  # [rad/s]
    acceleration: Floats  # [rad/s^2]


def task_motion(now: Reading) -> Motion:
    """The task's reference at this sample."""
    return Motion(now.reference_angle, now.reference_speed, now.reference_acceleration)


def motor_errors(now: Reading, wanted: Motion, params: ArmParams) -> tuple[Floats, Floats]:
    """How far the motor's angle [rad] and speed [rad/s] are behind those of a motion of the joint."""
    gear = params.gear_ratio
    return gear * wanted.angle - now.motor_angle, gear * wanted.speed - now.motor_speed


def coefficients(params: ArmParams) -> Plant:
    """Coefficients of an arm's equations of motion: M2(0), S with the payload, D_s, ..."""
    return plant_of(np.array([getattr(params, name) for name in FIELDS]))


class RigidArm:
    """Inverse dynamics of the arm with a rigid belt."""

    def __init__(self, params: ArmParams) -> None:
        self._params, self._plant = params, coefficients(params)

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


@dataclass(frozen=True)
class FrictionGains(Gains):
    """How Coulomb friction is compensated; base of the gains of servo controllers."""

    friction: float = tunable(0.95, 0.0, 2.0)  # c  [-]  share of the nominal tau_c
    rest_width: float = tunable(0.005, 0.0001, 0.3, log=True)  # [N m]  push compensated in full while at rest


def friction_direction(wanted: Motion, push: Floats, width: float) -> Floats:
    """Direction in which friction is to be overcome, from -1 to 1.

    Args:
        wanted: Reference motion; what counts is its mean speed until the next sample.
        push: Torque of the feedback [N m].
        width: The push that is compensated in full while the reference rests [N m].
    """
    speed = wanted.speed + 0.5 * CONTROL_PERIOD * wanted.acceleration
    pushed = np.minimum(np.maximum(push / width, -1.0), 1.0)
    return np.where(np.abs(speed) < _RESTING, pushed, np.sign(speed))
