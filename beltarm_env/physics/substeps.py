"""Integration steps per control period: how many an arm needs, and which arms are too fast for any number allowed.

The bound is the fastest eigenvalue of the linear model: belt mode, belt damping, or motor friction. Behind a drive as
it is built, the belt counts with its steepest stiffness, K_s (1 + 5/4 b), and steps get shorter where friction falls
with the speed (`physics.driven.step.needed_rate`).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beltarm_env.arm import COLUMN, FIELDS, Plant, plant_of
from beltarm_env.jit import inlined
from beltarm_env.physics.driven.step import FRICTION_STEPS
from beltarm_env.physics.models import Model, inverse_inertia
from beltarm_env.timing import CONTROL_PERIOD

Floats = NDArray[np.float64]


@inlined
def _torsional_mobility(cos_phi: float, plant: Plant, model: Model) -> float:
    """Return the torsional acceleration per belt torque while the motor slides [1/(kg m^2)]."""
    joint, mutual, arm = inverse_inertia(cos_phi, plant, model)
    return joint - 2 * mutual + arm


@inlined
def fastest_rate(plant: Plant, model: Model) -> float:
    """Bound the fastest eigenvalue of the linear model [rad/s]: belt mode, belt damping, motor friction."""
    # A linear function of cos^2 over a concave one: largest at 0 or 90 degrees.
    compliance = max(_torsional_mobility(0.0, plant, model), _torsional_mobility(1.0, plant, model))
    belt = max(math.sqrt(plant.stiffness * compliance), plant.damping * compliance)
    return max(belt, plant.viscous_friction * plant.inverse_motor_inertia)


MAX_FRICTION_STEPS = 15_000
"""Most integration steps per sample where friction falls with speed."""
MAX_SUBSTEPS = 400
"""Most integration steps per sample."""
_STEP_ANGLE = 0.12  # largest product of rate and integration step: one step for any arm of the training ranges


@inlined
def integration_substeps(plant: Plant, model: Model) -> float:
    """Return the integration steps per sample: one for any arm near the nominal, more for stiffer ones."""
    return max(math.ceil(fastest_rate(plant, model) * CONTROL_PERIOD / _STEP_ANGLE), 1.0)


def check_integrable(table: Floats, model: Model) -> None:
    """Check that all arms of a table, shape (n, len(FIELDS)), can be integrated.

    Raises:
        ValueError: If an arm's belt mode or friction is too fast for `MAX_SUBSTEPS`.
    """
    check_drives(table)
    for row in table:
        plant = stiffest(row)
        if integration_substeps(plant, model) > MAX_SUBSTEPS:
            raise ValueError(
                f"the arm's fastest rate is {fastest_rate(plant, model):.3g} rad/s; at most "
                f"{MAX_SUBSTEPS * _STEP_ANGLE / CONTROL_PERIOD:.3g} rad/s can be integrated at {CONTROL_PERIOD} s per "
                "step: lower belt_stiffness or motor_viscous_friction, or raise arm_inertia or motor_inertia"
            )


def check_ranges_integrable(bounds: Floats, model: Model) -> None:
    """Check the fastest arms within some ranges, see `range_bounds` and `check_integrable`."""
    check_integrable(fastest_arms(bounds), model)


def stiffest(row: Floats) -> Plant:
    """Return the coefficients of an arm with the belt as stiff as it gets, from its row."""
    return plant_of(row)._replace(stiffness=row[COLUMN.belt_stiffness] * (1 + 1.25 * row[COLUMN.belt_stiffening]))


def check_drives(table: Floats) -> None:
    """Check that the drives of a table of arms, shape (n, len(FIELDS)), can be integrated.

    Raises:
        ValueError: If a kinematic error would nearly turn joint 1 backward, or friction falls too quickly with speed.
    """
    at = dict(zip(FIELDS, table.T, strict=True))
    slack = 2.2 * at["kinematic_error"] * at["gear_ratio"]
    if (slack > 1).any():
        arm = int(np.argmax(slack))
        raise ValueError(
            f"kinematic_error {at['kinematic_error'][arm]:.3g} rad takes nine tenths of joint 1's speed or more away, "
            f"twice per turn of the motor: with gear_ratio {at['gear_ratio'][arm]:.3g} at most "
            f"{1 / 2.2 / at['gear_ratio'][arm]:.3g} can be integrated"
        )
    level = at["coulomb_friction"] * (1 + at["friction_variation"]) * (1 + at["static_friction_excess"])
    push = 2 * at["torque_limit"] * (1 + at["torque_constant_error"]) + level + at["torque_ripple"]
    steps = FRICTION_STEPS * CONTROL_PERIOD * push / (at["motor_inertia"] * at["stribeck_speed"])
    steps = np.where(at["static_friction_excess"] > 0, steps, 0.0)
    if (steps > MAX_FRICTION_STEPS).any():
        arm = int(np.argmax(steps))
        raise ValueError(
            f"friction that falls with speed would take {steps[arm]:.3g} integration steps per {CONTROL_PERIOD} s, of "
            f"{MAX_FRICTION_STEPS} allowed, for stribeck_speed {at['stribeck_speed'][arm]:.3g} rad/s: raise it or "
            "motor_inertia, or lower torque_limit or coulomb_friction"
        )


_FASTER_DRIVES = (
    *(COLUMN.belt_stiffening, COLUMN.kinematic_error, COLUMN.gear_ratio, COLUMN.static_friction_excess),
    *(COLUMN.coulomb_friction, COLUMN.friction_variation, COLUMN.torque_limit, COLUMN.torque_constant_error),
)  # whose upper ends are the harder to integrate


def fastest_arms(bounds: Floats) -> Floats:
    """Return arms of which one is the fastest within some ranges, shape (16, len(FIELDS)).

    In the arm's inertia M2(0) and its swing S the fastest lies at an end of a range or, for the full arm, where link 2
    is a rod alone, S = 6 M2(0); in everything else at one known end.
    """
    fastest = bounds[0].copy()
    upper = [COLUMN.belt_stiffness, COLUMN.belt_damping_ratio, COLUMN.motor_viscous_friction, *_FASTER_DRIVES]
    fastest[upper] = bounds[1, upper]
    inertia, swing = COLUMN.arm_inertia, COLUMN.arm_inertia_swing
    inertias = np.append(bounds[:, inertia], np.clip(bounds[:, swing] / 6, *bounds[:, inertia]))
    swings = np.append(bounds[:, swing], np.clip(6 * bounds[:, inertia], *bounds[:, swing]))
    table = np.tile(fastest, (len(inertias) * len(swings), 1))
    table[:, inertia] = np.repeat(inertias, len(swings))
    table[:, swing] = np.tile(swings, len(inertias))
    return table
