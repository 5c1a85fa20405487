"""Equations of motion of the full two-link arm, from its Lagrangian, as scalar functions.

Link 1 points along theta_1 = theta_a / G and link 2 along theta_1 - 2 phi, both of length l; the payload m_p is a point
at joint 3; the belt's torsion is theta_s = theta_1 - phi. With C = cos^2(phi) the kinetic energy is

    T = 1/2 (M11 theta_1'^2 + 2 M12 theta_1' phi' + M22 phi'^2)
    M11 = G^2 M_a1 + M2(0) + S C,     M12 = m_2 l^2 - 2 M2(0) - S C,     M22 = 4 M2(0) + S - 2 m_2 l^2

and Lagrange's equations, with S the swing of the inertia, payload included, and tau_b = K_s theta_s + D_s omega_s:

    M11 theta_1'' + M12 phi'' - S sin(2 phi) phi' omega_s = G (tau_m - V_a1 omega_a - tau_f) - tau_b
    M12 theta_1'' + M22 phi'' + 1/2 S sin(2 phi) theta_1'^2 = tau_b

A rigid belt (phi = theta_1) gives M11 + 2 M12 + M22 = G^2 M_a1 + M2(0) + S sin^2(phi): the inertia of the lumped arm,
at every angle. What the lumped arm does not have is M12, and an M22 that does not depend on the angle: behind a motor
at rest, torsion turns link 2 about joint 2, by twice as much, and not the whole arm about joint 1.

Behind a real drive, theta_1 = theta_a / G + eps(theta_a), so that theta_1' = g omega_a and theta_1'' =
g omega_a' + g' omega_a^2, with g = 1 / G + eps'. Then 1 / g takes the place of G, the motor's inertia M_a1 / g^2 meets
theta_1'' - g' omega_a^2, and theta_1 - phi the place of theta_s.
"""

from __future__ import annotations

from beltarm_env.arm import Plant
from beltarm_env.engine import inlined
from beltarm_env.physics.drive import Angles, Drive, belt_torque_rate, coupling, transmission
from beltarm_env.physics.friction import free_motor, friction_torque
from beltarm_env.physics.state import ArmState


@inlined
def _inertia(cos_phi: float, gear: float, plant: Plant) -> tuple[float, float, float]:
    """Return M11, M12, M22 [kg m^2] at a gear ratio omega_a / theta_1'."""
    swing = plant.inertia_swing * cos_phi * cos_phi
    return (
        gear * gear / plant.inverse_motor_inertia + plant.inertia + swing,
        plant.link_inertia - 2 * plant.inertia - swing,
        4 * plant.inertia + plant.inertia_swing - 2 * plant.link_inertia,
    )


@inlined
def inverse_inertia(cos_phi: float, plant: Plant) -> tuple[float, float, float]:
    """Return the entries 11, 12 and 22 of the inverse mass matrix for (theta_1, phi) [1/(kg m^2)]."""
    m11, m12, m22 = _inertia(cos_phi, plant.gear, plant)
    determinant = m11 * m22 - m12 * m12
    return m22 / determinant, -m12 / determinant, m11 / determinant


@inlined
def acceleration_per_torque(at: Angles, plant: Plant, drive: Drive | None) -> float:
    """Return domega_a'/dtau_m of a motor that moves [rad/s^2 per N m]."""
    gear = plant.gear if drive is None else 1 / transmission(at, plant, drive).ratio
    m11, m12, m22 = _inertia(at.cos_phi, gear, plant)
    return gear * gear * m22 / (m11 * m22 - m12 * m12)


@inlined
def accelerations(
    x: ArmState, at: Angles, torque: float, direction: float, plant: Plant, drive: Drive | None
) -> tuple[float, float, float]:
    """Return the accelerations of motor, torsion, and a motor that nothing holds [rad/s^2]; see `models`."""
    on = coupling(x, at, plant, drive)
    gear = plant.gear if drive is None else 1 / on.ratio
    joint_speed = x.motor_speed * on.ratio
    phi_dot = x.motor_speed * plant.inverse_gear - x.torsion_speed
    swing_rate = 2 * plant.inertia_swing * at.sin_phi * at.cos_phi
    m11, m12, m22 = _inertia(at.cos_phi, gear, plant)
    free = free_motor(direction, drive)
    tau_f = friction_torque(x.motor_speed, at, direction, on.friction, plant, drive)
    tau_m = torque if drive is None else torque + on.ripple
    at_motor = tau_m - plant.viscous_friction * x.motor_speed - tau_f
    on_joint = gear * at_motor - on.belt + swing_rate * phi_dot * on.torsion_speed
    on_arm = on.belt - 0.5 * swing_rate * joint_speed * joint_speed
    if drive is None:
        loose = (m22 * on_joint - m12 * on_arm) / (m11 * m22 - m12 * m12)
        joint = free * loose
        return gear * joint, joint - (on_arm - m12 * joint) / m22, gear * loose
    curved = on.curvature * x.motor_speed * x.motor_speed
    on_joint += gear * gear / plant.inverse_motor_inertia * curved
    loose = (m22 * on_joint - m12 * on_arm) / (m11 * m22 - m12 * m12)
    joint = free * loose
    motor = free * gear * (joint - curved)
    return motor, motor * plant.inverse_gear - (on_arm - m12 * joint) / m22, gear * (loose - curved)


@inlined
def driving_torque(x: ArmState, at: Angles, torque: float, plant: Plant, drive: Drive | None) -> float:
    """Return the torque that pulls at the motor at standstill [N m], which friction has to hold for it to stick.

    tau_m - (tau_b (1 + M12 / M22) + S sin(2 phi) phi'^2) / G, since the belt alone moves link 2: phi'' = tau_b / M22.
    """
    _, m12, m22 = _inertia(at.cos_phi, plant.gear, plant)
    centrifugal = 2 * plant.inertia_swing * at.sin_phi * at.cos_phi * x.torsion_speed * x.torsion_speed
    on = coupling(x, at, plant, drive)
    tau_m = torque if drive is None else torque + on.ripple
    return tau_m - (on.belt * (1 + m12 / m22) + centrifugal) * on.ratio


@inlined
def driving_torque_rate(x: ArmState, at: Angles, torsional: float, plant: Plant, drive: Drive | None) -> float:
    """Return the time derivative of `driving_torque` [N m/s] at a torsional acceleration [rad/s^2], torque held."""
    phi_dot, phi_acceleration = -x.torsion_speed, -torsional
    _, m12, m22 = _inertia(at.cos_phi, plant.gear, plant)
    swing_rate = 2 * plant.inertia_swing * at.sin_phi * at.cos_phi  # dM12 / dphi
    swing_curvature = 2 * plant.inertia_swing * (2 * at.cos_phi * at.cos_phi - 1)
    on = coupling(x, at, plant, drive)
    belt_rate = belt_torque_rate(x, at, torsional, plant, drive)
    by_belt = belt_rate * (1 + m12 / m22) + on.belt * swing_rate * phi_dot / m22
    by_turning = phi_dot * (swing_curvature * phi_dot * phi_dot + 2 * swing_rate * phi_acceleration)
    return -(by_belt + by_turning) * on.ratio
