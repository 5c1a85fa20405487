"""Errors of the tip to first order in the arm's deviation from a reference: what optimal controllers weigh.

About a joint that is at the angle theta and turns at the speed w, the deviation z = x - (G theta, G w, 0, 0) puts the
tip off by

    radial    position  -2 l s dphi              velocity  -2 l s dphi' - 2 l c w dphi          dphi = z_1 / G - z_3
    lateral   position  (2 l c + l_3) z_3        velocity  (2 l c + l_3) z_4 - 2 l sin(theta) w z_3

with c = cos(theta) and s = sin(theta), bounded from below. At 0 degrees the true slope of the radial error vanishes and
its curvature is what brings the arm there: without a bound, nothing in a quadratic cost would hold the motor. There are
two bounds, because controllers were tuned with either and cost up to 8 % more or less with the other's: `bounded_sine`
for the optimal plan and LQG, `softened_sine` for predictive control.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from beltarm_env.arm import Plant
from beltarm_env.arrays import Floats
from beltarm_env.engine import inlined
from beltarm_env.physics.trigonometry import sine_cosine
from beltarm_env.task.cost import POSITION_SCALE, VELOCITY_SCALE

_LEAST, _SOFTENING = 0.1, 0.05


@inlined
def bounded_sine(angle: float) -> float:
    """max(sin(angle), 0.1)."""
    sine, _ = sine_cosine(angle)
    return max(sine, _LEAST)


@inlined
def softened_sine(angle: float) -> float:
    """sqrt(sin(angle)^2 + 0.05^2)."""
    sine, _ = sine_cosine(angle)
    return math.sqrt(sine * sine + _SOFTENING * _SOFTENING)


class ErrorWeights(NamedTuple):
    """Weights of the tip's squared errors."""

    position: float  # [1/m^2]
    velocity: float  # [s^2/m^2]


@inlined
def write_tip_errors(angle: float, speed: float, bounded: float, plant: Plant, errors: Floats) -> None:
    """Write C, shape (4, 4), of the errors C z: radial and lateral position [m], then their velocities [m/s].

    Args:
        angle: Joint angle of the reference [rad].
        speed: Its rate [rad/s].
        bounded: s, the bounded sine of the angle.
        plant: Coefficients of the arm.
        errors: C, written.
    """
    sine, cosine = sine_cosine(angle)
    radial, reach = plant.double_link * bounded, plant.double_link * cosine + plant.hand
    change, shortening = plant.double_link * cosine * speed, plant.double_link * sine * speed
    errors[0, 0], errors[0, 1], errors[0, 2], errors[0, 3] = -radial / plant.gear, 0.0, radial, 0.0
    errors[1, 0], errors[1, 1], errors[1, 2], errors[1, 3] = 0.0, 0.0, reach, 0.0
    errors[2, 0], errors[2, 1] = -change / plant.gear, -radial / plant.gear
    errors[2, 2], errors[2, 3] = change, radial
    errors[3, 0], errors[3, 1], errors[3, 2], errors[3, 3] = 0.0, 0.0, -shortening, reach


@inlined
def add_tip_cost(cost: Floats, errors: Floats, weights: ErrorWeights) -> None:
    """Add C'WC, the squares of the tip's errors, to Q of a quadratic cost z'Qz of a state that begins with z."""
    for k in range(4):
        weight = weights.position if k < 2 else weights.velocity
        for i in range(4):
            for j in range(4):
                cost[i, j] += weight * (errors[k, i] * errors[k, j])  # in this order it stays symmetric, bit for bit


@inlined
def error_weights(velocity: float) -> ErrorWeights:
    """Weights of the tip's squared errors over the scales of the task's cost; `velocity` times as much for velocity."""
    return ErrorWeights(1 / POSITION_SCALE**2, velocity / VELOCITY_SCALE**2)
