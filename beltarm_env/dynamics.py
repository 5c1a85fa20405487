"""Equations of motion of the lumped two-mass arm, eqs. (5a), (5b) of the paper, as scalar functions.

The state is x = [theta_a, omega_a, theta_s, omega_s] of eq. (6c). With phi = theta_a / G - theta_s, the arm-side angle:

    M_a1 domega_a/dt = tau_m - V_a1 omega_a - tau_f - tau_b / G                 (5a)
    M2(phi) d2phi/dt2 + 1/2 M2'(phi) (dphi/dt)^2 = tau_b                        (5b, completed)
    tau_b = K_s theta_s + D_s omega_s
    M2(phi) = M2(0) + S sin^2(phi)

The term with M2' is missing in the paper; without it the unforced, frictionless arm would not conserve energy. Coulomb
friction tau_f is set-valued: `direction` says which way the motor slides (-1, +1) or that it sticks (0).
"""

from __future__ import annotations

from typing import NamedTuple

from beltarm_env._jit import inlined


class ArmState(NamedTuple):
    """State of one arm, eq. (6c)."""

    motor_angle: float  # theta_a [rad]
    motor_speed: float  # omega_a [rad/s]
    torsion: float  # theta_s [rad]     belt torsion theta_a / G - phi
    torsion_speed: float  # omega_s [rad/s]


class Plant(NamedTuple):
    """Coefficients of the equations of motion of one arm, derived once from `ArmParams`."""

    inverse_gear: float  # 1 / G
    inverse_motor_inertia: float  # 1 / M_a1  [1/(kg m^2)]
    viscous_friction: float  # V_a1      [N m s/rad]
    coulomb_friction: float  # tau_c     [N m]
    inertia: float  # M2(0)     [kg m^2]
    inertia_swing: float  # S         [kg m^2]     the sin^2 term of M2, payload included
    stiffness: float  # K_s       [N m/rad]
    damping: float  # D_s       [N m s/rad]
    gear: float  # G         beside 1 / G: a division in every equation would take longer
    double_link: float  # 2 l       [m]
    hand: float  # l_3       [m]
    torque_limit: float  # [N m]


@inlined
def sin_cos(angle: float) -> tuple[float, float]:
    """Sine and cosine from Taylor series of the half angle: error below 1e-15 for |angle| <= 2 rad, the workspace.

    Written out because a call into the maths library would keep the loop over arms from being vectorised, and because
    its result may differ between the scalar and the vector variant of such a library. Terms are summed in groups
    (Estrin), which do not wait for each other.
    """
    half = 0.5 * angle
    z = half * half
    z2 = z * z
    z4 = z2 * z2
    s0 = (1 - z * (1 / 6)) + z2 * (1 / 120 - z * (1 / 5040))
    s1 = (1 / 362880 - z * (1 / 39916800)) + z2 * (1 / 6227020800 - z * (1 / 1307674368000))
    s2 = 1 / 355687428096000
    c0 = (1 - z * (1 / 2)) + z2 * (1 / 24 - z * (1 / 720))
    c1 = (1 / 40320 - z * (1 / 3628800)) + z2 * (1 / 479001600 - z * (1 / 87178291200))
    c2 = 1 / 20922789888000
    sine = half * (s0 + z4 * (s1 + z4 * s2))
    cosine = c0 + z4 * (c1 + z4 * c2)
    return 2 * sine * cosine, 1 - 2 * sine * sine


@inlined
def belt_torque(x: ArmState, plant: Plant) -> float:
    """tau_b = K_s theta_s + D_s omega_s [N m], the torque the belt exerts on the arm."""
    return plant.stiffness * x.torsion + plant.damping * x.torsion_speed


@inlined
def accelerations(x: ArmState, torque: float, direction: float, plant: Plant) -> tuple[float, float]:
    """Motor and torsional acceleration (domega_a/dt, domega_s/dt) [rad/s^2] from (5a), (5b).

    Args:
        x: State, eq. (6c).
        torque: Motor torque tau_m [N m].
        direction: -1 or +1 while the motor slides that way, 0 while it sticks.
        plant: Coefficients of the arm.
    """
    phi = x.motor_angle * plant.inverse_gear - x.torsion
    phi_dot = x.motor_speed * plant.inverse_gear - x.torsion_speed
    sin_phi, cos_phi = sin_cos(phi)
    m2 = plant.inertia + plant.inertia_swing * sin_phi * sin_phi
    half_m2_slope = plant.inertia_swing * sin_phi * cos_phi
    tau_b = belt_torque(x, plant)
    tau_f = direction * plant.coulomb_friction
    net = torque - plant.viscous_friction * x.motor_speed - tau_f - tau_b * plant.inverse_gear
    motor = direction * direction * plant.inverse_motor_inertia * net
    arm = (tau_b - half_m2_slope * phi_dot * phi_dot) / m2
    return motor, motor * plant.inverse_gear - arm


@inlined
def driving_torque(x: ArmState, torque: float, plant: Plant) -> float:
    """Torque on the motor at standstill, tau_m - tau_b / G [N m]: it sticks while this stays within +-tau_c."""
    return torque - belt_torque(x, plant) * plant.inverse_gear


@inlined
def sliding_direction(x: ArmState, torque: float, plant: Plant) -> float:
    """Which way the motor slides (-1, +1), or 0 while it sticks."""
    drive = driving_torque(x, torque, plant)
    breakaway = 1.0 if drive > plant.coulomb_friction else (-1.0 if drive < -plant.coulomb_friction else 0.0)
    return 1.0 if x.motor_speed > 0.0 else (-1.0 if x.motor_speed < 0.0 else breakaway)
