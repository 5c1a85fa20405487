"""Compensation of Coulomb friction: the direction in which the motor is to slide.

While the motor turns, friction tau_f is tau_c against the motion. Where the motor rests, there is no motion to go by.
Two laws say which way it is to break away:

`commanded_direction`, for servos. The commanded direction is known without noise. Where the reference rests, there is
none, and what is compensated is the friction against which the feedback pushes, over a ramp through zero:

    tau_f = c tau_c sign(theta_ref')                 while the reference moves
    tau_f = c tau_c clip(push / width, -1, 1)        while it rests

A push beyond `width` [N m] then breaks the motor away from where it sticks; one of a few encoder counts does not. c is
the share of the nominal tau_c that is compensated: too little leaves the motor stuck off its goal, too much makes it
hunt around it.

`breakaway_direction`, for controllers that estimate the motor's speed or plan it: tau_f = c tau_c sign(omega_a) above a
small speed, and below it the sign of the torque asked of the motor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baselines.gains import Gains, tunable
from baselines.models.rigid_arm import Motion
from beltarm_env import CONTROL_PERIOD
from beltarm_env.arrays import Floats

_RESTING = 1e-6  # joint speed below which a reference rests [rad/s]: planned speeds end at zero but for rounding


@dataclass(frozen=True)
class FrictionGains(Gains):
    """Gains of the friction compensation; base of the gains of servo controllers."""

    friction: float = tunable(0.95, 0.0, 2.0)  # c  [-]  share of the nominal tau_c
    rest_width: float = tunable(0.005, 0.0001, 0.3, log=True)  # [N m]  push compensated in full while at rest


def commanded_direction(wanted: Motion, push: Floats, width: float) -> Floats:
    """Direction in which friction is to be overcome, from -1 to 1.

    Args:
        wanted: Reference motion; what counts is its mean speed until the next sample.
        push: Torque of the feedback [N m].
        width: The push that is compensated in full while the reference rests [N m].
    """
    speed = wanted.speed + 0.5 * CONTROL_PERIOD * wanted.acceleration
    pushed = np.minimum(np.maximum(push / width, -1.0), 1.0)
    return np.where(np.abs(speed) < _RESTING, pushed, np.sign(speed))


def breakaway_direction(speed: Floats, torque: Floats, slow: float) -> Floats:
    """Sign of the motor's speed [rad/s]; below `slow`, where friction holds it, that of the torque asked of it."""
    return np.where(np.abs(speed) > slow, np.sign(speed), np.sign(torque))
