"""Physical constants of the arm, and how far they vary from arm to arm."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from beltarm_env.jit import inlined
from beltarm_env.physics.models import Model, inverse_inertia
from beltarm_env.physics.plant import Plant
from beltarm_env.timing import CONTROL_PERIOD

Floats = NDArray[np.float64]
Ranges = Mapping[str, tuple[float, float]]

_LARGEST = 1e9  # beyond any arm, and far from overflowing
_MAY_BE_ZERO = {"motor_viscous_friction", "coulomb_friction", "hand_length", "arm_inertia_swing", "payload_mass"}
_MAY_BE_ZERO |= {"belt_damping_ratio"}


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


FIELDS = tuple(field.name for field in fields(ArmParams))
_NOMINAL = ArmParams()


def _around(name: str, share: float) -> tuple[float, float]:
    nominal = getattr(_NOMINAL, name)
    return (1 - share) * nominal, (1 + share) * nominal


TRAIN_RANGES: Ranges = {
    "motor_inertia": _around("motor_inertia", 0.10),
    "motor_viscous_friction": _around("motor_viscous_friction", 0.30),
    "coulomb_friction": _around("coulomb_friction", 0.30),
    "arm_inertia": _around("arm_inertia", 0.20),
    "arm_inertia_swing": _around("arm_inertia_swing", 0.20),
    "belt_stiffness": _around("belt_stiffness", 0.20),
    "belt_damping_ratio": (0.002, 0.018),
    "payload_mass": (0.0, 0.2),
}
"""Ranges of the arms that training, tuning and the `randomized` split draw from, uniformly and independently."""


def resolve_ranges(randomization: Literal["off", "train"] | Ranges) -> dict[str, tuple[float, float]]:
    """Ranges of the fields that vary.

    Args:
        randomization: "off", "train" (`TRAIN_RANGES`), or a mapping from field name to (low, high).

    Raises:
        ValueError: On an unknown word or field, on low > high, or where an end of the range makes no arm.
        TypeError: If it is neither a word nor a mapping of pairs.
    """
    if isinstance(randomization, str):
        if randomization not in ("off", "train"):
            raise ValueError(f"randomization must be 'off', 'train' or a mapping of ranges, got {randomization!r}")
        return {} if randomization == "off" else dict(TRAIN_RANGES)
    if not isinstance(randomization, Mapping):
        raise TypeError(f"randomization must be 'off', 'train' or a mapping of ranges, got {randomization!r}")
    ranges = {}
    for name, pair in randomization.items():
        if name not in FIELDS:
            raise ValueError(f"randomization names an unknown parameter {name!r}; known: {', '.join(FIELDS)}")
        try:
            low, high = pair
        except (TypeError, ValueError):
            raise TypeError(f"randomization[{name!r}] must be a pair (low, high), got {pair!r}") from None
        for end in (low, high):
            ArmParams(**{name: end})
        if low > high:
            raise ValueError(f"randomization[{name!r}] has low {low!r} above high {high!r}; swap them")
        ranges[name] = (float(low), float(high))
    return ranges


def range_bounds(ranges: Ranges) -> Floats:
    """Lowest and highest value of every field, shape (2, len(FIELDS)); equal where a field does not vary."""
    bounds = np.tile([getattr(_NOMINAL, name) for name in FIELDS], (2, 1))
    for name, pair in ranges.items():
        bounds[:, FIELDS.index(name)] = pair
    return bounds


@inlined
def plant_of(row: Floats) -> Plant:
    """Coefficients of the equations of motion, for parameters in the order of `FIELDS`.

    The belt's damping D_s = 2 zeta sqrt(K_s M2(90 deg)) is a property of the belt: the payload does not enter.

    For the full arm, link 2 is as heavy a uniform rod as M2(0) = m_2 l^2 / 3 and S = 2 m_2 l^2 both allow (of the
    nominal arm it is all there is). Where S is larger, the rest is a mass at joint 3; where M2(0) is larger, an inertia
    at joint 2 that turns with link 2.
    """
    gear, link, hand, inertia, viscous, coulomb, arm, swing, payload, stiffness, damping_ratio, limit = (
        row[0],
        row[1],
        row[2],
        row[3],
        row[4],
        row[5],
        row[6],
        row[7],
        row[8],
        row[9],
        row[10],
        row[11],
    )
    return Plant(
        1 / gear,
        1 / inertia,
        viscous,
        coulomb,
        arm,
        swing + 4 * link * link * payload,
        min(0.5 * swing, 3 * arm),
        stiffness,
        2 * damping_ratio * math.sqrt(stiffness * (arm + swing)),
        gear,
        2 * link,
        hand,
        limit,
    )


@inlined
def _torsional_mobility(cos_phi: float, plant: Plant, model: Model) -> float:
    """Torsional acceleration per belt torque while the motor slides [1/(kg m^2)]."""
    joint, mutual, arm = inverse_inertia(cos_phi, plant, model)
    return joint - 2 * mutual + arm


@inlined
def fastest_rate(plant: Plant, model: Model) -> float:
    """Bound of the fastest eigenvalue of the linear model [rad/s]: belt mode, belt damping, motor friction."""
    # A linear function of cos^2 over a concave one: largest at 0 or 90 degrees.
    compliance = max(_torsional_mobility(0.0, plant, model), _torsional_mobility(1.0, plant, model))
    belt = max(math.sqrt(plant.stiffness * compliance), plant.damping * compliance)
    return max(belt, plant.viscous_friction * plant.inverse_motor_inertia)


MAX_SUBSTEPS = 400
"""Most integration steps per sample."""
_STEP_ANGLE = 0.12  # largest product of rate and integration step: one step for any arm of the training ranges


@inlined
def integration_substeps(plant: Plant, model: Model) -> float:
    """Integration steps per sample: one for any arm near the nominal, more for stiffer ones."""
    return max(math.ceil(fastest_rate(plant, model) * CONTROL_PERIOD / _STEP_ANGLE), 1.0)


def check_integrable(table: Floats, model: Model) -> None:
    """Check that all arms of a table, shape (n, len(FIELDS)), can be integrated.

    Raises:
        ValueError: If an arm's belt mode or friction is too fast for `MAX_SUBSTEPS`.
    """
    for row in table:
        plant = plant_of(row)
        if integration_substeps(plant, model) > MAX_SUBSTEPS:
            raise ValueError(
                f"the arm's fastest rate is {fastest_rate(plant, model):.3g} rad/s; at most "
                f"{MAX_SUBSTEPS * _STEP_ANGLE / CONTROL_PERIOD:.3g} rad/s can be integrated at {CONTROL_PERIOD} s per "
                "step: lower belt_stiffness or motor_viscous_friction, or raise arm_inertia or motor_inertia"
            )


def check_ranges_integrable(bounds: Floats, model: Model) -> None:
    """Check the fastest arms within some ranges, see `range_bounds` and `check_integrable`."""
    check_integrable(fastest_arms(bounds), model)


def fastest_arms(bounds: Floats) -> Floats:
    """Arms of which one is the fastest within some ranges, shape (16, len(FIELDS)).

    In the arm's inertia M2(0) and its swing S the fastest lies at an end of a range or, for the full arm, where link 2
    is a rod alone, S = 6 M2(0); in everything else at one known end.
    """
    fastest = bounds[0].copy()
    for name in ("belt_stiffness", "belt_damping_ratio", "motor_viscous_friction"):
        fastest[FIELDS.index(name)] = bounds[1, FIELDS.index(name)]
    inertia, swing = FIELDS.index("arm_inertia"), FIELDS.index("arm_inertia_swing")
    inertias = np.append(bounds[:, inertia], np.clip(bounds[:, swing] / 6, *bounds[:, inertia]))
    swings = np.append(bounds[:, swing], np.clip(6 * bounds[:, inertia], *bounds[:, swing]))
    table = np.tile(fastest, (len(inertias) * len(swings), 1))
    table[:, inertia] = np.repeat(inertias, len(swings))
    table[:, swing] = np.tile(swings, len(inertias))
    return table


def params_table(arms: Sequence[ArmParams]) -> Floats:
    """Constants of n arms, columns as the fields of `ArmParams`, shape (n, len(FIELDS))."""
    return np.array([[getattr(arm, name) for name in FIELDS] for arm in arms])


def params_of(row: Floats) -> ArmParams:
    """The arm whose constants are a row of such a table."""
    return ArmParams(*row)


def plant_of_params(params: ArmParams) -> Plant:
    """Coefficients of an arm's equations of motion, see `plant_of`."""
    return plant_of(params_table([params])[0])
