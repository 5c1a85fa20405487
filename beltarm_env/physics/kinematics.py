"""Kinematics of the arm's end: the exact planar kinematics of the two-link arm with its hand.

Link 2 turns by twice the joint angle against link 1 (both of length l), so an unloaded belt moves the tip along the x
axis; belt torsion theta_s turns the whole line from joint 1 to the tip:

    p = (2 l cos(phi) + l_3) (cos(theta_s), sin(theta_s)),     phi = theta_a / G - theta_s

Behind a harmonic drive with a kinematic error, the belt's torsion theta_1 - phi takes the place of theta_s.

The paper's end position is r = 2 l + l_3 - x.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltarm_env.arm import Plant
from beltarm_env.engine import compiled, inlined
from beltarm_env.physics.drive import Drive, belt_motion
from beltarm_env.physics.state import ArmState
from beltarm_env.physics.trigonometry import sin_cos

Floats = NDArray[np.float64]


class TipMotion(NamedTuple):
    """Position [m] and velocity [m/s] of the arm's end; x along the nominal line of motion, y across it."""

    x: float
    y: float
    x_speed: float
    y_speed: float


@inlined
def tip_motion(state: ArmState, plant: Plant, drive: Drive | None = None) -> TipMotion:
    """Return position and velocity of the tip for a state of the arm."""
    phi = state.motor_angle * plant.inverse_gear - state.torsion
    phi_dot = state.motor_speed * plant.inverse_gear - state.torsion_speed
    sin_phi, cos_phi = sin_cos(phi)
    torsion, torsion_speed = belt_motion(state, plant, drive)
    sin_torsion, cos_torsion = sin_cos(torsion)
    reach = plant.double_link * cos_phi + plant.hand
    reach_speed = -plant.double_link * sin_phi * phi_dot
    turning = reach * torsion_speed
    return TipMotion(
        reach * cos_torsion,
        reach * sin_torsion,
        reach_speed * cos_torsion - turning * sin_torsion,
        reach_speed * sin_torsion + turning * cos_torsion,
    )


@inlined
def reference_tip(angle: float, speed: float, plant: Plant) -> tuple[float, float]:
    """Return the tip of a rigid arm on the x axis, position [m] and speed [m/s], at joint angle and speed."""
    sine, cosine = sin_cos(angle)
    return plant.double_link * cosine + plant.hand, -plant.double_link * sine * speed


@inlined
def tip_error(tip: TipMotion, angle: float, speed: float, plant: Plant) -> TipMotion:
    """Tip minus reference tip: position [m] and velocity [m/s], for a reference angle and speed (rad, rad/s)."""
    x, x_speed = reference_tip(angle, speed, plant)
    return TipMotion(tip.x - x, tip.y, tip.x_speed - x_speed, tip.y_speed)


@compiled
def tip_errors(states: Floats, references: Floats, plant: Plant, drive: Drive | None) -> Floats:
    """Errors of the tip as `TipMotion` has them, shape (n, 4), for n states of arms that are alike.

    Args:
        states: x = [theta_a, omega_a, theta_s, omega_s] (rad, rad/s), shape (n, 4).
        references: Joint angle [rad] and speed [rad/s] of the reference, shape (n, 2).
        plant: Coefficients of the arm.
        drive: Coefficients of its real drive; None if it is ideal.
    """
    errors = np.empty((len(states), 4))
    for i in range(len(states)):
        x = ArmState(states[i, 0], states[i, 1], states[i, 2], states[i, 3])
        error = tip_error(tip_motion(x, plant, drive), references[i, 0], references[i, 1], plant)
        errors[i, 0], errors[i, 1], errors[i, 2], errors[i, 3] = error
    return errors


WORKSPACE_MARGIN = 0.25
"""How far joint and arm angle may leave 0 to 90 degrees before the episode ends [rad]."""
LOWEST = -WORKSPACE_MARGIN
HIGHEST = 0.5 * 3.141592653589793 + WORKSPACE_MARGIN


_LARGEST = 1e9  # of any state; only an integration that runs away gets there


@inlined
def contained(state: ArmState, plant: Plant) -> ArmState:
    """Replace a state that ran away, or is not a number, by a resting one outside the workspace.

    It takes an arm far from any real one to get there, such as one whose inertia swings by a factor of 10 000; its
    episode then ends, and what is observed of it stays finite.
    """
    largest = max(abs(state.motor_angle), abs(state.motor_speed), abs(state.torsion), abs(state.torsion_speed))
    number = state.motor_angle + state.motor_speed + state.torsion + state.torsion_speed
    sane = (largest < _LARGEST) & (number == number)
    return ArmState(
        state.motor_angle if sane else (HIGHEST + WORKSPACE_MARGIN) * plant.gear,
        state.motor_speed if sane else 0.0,
        state.torsion if sane else 0.0,
        state.torsion_speed if sane else 0.0,
    )


@inlined
def outside_workspace(state: ArmState, plant: Plant) -> bool:
    """Tell whether theta_a / G or the arm angle phi lies outside the workspace (or is not a number)."""
    joint = state.motor_angle * plant.inverse_gear
    arm = joint - state.torsion
    return not ((joint >= LOWEST) & (joint <= HIGHEST) & (arm >= LOWEST) & (arm <= HIGHEST))
