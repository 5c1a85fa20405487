"""The two models of the arm: `lumped`, the paper's two masses, and `full_arm`, the two links' Lagrangian.

A kernel that takes a `model` is compiled anew for each, without a choice in its loops, and for the full arm only if
that is used: numba tells arguments apart by type and prunes `model is LUMPED` as it compiles. The types that a call
tells apart without delay are those of None and True, hence the values.
"""

from __future__ import annotations

from typing import Final, Literal

from beltarm_env.arm import Plant
from beltarm_env.jit import inlined
from beltarm_env.physics import friction, full_arm, lumped
from beltarm_env.physics.state import ArmState

Model = bool | None
LUMPED: Final = None
FULL_ARM: Final = True
ModelName = Literal["lumped", "lagrangian", "mujoco"]
MODELS: dict[str, Model] = {"lumped": LUMPED, "lagrangian": FULL_ARM, "mujoco": FULL_ARM}
"""By the name that users give; "mujoco" is the full arm moved by another engine, with the same equations."""


@inlined
def accelerations(x: ArmState, torque: float, direction: float, plant: Plant, model: Model) -> tuple[float, float]:
    """Return motor and torsional acceleration (domega_a/dt, domega_s/dt) [rad/s^2].

    Args:
        x: State, eq. (6c).
        torque: Motor torque tau_m [N m].
        direction: Friction mode: -1 or +1 while the motor slides that way, 0 while it sticks.
        plant: Coefficients of the arm.
        model: Whose equations of motion.
    """
    if model is LUMPED:
        return lumped.accelerations(x, torque, direction, plant)
    return full_arm.accelerations(x, torque, direction, plant)


@inlined
def inverse_inertia(cos_phi: float, plant: Plant, model: Model) -> tuple[float, float, float]:
    """Return the entries 11, 12 and 22 of the inverse mass matrix for (theta_1, phi) [1/(kg m^2)]."""
    if model is LUMPED:
        return lumped.inverse_inertia(cos_phi, plant)
    return full_arm.inverse_inertia(cos_phi, plant)


@inlined
def driving_torque(x: ArmState, torque: float, plant: Plant, model: Model) -> float:
    """Return the torque that pulls at the motor at standstill [N m], which friction has to hold for it to stick."""
    if model is LUMPED:
        return lumped.driving_torque(x, torque, plant)
    return full_arm.driving_torque(x, torque, plant)


@inlined
def driving_torque_rate(x: ArmState, torsional: float, plant: Plant, model: Model) -> float:
    """Return the time derivative of `driving_torque` [N m/s] at a torsional acceleration [rad/s^2], torque held."""
    if model is LUMPED:
        return lumped.driving_torque_rate(x, torsional, plant)
    return full_arm.driving_torque_rate(x, torsional, plant)


@inlined
def sliding_direction(x: ArmState, torque: float, plant: Plant, model: Model) -> float:
    """Return the friction mode of a state under a torque [N m]: -1 or +1 if the motor slides, 0 if it sticks."""
    return friction.sliding_direction(x.motor_speed, driving_torque(x, torque, plant, model), plant)
