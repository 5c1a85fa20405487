"""State of one arm, and the belt's torque, which both equations of motion are made of."""

from __future__ import annotations

from typing import NamedTuple

from beltarm_env.arm import Plant
from beltarm_env.engine import inlined


class ArmState(NamedTuple):
    """State of one arm, eq. (6c)."""

    motor_angle: float  # theta_a [rad]
    motor_speed: float  # omega_a [rad/s]
    torsion: float  # theta_s [rad]     belt torsion theta_a / G - phi
    torsion_speed: float  # omega_s [rad/s]


@inlined
def belt_torque(x: ArmState, plant: Plant) -> float:
    """Return tau_b = K_s theta_s + D_s omega_s [N m], the torque of the belt on the arm."""
    return plant.stiffness * x.torsion + plant.damping * x.torsion_speed
