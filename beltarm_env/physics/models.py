"""The two models of the arm: `lumped`, the paper's two masses, and `full_arm`, the two links' Lagrangian.

A kernel that takes a `model` is translated anew for each, without a choice in its loops, and for the full arm only if
that is used. Types of a call tell None and True apart, hence the values: `model is LUMPED` is known in translation.
"""

from __future__ import annotations

from typing import Final, Literal, NamedTuple

from beltarm_env.arm import Plant
from beltarm_env.engine import inlined
from beltarm_env.physics import friction, full_arm, lumped
from beltarm_env.physics.drive import Angles, Drive, angles_of
from beltarm_env.physics.state import ArmState

Model = bool | None
LUMPED: Final = None
FULL_ARM: Final = True
ModelName = Literal["lumped", "lagrangian", "mujoco"]
MODELS: dict[str, Model] = {"lumped": LUMPED, "lagrangian": FULL_ARM, "mujoco": FULL_ARM}
"""By the name that users give; "mujoco" is the full arm moved by another engine, with the same equations."""
OWN_MODELS = "lumped", "lagrangian"
"""Names of those that kernels move."""


def model_of(name: object, names: tuple[str, ...] = tuple(MODELS)) -> Model:
    """Return the model of a name, or raise ValueError if it is none of `names`."""
    if not isinstance(name, str) or name not in names:
        raise ValueError(f"model must be one of {', '.join(map(repr, names))}, got {name!r}")
    return MODELS[name]


class Arm(NamedTuple):
    """An arm that moves: its coefficients, and whose equations of motion."""

    plant: Plant
    drive: Drive | None  # of its real drive; None for an ideal one
    model: Model


@inlined
def accelerations(x: ArmState, torque: float, direction: float, arm: Arm) -> tuple[float, float]:
    """Return motor and torsional acceleration (domega_a/dt, domega_s/dt) [rad/s^2].

    Args:
        x: State, eq. (6c).
        torque: Motor torque tau_m [N m].
        direction: Friction mode: -1 or +1 while the motor slides that way, 0 while it sticks.
        arm: What moves.
    """
    motor, torsional, _ = accelerations_at(x, angles_of(x, arm.plant, arm.drive), torque, direction, arm)
    return motor, torsional


@inlined
def accelerations_at(x: ArmState, at: Angles, torque: float, direction: float, arm: Arm) -> tuple[float, float, float]:
    """Return `accelerations` of a state whose sines and cosines are known, and that of a motor that nothing holds."""
    equations = lumped if arm.model is LUMPED else full_arm
    return equations.accelerations(x, at, torque, direction, arm.plant, arm.drive)


@inlined
def inverse_inertia(cos_phi: float, plant: Plant, model: Model) -> tuple[float, float, float]:
    """Return the entries 11, 12 and 22 of the inverse mass matrix for (theta_1, phi) [1/(kg m^2)]."""
    if model is LUMPED:
        return lumped.inverse_inertia(cos_phi, plant)
    return full_arm.inverse_inertia(cos_phi, plant)


@inlined
def torsional_mobility(joint: float, mutual: float, arm: float) -> float:
    """Return the torsional acceleration per belt torque, W11 - 2 W12 + W22 [1/(kg m^2)], while the motor slides."""
    return joint - 2 * mutual + arm


@inlined
def acceleration_per_torque(at: Angles, arm: Arm) -> float:
    """Return by how much a motor that slides accelerates per torque [rad/s^2 per N m], as `accelerations_at` has it.

    Exactly so: with another number a motor that breaks away would at once be found to stop again.
    """
    if arm.model is LUMPED:
        return arm.plant.inverse_motor_inertia
    return full_arm.acceleration_per_torque(at, arm.plant, arm.drive)


@inlined
def driving_torque_at(x: ArmState, at: Angles, torque: float, arm: Arm) -> float:
    """Return the torque that pulls at the motor at standstill [N m], which friction has to hold for it to stick."""
    equations = lumped if arm.model is LUMPED else full_arm
    return equations.driving_torque(x, at, torque, arm.plant, arm.drive)


@inlined
def driving_torque_rate_at(x: ArmState, at: Angles, torsional: float, arm: Arm) -> float:
    """Return the time derivative of `driving_torque_at` [N m/s] at a torsional acceleration [rad/s^2], torque held."""
    equations = lumped if arm.model is LUMPED else full_arm
    return equations.driving_torque_rate(x, at, torsional, arm.plant, arm.drive)


@inlined
def sliding_direction(x: ArmState, torque: float, arm: Arm) -> float:
    """Return the friction mode of a state under a torque [N m]: -1 or +1 if the motor slides, 0 if it sticks."""
    return sliding_direction_at(x, angles_of(x, arm.plant, arm.drive), torque, arm)


@inlined
def sliding_direction_at(x: ArmState, at: Angles, torque: float, arm: Arm) -> float:
    """Return `sliding_direction` of a state whose sines and cosines are known."""
    pull = driving_torque_at(x, at, torque, arm)
    return friction.sliding_direction(x.motor_speed, pull, friction.breakaway_torque(at, arm.plant, arm.drive))
