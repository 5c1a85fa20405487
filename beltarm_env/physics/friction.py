"""Coulomb friction of the motor: the law, breaking away, and how far the motor is inside its friction mode.

Friction is set-valued. `direction` says which mode the motor is in: it slides backward (-1) or forward (+1), or it
sticks (0). With the drive d, the torque that pulls at the motor at standstill (`models.driving_torque`):

    sliding     tau_f = direction tau_c                        until the speed reaches 0
    sticking    tau_f = d, whatever it takes                   until |d| exceeds the breakaway torque tau_c

Within a mode the arm is smooth. A *margin* is positive inside the mode and negative once it has been left: the
integrator steps over a sample in one mode, and where the margin at its end is negative, locates the instant at which it
vanished.
"""

from __future__ import annotations

from beltarm_env.arm import Plant
from beltarm_env.jit import inlined


@inlined
def friction_torque(direction: float, plant: Plant) -> float:
    """Return tau_f on a motor that slides in a direction, -1 or +1 [N m]."""
    return direction * plant.coulomb_friction


@inlined
def breakaway_torque(plant: Plant) -> float:
    """Return the largest drive at which a motor at rest still sticks [N m]."""
    return plant.coulomb_friction


@inlined
def sliding_direction(speed: float, drive: float, plant: Plant) -> float:
    """Return which way the motor slides (-1, +1), or 0 where it sticks.

    Args:
        speed: Of the motor [rad/s].
        drive: Torque that pulls at the motor at standstill [N m].
        plant: Coefficients of the arm.
    """
    most = breakaway_torque(plant)
    from_rest = 1.0 if drive > most else (-1.0 if drive < -most else 0.0)
    return 1.0 if speed > 0.0 else (-1.0 if speed < 0.0 else from_rest)


@inlined
def mode_margin(speed: float, drive: float, direction: float, plant: Plant) -> float:
    """Return how far the motor is inside its mode: speed in the direction of sliding, or drive left to breakaway."""
    sticking = breakaway_torque(plant) - abs(drive)
    return direction * speed if direction != 0.0 else sticking


@inlined
def exit_margin(speed: float, drive: float, direction: float, exit_side: float, plant: Plant) -> float:
    """Return the margin towards one side, which is smooth: a motor that sticks breaks away to `exit_side`, -1 or +1."""
    sticking = breakaway_torque(plant) - exit_side * drive
    return direction * speed if direction != 0.0 else sticking


@inlined
def exit_margin_rate(acceleration: float, drive_rate: float, direction: float, exit_side: float) -> float:
    """Return the time derivative of `exit_margin`, from those of the speed [rad/s^2] and of the drive [N m/s]."""
    sticking = -exit_side * drive_rate
    return direction * acceleration if direction != 0.0 else sticking
