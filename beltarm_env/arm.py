"""Constants of one arm, and every form that they take.

ArmParams    what a user reads and writes: physical constants, checked
row          the same numbers as an array, in the order of `FIELDS`; arms below one another make a table
Plant        coefficients of the equations of motion, derived from a row
"""

from __future__ import annotations

import math
from collections import namedtuple
from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields
from typing import Any, NamedTuple

import numpy as np

from beltarm_env.arrays import Floats
from beltarm_env.jit import inlined

_LARGEST = 1e9  # beyond any arm, and far from overflowing
_MAY_BE_ZERO = {
    *("motor_viscous_friction", "coulomb_friction", "hand_length", "arm_inertia_swing", "payload_mass"),
    "belt_damping_ratio",
}


@dataclass(frozen=True, slots=True)
class ArmParams:
    """Physical constants of one arm, SI units. The defaults are the nominal arm: Table 1, and assumptions marked (a).

    Raises:
        ValueError: If a value is not finite, is negative, or is zero where that makes no arm.
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

    def __post_init__(self) -> None:
        """Convert every field to float and check it."""
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
                raise TypeError(f"ArmParams.{field.name} must be a number, got {value!r}")
            object.__setattr__(self, field.name, float(value))
            may_be_zero = field.name in _MAY_BE_ZERO
            if not (value > 0 or (may_be_zero and value == 0)) or value > _LARGEST:
                allowed = "not negative" if may_be_zero else "positive"
                raise ValueError(
                    f"ArmParams.{field.name} must be finite, {allowed} and at most {_LARGEST:.0e}, got {value!r}"
                )

    @classmethod
    def from_row(cls, row: Floats) -> ArmParams:
        """Read an arm from its row, shape (len(FIELDS),)."""
        return cls(*map(float, row))

    def row(self) -> Floats:
        """Return the constants as an array, in the order of `FIELDS`."""
        return np.array(astuple(self))

    def plant(self) -> Plant:
        """Derive the coefficients of the equations of motion."""
        return plant_of(self.row())


FIELDS = tuple(field.name for field in fields(ArmParams))
"""Names of the constants: the columns of a table of arms."""
COLUMN: Any = namedtuple("COLUMN", FIELDS)(*range(len(FIELDS)))
"""Place of each constant in a row, by name: `row[COLUMN.gear_ratio]`; in kernels too."""
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
