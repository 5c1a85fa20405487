"""Compensation of dry friction: how strong it is, and the direction in which the motor is to slide.

Friction of a sliding motor falls with its speed, and is greatest where the motor is to break away (`beltarm_env.physics
.friction`). Of the design model,

    F(omega_a) = tau_c (1 + s / (1 + (omega_a / omega_s)^2))

While the motor turns, friction acts against the motion. Where the motor rests, there is no motion to go by. Two laws
say which way it is to break away, and both go through zero on a ramp: a push beyond `width` [N m] breaks the motor away
from where it sticks, one of a few encoder counts does not, and nothing chatters at rest.

`compensated`, for servos: the commanded direction is known without noise. Where the reference rests, what is
compensated is the friction against which the feedback pushes.

    tau_f = c F(G theta_ref') sign(theta_ref')             while the reference moves
    tau_f = c F(0) clip(push / width, -1, 1)               while it rests

`smooth_friction`, for controllers that estimate the motor's speed: the estimate and the torque asked of the motor add
up, so that either alone decides where it is large.

    tau_f = c F(omega_a) clip(omega_a / omega_0 + tau / width, -1, 1)

c is the share of the design model's friction that is compensated: too little leaves the motor stuck off its goal, too
much makes it hunt around it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from baselines.gains import Gains, tunable
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arm import COLUMN, plant_of
from beltarm_env.arrays import Floats
from beltarm_env.engine import inlined
from beltarm_env.physics.drive import angles_of, coupling, drive_of
from beltarm_env.physics.state import ArmState
from beltarm_env.task.reference import Reference

RESTING = 1e-6
"""Joint speed below which a reference rests [rad/s]: planned speeds end at zero but for rounding."""


class DryFriction(NamedTuple):
    """Dry friction of an arm's motor."""

    coulomb: float  # tau_c [N m]
    excess: float  # s [-]
    stribeck_speed: float  # omega_s [rad/s]


@inlined
def dry_friction(row: Any) -> DryFriction:
    """Read an arm's dry friction from its constants, shape (len(FIELDS),)."""
    return DryFriction(row[COLUMN.coulomb_friction], row[COLUMN.static_friction_excess], row[COLUMN.stribeck_speed])


@inlined
def friction_level(friction: DryFriction, motor_speed: float) -> float:
    """Return F [N m], dry friction at a motor speed [rad/s]; at rest, what it takes to break away."""
    ratio = motor_speed / friction.stribeck_speed
    return friction.coulomb * (1 + friction.excess / (1 + ratio * ratio))


class Compensation(NamedTuple):
    """What a servo compensates of dry friction."""

    friction: DryFriction  # of the design model
    share: float  # c [-]
    rest_width: float  # [N m]  push compensated in full while at rest


@inlined
def compensated(wanted: Reference, push: float, gear: float, of: Compensation) -> tuple[float, float]:
    """Return tau_f [N m] along a reference motion under the feedback's push [N m], and the direction taken for it.

    The reference rests where its mean speed until the next sample is zero.
    """
    speed = wanted.speed + 0.5 * CONTROL_PERIOD * wanted.acceleration
    direction = min(max(push / of.rest_width, -1.0), 1.0) if abs(speed) < RESTING else np.sign(speed)
    return of.share * friction_level(of.friction, gear * wanted.speed) * direction, direction


@dataclass(frozen=True)
class FrictionGains(Gains):
    """Gains of the friction compensation; base of the gains of servo controllers."""

    friction: float = tunable(0.95, 0.0, 2.0)  # c  [-]  share of the design model's friction
    rest_width: float = tunable(0.005, 0.0001, 0.3, log=True)  # [N m]  push compensated in full while at rest

    def compensation(self, params: ArmParams) -> Compensation:
        """What is compensated of the design model's friction."""
        return Compensation(dry_friction(params.row()), self.friction, self.rest_width)


class SmoothCompensation(NamedTuple):
    """What `smooth_friction` compensates."""

    friction: DryFriction  # of the design model
    share: float  # c [-]
    slow: float  # omega_0 [rad/s]
    width: float  # [N m]


@inlined
def smooth_friction(by: SmoothCompensation, motor_speed: float, torque: float) -> float:
    """Return tau_f [N m] at an estimated motor speed [rad/s], given the torque asked of the motor [N m]."""
    direction = min(max(motor_speed / by.slow + torque / by.width, -1.0), 1.0)
    return by.share * friction_level(by.friction, motor_speed) * direction


@inlined
def sliding_torque(row: Any, state: Floats) -> tuple[float, float]:
    """Return dry friction of a motor that slides forward, as it varies over the turn, and torque ripple [N m].

    They are those in the middle of a sample that begins with x, shape (4,), of an arm with a row of constants.
    """
    plant, drive, speed = plant_of(row), drive_of(row), state[1]
    x = ArmState(state[0] + 0.5 * CONTROL_PERIOD * speed, speed, state[2], state[3])
    coupled = coupling(x, angles_of(x, plant, drive), plant, drive)
    return plant.coulomb_friction * coupled.friction, coupled.ripple
