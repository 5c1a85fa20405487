"""Dry friction of the motor: the law, breaking away, and how far the motor is inside its friction mode.

Friction is set-valued. `direction` says which mode the motor is in: it slides backward (-1) or forward (+1), or it
sticks (0). With the pull d, the torque that pulls at the motor at standstill (`models.driving_torque`):

    sliding     tau_f = direction tau_c                        until the speed reaches 0
    sticking    tau_f = d, whatever it takes                   until |d| exceeds the breakaway torque tau_c

The drive as it is built breaks away later, has less friction the faster it turns (Stribeck), and friction that varies
over the turn of the motor, v = 1 + r sin(2 theta_a + phi_r):

    sliding     tau_f = direction tau_c v (1 + s / (1 + (omega_a / omega_s)^2))
    breakaway   tau_c v (1 + s)

Within a mode the arm is smooth. A *margin* is positive inside the mode and negative once it has been left: the
integrator steps over a sample in one mode, and where the margin at its end is negative, locates the instant at which it
vanished.
"""

from __future__ import annotations

from beltarm_env.arm import Plant
from beltarm_env.engine import inlined
from beltarm_env.physics.drive import Angles, Drive, transmission


@inlined
def friction_torque(direction: float, factor: float, plant: Plant, drive: Drive | None) -> float:
    """Return tau_f on a motor that slides in a direction, -1 or +1 [N m]; `factor` is that of `drive.coupling`."""
    if drive is None:
        return direction * plant.coulomb_friction
    return direction * plant.coulomb_friction * factor


@inlined
def breakaway_torque(at: Angles, plant: Plant, drive: Drive | None) -> float:
    """Return the largest pull at which a motor at rest still sticks [N m]."""
    if drive is None:
        return plant.coulomb_friction
    return plant.coulomb_friction * transmission(at, plant, drive).friction * (1 + drive.static_excess)


@inlined
def sliding_direction(speed: float, pull: float, most: float) -> float:
    """Return which way the motor slides (-1, +1), or 0 where it sticks.

    Args:
        speed: Of the motor [rad/s].
        pull: Torque that pulls at the motor at standstill [N m].
        most: Breakaway torque [N m].
    """
    from_rest = 1.0 if pull > most else (-1.0 if pull < -most else 0.0)
    return 1.0 if speed > 0.0 else (-1.0 if speed < 0.0 else from_rest)


@inlined
def mode_margin(speed: float, pull: float, direction: float, most: float) -> float:
    """Return how far the motor is inside its mode: speed in the direction of sliding, or pull left to breakaway."""
    sticking = most - abs(pull)
    return direction * speed if direction != 0.0 else sticking


@inlined
def exit_margin(speed: float, pull: float, direction: float, exit_side: float, most: float) -> float:
    """Return the margin towards one side, which is smooth: a motor that sticks breaks away to `exit_side`, -1 or +1."""
    sticking = most - exit_side * pull
    return direction * speed if direction != 0.0 else sticking


@inlined
def exit_margin_rate(acceleration: float, pull_rate: float, direction: float, exit_side: float) -> float:
    """Return the time derivative of `exit_margin`, from those of the speed [rad/s^2] and of the pull [N m/s]."""
    sticking = -exit_side * pull_rate
    return direction * acceleration if direction != 0.0 else sticking
