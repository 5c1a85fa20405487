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

import numpy as np

from beltarm_env.arm import Plant
from beltarm_env.arrays import Floats
from beltarm_env.jit import inlined
from beltarm_env.task.cost import POSITION_SCALE, VELOCITY_SCALE

_LEAST, _SOFTENING = 0.1, 0.05


@inlined
def bounded_sine(angle: float) -> float:
    """max(sin(angle), 0.1)."""
    return max(np.sin(angle), _LEAST)


@inlined
def softened_sine(angle: float) -> float:
    """sqrt(sin(angle)^2 + 0.05^2)."""
    sine = np.sin(angle)
    return np.sqrt(sine * sine + _SOFTENING * _SOFTENING)


Pair = tuple[float, float]
Row = tuple[float, float, float, float]


@inlined
def tip_error_rows(angle: float, speed: float, sine: float, plant: Plant) -> tuple[Row, Row, Row, Row]:
    """Rows of C, of the errors C z: radial and lateral position [m], then radial and lateral velocity [m/s].

    Args:
        angle: Joint angle of the reference [rad].
        speed: Its rate [rad/s].
        sine: s, the bounded sine of the angle.
        plant: Coefficients of the arm.
    """
    cosine = np.cos(angle)
    radial, reach = plant.double_link * sine, plant.double_link * cosine + plant.hand
    change, shortening = plant.double_link * cosine * speed, plant.double_link * np.sin(angle) * speed
    return (
        (-radial / plant.gear, 0.0, radial, 0.0),
        (0.0, 0.0, reach, 0.0),
        (-change / plant.gear, -radial / plant.gear, change, radial),
        (0.0, 0.0, -shortening, reach),
    )


@inlined
def add_tip_cost(cost: Floats, angle: float, speed: float, sine: float, plant: Plant, weights: Pair) -> None:
    """Add the squares of the tip's errors to a quadratic cost z'Qz: C'WC to the first four rows and columns of Q.

    Args:
        cost: Q, shape (n, n); of a state of which z is the beginning.
        angle: Joint angle of the reference [rad].
        speed: Its rate [rad/s].
        sine: s, the bounded sine of the angle.
        plant: Coefficients of the arm.
        weights: Of squared position [1/m^2] and velocity errors [s^2/m^2], see `error_weights`.
    """
    radial, lateral, radial_rate, lateral_rate = tip_error_rows(angle, speed, sine, plant)
    _add_square(cost, radial, weights[0])
    _add_square(cost, lateral, weights[0])
    _add_square(cost, radial_rate, weights[1])
    _add_square(cost, lateral_rate, weights[1])


@inlined
def _add_square(cost: Floats, row: Row, weight: float) -> None:
    for i in range(4):
        for j in range(4):
            cost[i, j] += weight * (row[i] * row[j])  # in this order it stays symmetric, bit for bit


def error_weights(velocity: float) -> Pair:
    """Weights of squared position [1/m^2] and velocity errors [s^2/m^2], relative to the scales of the task's cost.

    Args:
        velocity: Weight of the velocity's error, where the position's has 1.
    """
    return 1 / POSITION_SCALE**2, velocity / VELOCITY_SCALE**2
