"""The real drive: what a motor, its amplifier and a harmonic drive do beyond the paper's equations.

    T_i dtau/dt = (1 + k) u - tau                                 current loop and torque constant; u acts T_c late
    tau_r = c sin(n theta_a + phi_c)                              torque ripple
    theta_1 = theta_a / G + e sin(2 theta_a + phi_e)              kinematic error: twice per turn of the wave generator
    tau_b = K_s (1 - b + 2 b th^2 / (th^2 + theta_0^2)) th + D_s dth/dt,   th = theta_1 - phi        stiffening belt

and friction as `friction` has it. The motor feels the belt through g = dtheta_1 / dtheta_a, which is not 1 / G: with
any other factor the kinematic error would create energy. Sources and magnitudes are in docs/science/physics.md.

`Drive` holds the coefficients. An arm whose drive is ideal has None in its place, and kernels compiled for None have
nothing of all this in their loops.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from beltarm_env.arm import COLUMN, DRIVE_EFFECTS, FIELDS, Plant
from beltarm_env.arrays import Floats
from beltarm_env.engine import compiled, inlined
from beltarm_env.physics.state import ArmState, belt_torque
from beltarm_env.physics.trigonometry import short_sin_cos, sin_cos, sine_cosine, turn_sin_cos, wrapped

DRIVE_COLUMNS = tuple(FIELDS.index(name) for name in DRIVE_EFFECTS)
"""Columns of a table of arms that are all zero where the drive is ideal."""


PRESLIDING_DAMPING = 0.5
"""Damping ratio of a motor on the spring of its presliding; an assumption."""
SMALLEST_DEFLECTION = 1e-6
"""Deflection of the motor from which on it counts [rad]; it moves the arm's end by 6 nm."""


class Drive(NamedTuple):
    """Coefficients of a real drive, derived once from `ArmParams`."""

    static_excess: float  # s
    inverse_stribeck_speed: float  # 1 / omega_s  [s/rad]
    friction_sin: float  # r cos(phi_r): of sin(2 theta_a)
    friction_cos: float  # r sin(phi_r): of cos(2 theta_a)
    ripple: float  # c  [N m]
    ripple_order: float  # n
    ripple_phase: float  # phi_c  [rad]
    error_sin: float  # e cos(phi_e)  [rad]
    error_cos: float  # e sin(phi_e)  [rad]
    softening: float  # b K_s: what the belt lacks at small torsion  [N m/rad]
    knee: float  # theta_0^2  [rad^2]
    spring: float  # sigma_0 of a motor that sticks and gives [N m/rad]; 0 where it does not give
    damper: float  # sigma_1 [N m s/rad]
    spring_rate: float  # sqrt(sigma_0 / M_a1) [rad/s]


class Transmission(NamedTuple):
    """Angle of joint 1 beyond theta_a / G, and its derivatives by the motor's angle."""

    error: float  # eps  [rad]
    ratio: float  # g = dtheta_1 / dtheta_a
    curvature: float  # dg / dtheta_a  [1/rad]
    friction: float  # 1 + r sin(2 theta_a + phi_r): what friction is multiplied by


@inlined
def drive_of(row: Any) -> Drive:
    """Derive the coefficients of a drive from a row of constants, shape (len(FIELDS),); in kernels too."""
    variation, error = row[COLUMN.friction_variation], row[COLUMN.kinematic_error]
    variation_sine, variation_cosine = sine_cosine(row[COLUMN.friction_variation_phase])
    error_sine, error_cosine = sine_cosine(row[COLUMN.kinematic_error_phase])
    knee = row[COLUMN.belt_stiffening_torsion]
    inertia, gives = row[COLUMN.motor_inertia], row[COLUMN.presliding_deflection]
    spring = row[COLUMN.coulomb_friction] / gives if gives >= SMALLEST_DEFLECTION else 0.0
    rate = math.sqrt(spring / inertia)
    return Drive(
        static_excess=row[COLUMN.static_friction_excess],
        inverse_stribeck_speed=1 / row[COLUMN.stribeck_speed],
        friction_sin=variation * variation_cosine,
        friction_cos=variation * variation_sine,
        ripple=row[COLUMN.torque_ripple],
        ripple_order=row[COLUMN.torque_ripple_order],
        ripple_phase=row[COLUMN.torque_ripple_phase],
        error_sin=error * error_cosine,
        error_cos=error * error_sine,
        softening=row[COLUMN.belt_stiffening] * row[COLUMN.belt_stiffness],
        knee=knee * knee,
        spring=spring,
        damper=2 * PRESLIDING_DAMPING * rate * inertia,
        spring_rate=rate,
    )


def real_drive_of(row: Floats) -> Drive | None:
    """Derive the coefficients of a real drive, from a row of constants; None if the drive is ideal."""
    return drive_of(row) if row[list(DRIVE_COLUMNS)].any() else None


class Angles(NamedTuple):
    """What torques depend on beside the state: sines and cosines of its angles, and what friction sees."""

    sin_phi: float
    cos_phi: float
    sin_double: float  # of 2 theta_a; it and what follows is 0 where the drive is ideal
    cos_double: float
    sin_ripple: float  # of n theta_a + phi_c
    cos_ripple: float
    speed: float  # omega_a of which dry friction depends [rad/s]
    deflection: float  # of a motor that sticks and gives [rad]


@inlined
def angles_of(x: ArmState, plant: Plant, drive: Drive | None, deflection: float = 0.0) -> Angles:
    """Return sines and cosines of a state, with the deflection of a motor that sticks [rad]."""
    sin_phi, cos_phi = sin_cos(x.motor_angle * plant.inverse_gear - x.torsion)
    if drive is None:
        return Angles(sin_phi, cos_phi, 0.0, 0.0, 0.0, 0.0, x.motor_speed, 0.0)
    sin_double, cos_double = sin_cos(wrapped(2 * x.motor_angle))
    sin_ripple, cos_ripple = sin_cos(wrapped(drive.ripple_order * x.motor_angle + drive.ripple_phase))
    return Angles(sin_phi, cos_phi, sin_double, cos_double, sin_ripple, cos_ripple, x.motor_speed, deflection)


@inlined
def turned(at: Angles, double: float, ripple: float) -> Angles:
    """Return the angles after turns of 0.5 rad of twice the motor's angle and 1.7 rad of the ripple, at most."""
    s, c = short_sin_cos(double)
    sine, cosine = turn_sin_cos(ripple)
    return at._replace(
        sin_double=at.sin_double * c + at.cos_double * s,
        cos_double=at.cos_double * c - at.sin_double * s,
        sin_ripple=at.sin_ripple * cosine + at.cos_ripple * sine,
        cos_ripple=at.cos_ripple * cosine - at.sin_ripple * sine,
    )


@inlined
def nearer(sine: float, cosine: float, d: float) -> tuple[float, float]:
    """Return sine and cosine of an angle plus a small d [rad], by their series; error d^3 / 6."""
    along = 1 - 0.5 * d * d
    return sine * along + cosine * d, cosine * along - sine * d


@inlined
def near(sine: float, cosine: float, d: float) -> tuple[float, float]:
    """Return sine and cosine of an angle plus a small d [rad], by their series; error d^6 / 720."""
    half = 0.5 * d * d
    along, across = (1 - half) + half * half * (1 / 6), d * ((1 - half * (1 / 3)) + half * half * (1 / 30))
    return sine * along + cosine * across, cosine * along - sine * across


@inlined
def transmission(at: Angles, plant: Plant, drive: Drive) -> Transmission:
    """Return what depends on twice the motor's angle: kinematic error, its derivatives, variation of friction."""
    error = drive.error_sin * at.sin_double + drive.error_cos * at.cos_double
    slope = drive.error_sin * at.cos_double - drive.error_cos * at.sin_double
    variation = drive.friction_sin * at.sin_double + drive.friction_cos * at.cos_double
    return Transmission(error, plant.inverse_gear + 2 * slope, -4 * error, 1 + variation)


@inlined
def belt_torsion(x: ArmState, gear: Transmission, plant: Plant) -> tuple[float, float]:
    """Return the torsion of the belt theta_1 - phi [rad] and its rate [rad/s]."""
    return x.torsion + gear.error, x.torsion_speed + (gear.ratio - plant.inverse_gear) * x.motor_speed


@inlined
def belt_stiffness(share: float, plant: Plant, drive: Drive) -> tuple[float, float]:
    """Return the belt's secant stiffness and its tangent [N m/rad], at a share th^2 / (th^2 + theta_0^2)."""
    secant = plant.stiffness - drive.softening + 2 * drive.softening * share
    return secant, secant + 4 * drive.softening * share * (1 - share)


@inlined
def belt_motion(x: ArmState, plant: Plant, drive: Drive | None) -> tuple[float, float]:
    """Return torsion of the belt [rad] and its rate [rad/s], whatever the drive."""
    if drive is None:
        return x.torsion, x.torsion_speed
    return belt_torsion(x, transmission(angles_of(x, plant, drive), plant, drive), plant)


@compiled
def belt_motions(states: Floats, plant: Plant, drive: Drive | None) -> Floats:
    """Return torsion of the belt [rad] and its rate [rad/s], shape (n, 2), of states x, shape (n, 4), of one arm."""
    motions = np.empty((len(states), 2))
    for i in range(len(states)):
        x = ArmState(states[i, 0], states[i, 1], states[i, 2], states[i, 3])
        motions[i, 0], motions[i, 1] = belt_motion(x, plant, drive)
    return motions


@inlined
def resting(motor_angle: float, plant: Plant, drive: Drive) -> ArmState:
    """Return the state at rest without torque in the belt, at an angle of the motor [rad]."""
    x = ArmState(motor_angle, 0.0, 0.0, 0.0)
    return ArmState(motor_angle, 0.0, 0.0 - transmission(angles_of(x, plant, drive), plant, drive).error, 0.0)


class Coupling(NamedTuple):
    """Torques between motor and arm in one state."""

    ripple: float  # tau_r  [N m]
    belt: float  # tau_b  [N m]
    torsion_speed: float  # dth/dt  [rad/s]
    ratio: float  # g
    curvature: float  # dg / dtheta_a  [1/rad]
    friction: float  # of the sliding motor over tau_c: v (1 + s / (1 + (omega_a / omega_s)^2))
    inverse: float  # of the inertia that was given


@inlined
def coupling(x: ArmState, at: Angles, plant: Plant, drive: Drive | None, inertia: float = 1.0) -> Coupling:
    """Return what couples motor and arm; of an ideal drive, the belt alone. An inertia is inverted on the way."""
    if drive is None:
        return Coupling(0.0, belt_torque(x, plant), x.torsion_speed, plant.inverse_gear, 0.0, 1.0, 1 / inertia)
    gear = transmission(at, plant, drive)
    torsion, torsion_speed = belt_torsion(x, gear, plant)
    square, u = torsion * torsion, at.speed * drive.inverse_stribeck_speed
    sum_of_squares, falling = square + drive.knee, 1 + u * u
    product = sum_of_squares * falling
    inverse = 1 / (product * inertia)  # of all at once: a division takes as long as ten products
    with_inertia = inverse * inertia
    secant, _ = belt_stiffness(square * with_inertia * falling, plant, drive)
    belt = secant * torsion + plant.damping * torsion_speed
    share = with_inertia * sum_of_squares  # 1 / (1 + u^2), and its tangent from the speed that friction sees
    tangent = 1 - 2 * share * u * drive.inverse_stribeck_speed * (x.motor_speed - at.speed)
    sliding = gear.friction * (1 + drive.static_excess * share * tangent)
    ripple = drive.ripple * at.sin_ripple
    return Coupling(ripple, belt, torsion_speed, gear.ratio, gear.curvature, sliding, inverse * product)


@inlined
def belt_torque_rate(x: ArmState, at: Angles, torsional: float, plant: Plant, drive: Drive | None) -> float:
    """Return dtau_b/dt [N m/s] behind a motor at rest, at a torsional acceleration [rad/s^2]."""
    if drive is None:
        return plant.stiffness * x.torsion_speed + plant.damping * torsional
    torsion, _ = belt_torsion(x, transmission(at, plant, drive), plant)
    square = torsion * torsion
    _, tangent = belt_stiffness(square / (square + drive.knee), plant, drive)
    return tangent * x.torsion_speed + plant.damping * torsional


@inlined
def decay(ratio: float) -> float:
    """Return exp(-ratio) for ratio >= 0: a power series, squared six times, so that loops over arms vectorise.

    Relative error below 2e-14 up to a ratio of 8, below 1e-9 up to 40; beyond, where nothing is left, the value at 40.
    """
    z = (ratio if ratio < 40.0 else 40.0) * (1 / 64)
    z2 = z * z
    z4 = z2 * z2
    e0 = (1 - z) + z2 * (1 / 2 - z * (1 / 6))
    e1 = (1 / 24 - z * (1 / 120)) + z2 * (1 / 720 - z * (1 / 5040))
    e2 = (1 / 40320 - z * (1 / 362880)) + z2 * (1 / 3628800 - z * (1 / 39916800))
    e = e0 + z4 * (e1 + z4 * e2)
    e *= e
    e *= e
    e *= e
    e *= e
    e *= e
    return e * e
