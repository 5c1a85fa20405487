"""Constants of one arm, and every form that they take.

ArmParams    what a user reads and writes: physical constants, checked
row          the same numbers as an array, in the order of `FIELDS`; arms below one another make a table
Plant        coefficients of the equations of motion, derived from a row
"""

from __future__ import annotations

import math
import sys
from collections import namedtuple
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from beltarm_env.arrays import Floats
from beltarm_env.engine import inlined
from beltarm_env.timing import MAX_LATENCY

_LARGEST = 1e9  # beyond any arm, and far from overflowing
_MAY_BE_ZERO = {
    *("motor_viscous_friction", "coulomb_friction", "hand_length", "arm_inertia_swing", "payload_mass"),
    *("belt_damping_ratio", "torque_ripple"),
}
_PHASE = (0.0, 2 * math.pi)
_BOUNDS: dict[str, tuple[float, float]] = {
    "current_loop_time_constant": (0.0, 0.01),
    "command_latency": (0.0, MAX_LATENCY),
    "torque_constant_error": (-0.5, 0.5),
    "static_friction_excess": (0.0, 5.0),
    "stribeck_speed": (0.1, 1000.0),
    "friction_variation": (0.0, 0.9),
    "friction_variation_phase": _PHASE,
    "torque_ripple_order": (1.0, 100.0),
    "torque_ripple_phase": _PHASE,
    "kinematic_error": (0.0, 0.01),
    "kinematic_error_phase": _PHASE,
    "belt_stiffening": (0.0, 0.9),
    "belt_stiffening_torsion": (1e-4, 1.0),
    "friction_drift": (-0.5, 0.5),
    "presliding_deflection": (0.0, 0.1),
}
"""Lowest and highest values of the fields that are not just positive."""


class Bounds(NamedTuple):
    """What a field of `ArmParams` may be."""

    low: float
    high: float
    above: bool  # whether the lowest value itself is left out
    whole: bool  # whether it is a whole number


@cache
def bounds_of(name: str) -> Bounds:
    """Return what a field of `ArmParams` may be."""
    if name in _BOUNDS:
        return Bounds(*_BOUNDS[name], False, name in WHOLE)
    return Bounds(0.0, _LARGEST, name not in _MAY_BE_ZERO, False)


def checked_constant(name: str, value: object) -> float:
    """Return a value of a field of `ArmParams` as a float.

    Raises:
        ValueError: If it is not finite, or out of its bounds.
        TypeError: If it is not a real number.
    """
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        raise TypeError(f"ArmParams.{name} must be a number, got {value!r}")
    low, high, above, whole = bounds_of(name)
    if isinstance(value, int) and abs(value) > sys.float_info.max:
        raise ValueError(f"ArmParams.{name} must be finite, got a whole number that no float can hold")
    if not low <= value <= high or (above and value == low):
        if name in _BOUNDS:
            raise ValueError(f"ArmParams.{name} must be finite and lie within {low:g} and {high:g}, got {value!r}")
        allowed = "positive" if above else "not negative"
        raise ValueError(f"ArmParams.{name} must be finite, {allowed} and at most {high:.0e}, got {value!r}")
    if whole and value != int(value):
        raise ValueError(f"ArmParams.{name} must be a whole number, got {value!r}")
    return float(value)  # after the check, for no float holds every whole number


@dataclass(frozen=True, slots=True)
class ArmParams:
    """Physical constants of one arm, SI units. The defaults are the nominal arm: Table 1, and assumptions marked (a).

    Below the torque limit, the real drive (`beltarm_env.physics.drive`). All its effects are zero by default:
    the paper's arm.

    Raises:
        ValueError: If a value is not finite, or out of its bounds.
        TypeError: If a value is not a real number.
    """

    gear_ratio: float = 88.0  # G        [-]           harmonic drive
    link_length: float = 0.25  # l        [m]           of each of the two links
    hand_length: float = 0.10  # l_3      [m]           (a)
    motor_inertia: float = 6.3e-5  # M_a1     [kg m^2]      motor, gear and link 1 at the motor shaft
    motor_viscous_friction: float = 3.5e-4  # V_a1     [N m s/rad]   at the motor shaft
    coulomb_friction: float = 0.032  # tau_c    [N m]         at the motor shaft
    arm_inertia: float = 0.01  # M2(0)    [kg m^2]      links 2 and 3 about joint 1, arm stretched
    arm_inertia_swing: float = 0.06  # M2(90 deg) - M2(0) [kg m^2], without payload (a)
    payload_mass: float = 0.0  # m_p      [kg]          at the end of link 2 (a)
    belt_stiffness: float = 33.0  # K_s      [N m/rad]     between theta_1 and phi
    belt_damping_ratio: float = 0.01  # zeta     [-]           at 90 degrees, unloaded (a); the paper has none
    torque_limit: float = 0.3  # [N m]    of the motor (a)
    current_loop_time_constant: float = 0.0  # T_i      [s]           of the motor torque behind its command
    command_latency: float = 0.0  # T_c      [s]           from a sample to the instant at which its command acts
    torque_constant_error: float = 0.0  # k        [-]           torque over command, less 1
    static_friction_excess: float = 0.0  # s        [-]           breakaway over Coulomb friction, less 1
    stribeck_speed: float = 3.0  # omega_s  [rad/s]       of the motor, at which half of that excess is left
    friction_variation: float = 0.0  # r        [-]           of friction, twice per turn of the motor
    friction_variation_phase: float = 0.0  # phi_r    [rad]
    torque_ripple: float = 0.0  # c        [N m]         amplitude at the motor
    torque_ripple_order: float = 6.0  # n        [-]           periods per turn of the motor, a whole number
    torque_ripple_phase: float = 0.0  # phi_c    [rad]
    kinematic_error: float = 0.0  # e        [rad]         of the harmonic drive at joint 1, twice per turn of the motor
    kinematic_error_phase: float = 0.0  # phi_e    [rad]
    belt_stiffening: float = 0.0  # b        [-]           softer by b at small torsion, stiffer by b at large
    belt_stiffening_torsion: float = 0.01  # theta_0  [rad]         at which the belt has its mean stiffness K_s
    friction_drift: float = 0.0  # [-]           change of all friction from a move's start to its end
    presliding_deflection: float = 0.0  # [rad]         of the motor, by which it gives before it slips, at tau_c

    def __post_init__(self) -> None:
        """Convert every field to float and check it."""
        for name in FIELDS:
            object.__setattr__(self, name, checked_constant(name, getattr(self, name)))

    @classmethod
    def from_row(cls, row: Floats) -> ArmParams:
        """Read an arm from its row, shape (len(FIELDS),)."""
        return cls(*map(float, row))

    def row(self) -> Floats:
        """Return the constants as an array, in the order of `FIELDS`."""
        return np.array([getattr(self, name) for name in FIELDS])

    def plant(self) -> Plant:
        """Derive the coefficients of the equations of motion."""
        return plant_of(self.row())


FIELDS = tuple(field.name for field in fields(ArmParams))
"""Names of the constants: the columns of a table of arms."""
COLUMN: Any = namedtuple("COLUMN", FIELDS)(*range(len(FIELDS)))
"""Place of each constant in a row, by name: `row[COLUMN.gear_ratio]`; in kernels too."""
WHOLE = ("torque_ripple_order",)
"""Fields that are whole numbers."""
DRIVE_EFFECTS = (
    *("current_loop_time_constant", "command_latency", "torque_constant_error"),
    *("static_friction_excess", "friction_variation", "torque_ripple"),
    *("kinematic_error", "belt_stiffening", "friction_drift", "presliding_deflection"),
)
"""Fields of which each is an effect of the real drive; an arm in which all are zero has the ideal drive."""
NOMINAL = ArmParams()


def params_table(arms: Sequence[ArmParams]) -> Floats:
    """Return the rows of n arms, shape (n, len(FIELDS))."""
    return np.array([arm.row() for arm in arms])


def params_columns(table: Floats) -> dict[str, Floats]:
    """Return the columns of a table of arms by name, as `reset(options={"params": ...})` takes them."""
    return dict(zip(FIELDS, table.T, strict=True))


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
def plant_of(row: Any) -> Plant:
    """Derive the coefficients of the equations of motion from a row, shape (len(FIELDS),); in kernels too.

    The belt's damping D_s = 2 zeta sqrt(K_s M2(90 deg)) is a property of the belt: the payload does not enter.

    For the full arm, link 2 is as heavy a uniform rod as M2(0) = m_2 l^2 / 3 and S = 2 m_2 l^2 both allow (of the
    nominal arm it is all there is). Where S is larger, the rest is a mass at joint 3; where M2(0) is larger, an inertia
    at joint 2 that turns with link 2.
    """
    arm, swing = row[COLUMN.arm_inertia], row[COLUMN.arm_inertia_swing]
    stiffness, link = row[COLUMN.belt_stiffness], row[COLUMN.link_length]
    return Plant(
        inverse_gear=1 / row[COLUMN.gear_ratio],
        inverse_motor_inertia=1 / row[COLUMN.motor_inertia],
        viscous_friction=row[COLUMN.motor_viscous_friction],
        coulomb_friction=row[COLUMN.coulomb_friction],
        inertia=arm,
        inertia_swing=swing + 4 * link * link * row[COLUMN.payload_mass],
        link_inertia=min(0.5 * swing, 3 * arm),
        stiffness=stiffness,
        damping=2 * row[COLUMN.belt_damping_ratio] * math.sqrt(stiffness * (arm + swing)),
        gear=row[COLUMN.gear_ratio],
        double_link=2 * link,
        hand=row[COLUMN.hand_length],
        torque_limit=row[COLUMN.torque_limit],
    )
