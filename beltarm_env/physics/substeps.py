"""Integration steps per control period: how many an arm needs, and which arms are too fast for any number allowed.

The bound is the fastest eigenvalue of the linear model: belt mode, belt damping, or motor friction.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beltarm_env.arm import COLUMN, Plant, plant_of
from beltarm_env.jit import inlined
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
    """Return arms of which one is the fastest within some ranges, shape (16, len(FIELDS)).

    In the arm's inertia M2(0) and its swing S the fastest lies at an end of a range or, for the full arm, where link 2
    is a rod alone, S = 6 M2(0); in everything else at one known end.
    """
    fastest = bounds[0].copy()
    upper = [COLUMN.belt_stiffness, COLUMN.belt_damping_ratio, COLUMN.motor_viscous_friction]
    fastest[upper] = bounds[1, upper]
    inertia, swing = COLUMN.arm_inertia, COLUMN.arm_inertia_swing
    inertias = np.append(bounds[:, inertia], np.clip(bounds[:, swing] / 6, *bounds[:, inertia]))
    swings = np.append(bounds[:, swing], np.clip(6 * bounds[:, inertia], *bounds[:, swing]))
    table = np.tile(fastest, (len(inertias) * len(swings), 1))
    table[:, inertia] = np.repeat(inertias, len(swings))
    table[:, swing] = np.tile(swings, len(inertias))
    return table
