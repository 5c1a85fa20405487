"""Linear model of the arm from one sample to the next, tabulated over the joint angle."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arm import Plant, plant_of
from beltarm_env.arrays import Floats
from beltarm_env.engine import compiled, inlined
from beltarm_env.physics.linear import write_sampled_models
from beltarm_env.physics.models import LUMPED, Model
from beltarm_env.physics.trigonometry import sine_cosine

ANGLES = np.linspace(0.0, np.pi / 2, 46)
"""Joint angles of the tables [rad], every two degrees; outside, tables are constant."""


class LinearArm(NamedTuple):
    """Linear models x[k+1] = A x[k] + b tau_m + e alpha of an arm at each of `ANGLES`, Coulomb friction left out.

    See `beltarm_env.physics.linear.write_sampled_models`.
    """

    transition: Floats  # A, shape (46, 4, 4)
    by_torque: Floats  # b, shape (46, 4)
    by_acceleration: Floats  # e, shape (46, 4): of a torsional acceleration alpha [rad/s^2], held

    def at(self, k: int) -> LinearArm:
        """The model at one of the angles, without their axis."""
        return LinearArm(*(part[k] for part in self))


def empty_linear_arm() -> LinearArm:
    """Room for the linear models of an arm."""
    size = len(ANGLES)
    return LinearArm(np.empty((size, 4, 4)), np.empty((size, 4)), np.empty((size, 4)))


@compiled
def write_linear_arm(row: Any, model: Model, arm: LinearArm) -> None:
    """Write linear models, the belt with its mean stiffness, of an arm with a row of constants, as `ArmParams`."""
    plant, (a, b, e) = plant_of(row), arm
    write_sampled_models(plant, plant.stiffness, ANGLES, CONTROL_PERIOD, a, b, e, model)


def linear_arm_of(row: Floats, model: Model = LUMPED) -> LinearArm:
    """Linear models of an arm with a row of constants, as the fields of `ArmParams`, by equations of motion."""
    arm = empty_linear_arm()
    write_linear_arm(row, model, arm)
    return arm


def linear_arm(params: ArmParams) -> LinearArm:
    """Linear models of an arm."""
    return linear_arm_of(params.row())


@inlined
def turning_load(angle: float, speed: float, plant: Plant) -> tuple[float, float]:
    """Inertia M2 [kg m^2] and the torque M2' phi'^2 / 2 [N m] that completes (5b), at an angle [rad] and its rate."""
    sine, cosine = sine_cosine(angle)
    return plant.inertia + plant.inertia_swing * sine * sine, plant.inertia_swing * sine * cosine * speed * speed


@inlined
def place(angle: float) -> tuple[int, float]:
    """Row of a table over `ANGLES` at or below an angle [rad], and the weight of the next one at it."""
    position = min(max(0.0, angle / ANGLES[1]), len(ANGLES) - 1.0)  # 0 of an angle that is not a number
    row = min(int(position), len(ANGLES) - 2)
    return row, position - row


@inlined
def between(low: float, high: float, weight: float) -> float:
    """Linear interpolation between two entries of a table, `weight` being that of the second."""
    return low * (1.0 - weight) + high * weight


def at_angle(table: Floats, angle: Floats) -> Floats:
    """Linear interpolation of one arm's table over `ANGLES` at joint angles [rad] of shape (n,): shape (n, ...)."""
    return _interpolated(table.reshape(len(table), -1), angle).reshape(len(angle), *table.shape[1:])


@compiled
def _interpolated(table: Floats, angle: Floats) -> Floats:
    result = np.empty((len(angle), table.shape[1]))
    for n in range(len(angle)):
        row, weight = place(angle[n])
        for k in range(table.shape[1]):
            result[n, k] = between(table[row, k], table[row + 1, k], weight)
    return result
