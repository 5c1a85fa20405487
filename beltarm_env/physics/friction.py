"""Dry friction of the motor: its modes, its torque in each, and where they end.

Friction is set-valued. `direction` says which mode the motor is in: it slides backward (-1) or forward (+1), or it
sticks (0). With the pull d, the torque that pulls at the motor at standstill (`models.driving_torque_at`):

    sliding     tau_f = direction tau_c                        until the speed reaches 0
    sticking    tau_f = d, whatever it takes                   until |d| exceeds the breakaway torque tau_c

A real drive breaks away later, has less friction the faster it turns (Stribeck), and friction that varies over the turn
of the motor, v = 1 + r sin(2 theta_a + phi_r):

    sliding     tau_f = direction tau_c v (1 + s / (1 + (omega_a / omega_s)^2))
    breakaway   tau_c v (1 + s)

It may give before it slips (presliding): the motor that sticks hangs on a spring and a damper, and the deflection z
takes part in its motion, dz/dt = omega_a (one Maxwell slip element, Prandtl's model):

    sticking    tau_f = sigma_0 z + sigma_1 omega_a            until sigma_0 |z| exceeds the breakaway torque
    sliding     as above; where the speed reaches 0, z is where it had broken away

The spring never gives more than it stored: sliding leaves it as it was, but for the variation of friction, and
dissipates more than that varies as long as 2 r delta (1 + s)^2 (1 + |d|) < 1, with delta = `presliding_deflection` and
d = `friction_drift`, for the spring's stiffness is that of the friction as the move begins.

Within a mode the arm is smooth.
"""

from __future__ import annotations

from beltarm_env.arm import Plant
from beltarm_env.engine import inlined
from beltarm_env.physics.drive import Angles, Drive, transmission

SLIPS = 1.0
"""Deflection that stands for a motor that slides, in its direction: far more than any that sticks has [rad]."""


@inlined
def friction_torque(
    speed: float, at: Angles, direction: float, factor: float, plant: Plant, drive: Drive | None
) -> float:
    """Return tau_f [N m] in a friction mode; `factor` of a motor that slides is that of `drive.coupling`."""
    if drive is None:
        return direction * plant.coulomb_friction
    sliding = direction * plant.coulomb_friction * factor
    sticking = drive.spring * at.deflection + drive.damper * speed
    return sliding if direction != 0.0 else sticking


@inlined
def free_motor(direction: float, drive: Drive | None) -> float:
    """Return 1 where the motor moves, and 0 where it sticks and does not give."""
    if drive is None:
        return direction * direction
    return 1.0 if drive.spring > 0.0 else direction * direction


@inlined
def breakaway_torque(at: Angles, plant: Plant, drive: Drive | None) -> float:
    """Return the largest torque of friction at which a motor still sticks [N m]."""
    if drive is None:
        return plant.coulomb_friction
    return plant.coulomb_friction * transmission(at, plant, drive).friction * (1 + drive.static_excess)


@inlined
def sliding_direction(speed: float, pull: float, most: float) -> float:
    """Return which way a motor slides (-1, +1), or 0 where it sticks and does not give.

    Args:
        speed: Of the motor [rad/s].
        pull: Torque that pulls at the motor at standstill [N m].
        most: Breakaway torque [N m].
    """
    from_rest = 1.0 if pull > most else (-1.0 if pull < -most else 0.0)
    return 1.0 if speed > 0.0 else (-1.0 if speed < 0.0 else from_rest)


@inlined
def begun_deflection(speed: float, drive: Drive) -> float:
    """Return the deflection of a motor that begins at a speed [rad/s]: none, or that of one that slides."""
    slips = SLIPS if speed > 0.0 else (-SLIPS if speed < 0.0 else 0.0)
    return slips if drive.spring > 0.0 else 0.0


@inlined
def mode_of_giving(deflection: float) -> float:
    """Return the friction mode of a motor that gives before it slips, from its deflection [rad]."""
    return 1.0 if deflection >= SLIPS else (-1.0 if deflection <= -SLIPS else 0.0)
