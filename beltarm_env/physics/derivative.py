"""The arm's equations of motion, for tools that integrate by themselves: state and torque in, slope out."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from beltarm_env.arm import ArmParams, Plant
from beltarm_env.arrays import Floats
from beltarm_env.engine import compiled
from beltarm_env.physics.drive import SMALLEST_DEFLECTION, Drive, real_drive_of
from beltarm_env.physics.models import Arm, accelerations, model_of, sliding_direction
from beltarm_env.physics.state import ArmState


@compiled
def _derivative(x: Floats, torque: float, arm: Arm) -> Floats:
    state = ArmState(x[0], x[1], x[2], x[3])
    motor, torsional = accelerations(state, torque, sliding_direction(state, torque, arm), arm)
    slope = np.empty(4)
    slope[0], slope[1], slope[2], slope[3] = state.motor_speed, motor, state.torsion_speed, torsional
    return slope


@lru_cache(maxsize=64)
def _coefficients(params: ArmParams) -> tuple[Plant, Drive | None]:
    return params.plant(), real_drive_of(params.row())


def state_derivative(x: ArrayLike, torque: float, params: ArmParams, model: str = "lumped") -> Floats:
    """Compute dx/dt of an arm, eqs. (5a) and (5b), by the equations that the environment integrates.

    Friction opposes the motor's motion. A motor at rest stays there until the torque that pulls at it exceeds the
    breakaway torque. Solvers of smooth equations do not find a motor that stops; the environment locates that instant.

    Of a real drive, the torque is that of the motor: current loop and latency stand before it, and friction
    is as at the start of an episode. A motor that gives before it slips has a deflection beside x, see `ArmSimulation`.

    Args:
        x: State [theta_a, omega_a, theta_s, omega_s] (rad, rad/s), shape (4,).
        torque: Of the motor tau_m [N m]; not cut at the torque limit.
        params: The arm.
        model: "lumped", or "lagrangian" (of which "mujoco" is another implementation).

    Returns:
        [omega_a, domega_a/dt, omega_s, domega_s/dt] (rad/s, rad/s^2), shape (4,).

    Raises:
        ValueError: If x has another shape, the model is unknown, or the motor gives before it slips.
    """
    equations = model_of(model)
    if params.presliding_deflection >= SMALLEST_DEFLECTION:
        given = f"presliding_deflection={params.presliding_deflection:g}"
        raise ValueError(
            f"x does not tell the slope with {given}: set it to 0, or take beltarm_env.simulation.ArmSimulation"
        )
    state = np.ascontiguousarray(x, np.float64)
    if state.shape != (4,):
        raise ValueError(f"x must have shape (4,), got {state.shape}")
    return _derivative(state, float(torque), Arm(*_coefficients(params), equations))
