"""Equations of motion of the lumped two-mass arm, eqs. (5a), (5b) of the paper, as scalar functions.

The state is x = [theta_a, omega_a, theta_s, omega_s] of eq. (6c). With phi = theta_a / G - theta_s, the arm-side angle:

    M_a1 domega_a/dt = tau_m - V_a1 omega_a - tau_f - tau_b / G                 (5a)
    M2(phi) d2phi/dt2 + 1/2 M2'(phi) (dphi/dt)^2 = tau_b                        (5b, completed)
    tau_b = K_s theta_s + D_s omega_s
    M2(phi) = M2(0) + S sin^2(phi)

The term with M2' is missing in the paper; without it the unforced, frictionless arm would not conserve energy. Coulomb
friction tau_f is that of `friction`. Behind a real drive (`drive`), tau_m has ripple on it, and 1 / G before
tau_b becomes g.
"""

from __future__ import annotations

from beltarm_env.arm import Plant
from beltarm_env.engine import inlined
from beltarm_env.physics.drive import Angles, Drive, belt_torque_rate, coupling
from beltarm_env.physics.friction import free_motor, friction_torque
from beltarm_env.physics.state import ArmState


@inlined
def carried_inertia(cos_phi: float, plant: Plant) -> float:
    """Return M2(phi) [kg m^2]."""
    return plant.inertia + plant.inertia_swing * (1 - cos_phi * cos_phi)


@inlined
def inverse_inertia(cos_phi: float, plant: Plant) -> tuple[float, float, float]:
    """Return the entries 11, 12 and 22 of the inverse mass matrix for (theta_1, phi) [1/(kg m^2)]."""
    motor = plant.inverse_gear * plant.inverse_gear * plant.inverse_motor_inertia
    return motor, 0.0, 1 / carried_inertia(cos_phi, plant)


@inlined
def accelerations(
    x: ArmState, at: Angles, torque: float, direction: float, plant: Plant, drive: Drive | None
) -> tuple[float, float, float]:
    """Return the accelerations of motor, torsion, and a motor that nothing holds [rad/s^2]; see `models`."""
    phi_dot = x.motor_speed * plant.inverse_gear - x.torsion_speed
    m2 = plant.inertia + plant.inertia_swing * at.sin_phi * at.sin_phi
    half_m2_slope = plant.inertia_swing * at.sin_phi * at.cos_phi
    on = coupling(x, at, plant, drive, m2)
    tau_f = friction_torque(x.motor_speed, at, direction, on.friction, plant, drive)
    tau_m = torque if drive is None else torque + on.ripple
    net = tau_m - plant.viscous_friction * x.motor_speed - tau_f - on.belt * on.ratio
    loose = plant.inverse_motor_inertia * net
    motor = free_motor(direction, drive) * loose
    on_arm = on.belt - half_m2_slope * phi_dot * phi_dot
    arm = on_arm / m2 if drive is None else on_arm * on.inverse
    return motor, motor * plant.inverse_gear - arm, loose


@inlined
def driving_torque(x: ArmState, at: Angles, torque: float, plant: Plant, drive: Drive | None) -> float:
    """Return the torque that pulls at the motor at standstill, tau_m - tau_b / G [N m]."""
    on = coupling(x, at, plant, drive)
    tau_m = torque if drive is None else torque + on.ripple
    return tau_m - on.belt * on.ratio


@inlined
def driving_torque_rate(x: ArmState, at: Angles, torsional: float, plant: Plant, drive: Drive | None) -> float:
    """Return the time derivative of `driving_torque` [N m/s] at a torsional acceleration [rad/s^2], torque held."""
    return -belt_torque_rate(x, at, torsional, plant, drive) * coupling(x, at, plant, drive).ratio
