"""The arm's motion under either of its models, and the set-valued Coulomb friction of its motor.

`lumped` is the paper's two-mass arm, `lagrangian` the full one. Both give accelerations for a friction mode:
`direction` says which way the motor slides (-1, +1) or that it sticks (0). At standstill it sticks while the torque
that drives it stays within +-tau_c.
"""

from __future__ import annotations

from typing import Final

from beltarm_env.jit import inlined
from beltarm_env.physics import full_arm as lagrangian
from beltarm_env.physics import lumped
from beltarm_env.physics.plant import ArmState, Plant

Model = None | bool
LUMPED: Final = None
LAGRANGIAN: Final = True
"""The models are told apart by type: numba compiles kernels of their own for each, without a choice in their loops, and
those of the full arm only if it is used."""
ELSEWHERE: Final = False
"""The full arm, moved by another physics engine; what is asked of its equations is answered by LAGRANGIAN's."""
MODELS: dict[str, Model] = {"lumped": LUMPED, "lagrangian": LAGRANGIAN, "mujoco": ELSEWHERE}


@inlined
def accelerations(x: ArmState, torque: float, direction: float, plant: Plant, model: Model) -> tuple[float, float]:
    """Motor and torsional acceleration (domega_a/dt, domega_s/dt) [rad/s^2].

    Args:
        x: State, eq. (6c).
        torque: Motor torque tau_m [N m].
        direction: -1 or +1 while the motor slides that way, 0 while it sticks.
        plant: Coefficients of the arm.
        model: Whose equations of motion.
    """
    if model is None:
        return lumped.accelerations(x, torque, direction, plant)
    return lagrangian.accelerations(x, torque, direction, plant)


@inlined
def inverse_inertia(cos_phi: float, plant: Plant, model: Model) -> tuple[float, float, float]:
    """The entries 11, 12 and 22 of the inverse mass matrix for (theta_1, phi) [1/(kg m^2)]."""
    if model is None:
        return lumped.inverse_inertia(cos_phi, plant)
    return lagrangian.inverse_inertia(cos_phi, plant)


@inlined
def driving_torque(x: ArmState, torque: float, plant: Plant, model: Model) -> float:
    """Torque on the motor at standstill [N m]: it sticks while this stays within +-tau_c."""
    if model is None:
        return lumped.driving_torque(x, torque, plant)
    return lagrangian.driving_torque(x, torque, plant)


@inlined
def driving_torque_rate(x: ArmState, torsional: float, plant: Plant, model: Model) -> float:
    """Time derivative of `driving_torque` [N m/s] at a torsional acceleration [rad/s^2], motor torque held."""
    if model is None:
        return lumped.driving_torque_rate(x, torsional, plant)
    return lagrangian.driving_torque_rate(x, torsional, plant)


@inlined
def sliding_direction(x: ArmState, torque: float, plant: Plant, model: Model) -> float:
    """Which way the motor slides (-1, +1), or 0 while it sticks."""
    drive = driving_torque(x, torque, plant, model)
    breakaway = 1.0 if drive > plant.coulomb_friction else (-1.0 if drive < -plant.coulomb_friction else 0.0)
    return 1.0 if x.motor_speed > 0.0 else (-1.0 if x.motor_speed < 0.0 else breakaway)
