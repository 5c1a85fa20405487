"""Integration steps per control period: how many an arm needs, and which arms are too fast for any number allowed.

The bound is the fastest eigenvalue of the linear model: belt mode, belt damping, or motor friction. What is refused
counts the belt with its steepest stiffness, K_s (1 + 5/4 b); behind a real drive, steps get shorter where
friction falls with the speed (`physics.step.needed_rate`).
"""

from __future__ import annotations

import math
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltarm_env.arm import COLUMN, Plant, plant_of
from beltarm_env.engine import compiled, inlined
from beltarm_env.physics.drive import SMALLEST_DEFLECTION, drive_of
from beltarm_env.physics.models import Model, inverse_inertia, torsional_mobility
from beltarm_env.physics.step import FRICTION_STEPS, SPRING_TURN, TURN_GAINED
from beltarm_env.timing import CONTROL_PERIOD

Floats = NDArray[np.float64]


@inlined
def fastest_rate(plant: Plant, model: Model, stiffening: float = 0.0) -> float:
    """Bound the fastest eigenvalue of the linear model [rad/s]: belt mode, belt damping, motor friction."""
    # A linear function of cos^2 over a concave one: largest at 0 or 90 degrees.
    upright, stretched = inverse_inertia(0.0, plant, model), inverse_inertia(1.0, plant, model)
    compliance = max(torsional_mobility(*upright), torsional_mobility(*stretched))
    stiffness = plant.stiffness * (1 + 1.25 * stiffening)
    belt = max(math.sqrt(stiffness * compliance), plant.damping * compliance)
    return max(belt, plant.viscous_friction * plant.inverse_motor_inertia)


MAX_FRICTION_STEPS = 15_000
"""Most integration steps per sample where friction falls with speed."""
MAX_SUBSTEPS = 400
"""Most integration steps per sample."""
_STEP_ANGLE = 0.12  # largest product of rate and integration step: one step for any arm of the training ranges
_MAX_RATE = MAX_SUBSTEPS * _STEP_ANGLE / CONTROL_PERIOD  # [rad/s]


@inlined
def integration_substeps(plant: Plant, model: Model) -> float:
    """Return the integration steps per sample: one for any arm near the nominal, more for stiffer ones."""
    return max(math.ceil(fastest_rate(plant, model) * CONTROL_PERIOD / _STEP_ANGLE), 1.0)


@compiled
def integration_limits(row: Any, model: Model) -> tuple[float, float, float, float, float]:
    """Return how close an arm comes to what can be integrated, over what is allowed, from its row.

    Its fastest rate, the share of joint 1's speed that the kinematic error takes away, the integration steps for
    friction that falls with speed or for ripple, and for a motor that gives before it slips, and the share of its
    spring's energy that the variation of friction may give it: at most 1 each.
    """
    rate = fastest_rate(plant_of(row), model, row[COLUMN.belt_stiffening])
    slack = 2.2 * row[COLUMN.kinematic_error] * row[COLUMN.gear_ratio]
    excess = row[COLUMN.static_friction_excess]
    level = row[COLUMN.coulomb_friction] * (1 + row[COLUMN.friction_variation]) * (1 + excess)
    push = 2 * row[COLUMN.torque_limit] * (1 + row[COLUMN.torque_constant_error]) + level + row[COLUMN.torque_ripple]
    quickness = CONTROL_PERIOD * push / row[COLUMN.motor_inertia]  # change of the speed in a sample [rad/s]
    by_friction = FRICTION_STEPS * quickness / row[COLUMN.stribeck_speed] if excess > 0.0 else 0.0
    by_ripple = row[COLUMN.torque_ripple_order] * quickness * CONTROL_PERIOD / TURN_GAINED
    by_ripple = by_ripple if row[COLUMN.torque_ripple] > 0.0 else 0.0
    most = MAX_FRICTION_STEPS / integration_substeps(plant_of(row), model)  # which each of these is divided into
    giving = drive_of(row).spring_rate * CONTROL_PERIOD / SPRING_TURN / most
    given = 2 * row[COLUMN.friction_variation] * row[COLUMN.presliding_deflection] * (1 + excess) * (1 + excess)
    given *= 1 + abs(row[COLUMN.friction_drift])  # of which a move's friction is at most so much more than its spring's
    return rate / _MAX_RATE, slack, max(by_friction, by_ripple) / most, giving, given


REMEDIES = (
    "lower belt_stiffness or motor_viscous_friction, or raise arm_inertia or motor_inertia",
    "lower kinematic_error or gear_ratio",
    "raise stribeck_speed or motor_inertia, or lower torque_limit, coulomb_friction or torque_ripple_order",
    "raise presliding_deflection or motor_inertia, or lower coulomb_friction",
    "lower presliding_deflection, friction_variation, static_friction_excess or friction_drift",
)
"""What brings each of `integration_limits` down."""


def check_integrable(table: Floats, model: Model) -> None:
    """Check that all arms of a table, shape (n, len(FIELDS)), can be integrated.

    Raises:
        ValueError: If an arm's belt mode or friction is too fast for `MAX_SUBSTEPS`, a kinematic error would nearly
            turn joint 1 backward, friction falls too quickly with speed, ripple turns too quickly, or a motor that
            gives before it slips is too stiff, or would gain energy.
    """
    for row in table:
        rate, slack, steps, giving, given = integration_limits(row, model)
        if slack > 1:
            error, gear = row[COLUMN.kinematic_error], row[COLUMN.gear_ratio]
            raise ValueError(
                f"kinematic_error {error:.3g} rad takes nine tenths of joint 1's speed or more away, twice per turn of "
                f"the motor: with gear_ratio {gear:.3g} at most {1 / 2.2 / gear:.3g} can be integrated"
            )
        if steps > 1:
            raise ValueError(
                f"friction that falls with speed, or ripple, would take {steps * MAX_FRICTION_STEPS:.3g} integration "
                f"steps per {CONTROL_PERIOD} s, of {MAX_FRICTION_STEPS} allowed, for stribeck_speed "
                f"{row[COLUMN.stribeck_speed]:.3g} rad/s and torque_limit {row[COLUMN.torque_limit]:.3g} N m: "
                f"{REMEDIES[2]}"
            )
        if giving > 1:
            raise ValueError(
                f"a motor that gives by presliding_deflection {row[COLUMN.presliding_deflection]:.3g} rad would take "
                f"{giving * MAX_FRICTION_STEPS:.3g} integration steps per {CONTROL_PERIOD} s, of {MAX_FRICTION_STEPS} "
                f"allowed: {REMEDIES[3]}"
            )
        if given > 1:
            raise ValueError(
                f"with presliding_deflection {row[COLUMN.presliding_deflection]:.3g} rad the variation of friction "
                f"would give the motor {given:.3g} times the energy that sliding takes, which is not integrated: "
                f"{REMEDIES[4]}"
            )
        if rate > 1:
            raise ValueError(
                f"the arm's fastest rate is {rate * _MAX_RATE:.3g} rad/s; at most {_MAX_RATE:.3g} rad/s can be "
                f"integrated at {CONTROL_PERIOD} s per step: {REMEDIES[0]}"
            )


_FASTER_UP = (
    *(COLUMN.belt_stiffness, COLUMN.belt_damping_ratio, COLUMN.motor_viscous_friction, COLUMN.belt_stiffening),
    *(COLUMN.kinematic_error, COLUMN.static_friction_excess, COLUMN.coulomb_friction, COLUMN.friction_variation),
    *(COLUMN.torque_limit, COLUMN.torque_constant_error, COLUMN.torque_ripple, COLUMN.torque_ripple_order),
)  # whose upper ends are the harder to integrate


def fastest_arms(bounds: Floats) -> Floats:
    """Return arms of which one is the fastest within some ranges, shape (64, len(FIELDS)).

    In the arm's inertia M2(0) and its swing S the fastest lies at an end of a range or, for the full arm, where link 2
    is a rod alone, S = 6 M2(0). A small gear ratio makes the belt's mode fast, a large one a kinematic error large. A
    motor that gives little is fast, one that gives much may gain energy. In everything else the fastest lies at one
    known end.
    """
    fastest = bounds[0].copy()
    fastest[[*_FASTER_UP]] = bounds[1, _FASTER_UP]
    fastest[COLUMN.friction_drift] = np.abs(bounds[:, COLUMN.friction_drift]).max()
    inertia, swing = COLUMN.arm_inertia, COLUMN.arm_inertia_swing
    inertias = np.append(bounds[:, inertia], np.clip(bounds[:, swing] / 6, *bounds[:, inertia]))
    swings = np.append(bounds[:, swing], np.clip(6 * bounds[:, inertia], *bounds[:, swing]))
    least, most = bounds[:, COLUMN.presliding_deflection]
    gives = (max(least, SMALLEST_DEFLECTION) if most > 0 else 0.0, most)
    corners = np.array(list(product(inertias, swings, bounds[:, COLUMN.gear_ratio], gives)))
    table = np.tile(fastest, (len(corners), 1))
    table[:, [inertia, swing, COLUMN.gear_ratio, COLUMN.presliding_deflection]] = corners
    return table
