"""State and coefficients of one arm, and what both equations of motion are made of."""

from __future__ import annotations

from typing import NamedTuple

from beltarm_env.jit import inlined


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
    link_inertia: float  # m_2 l^2   [kg m^2]     of link 2; only the full arm's equations have it
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
