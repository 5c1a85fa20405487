"""What an accelerometer on the arm's end tells a filter, and the observer that reads it beside the encoder.

The sensor low-passes, from one reading a[k] to the next by the factor lambda (`beltarm_env.task.accelerometer`). Known,
the low-pass is undone without a state of its own:

    m[k] = (a[k] - lambda a[k-1]) / (1 - lambda) = R[k] (v[k] - v[k-1]) / T + b + n

where v is the velocity of the end (`beltarm_env.physics.kinematics`), R turns it into the hand's axes, b is the zero-g
output and n white noise, but for a correlation of -lambda / (1 + lambda^2) = -0.09 with its neighbours. That the hand
turns by about a milliradian between two samples is left out. m is a function of the states at both ends of a sample,
those that a filter's prediction begins and ends with.

`correct_by_both` is the correction of `baselines.estimation.observer` with these two readings more,

    [x; d] = [x^-; d] + L (y - h),     y = [theta_a; m - b],     h = [x^-_1; R (v(x^-) - v(x)) / T]

where x is the estimate of a sample before, and b the zero-g output: the first reading of an episode, at rest. With the
linear arm z[k+1] = F z[k] + w, z = [x; d], all readings of a sample are those of the state before it,

    y[k+1] = (C F - B) z[k] + C w + n,     C = [e_1; dv/dx / T],     B = [0; dv/dx / T]

so that L is the steady-state gain of a one-step predictor whose process and measurement noise are correlated by C (by
the discrete algebraic Riccati equation; B. D. O. Anderson, J. B. Moore: Optimal Filtering, 1979, sec. 5.4).

The kinematic error of the joint, which the design model does not have, shows across the hand: an acceleration of
amplitude 4 e omega_a^2 times the reach, at twice the motor's frequency. It counts as noise of that size, so that L
depends on the motor's speed. While the motor sticks, L is that of an arm behind a motor without end: now the torsion is
corrected there too.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_discrete_are

from baselines.estimation.observer import (
    AT_REST,
    QUANTUM,
    STATE,
    Measured,
    Noise,
    add_correction,
    sticks,
    with_disturbance,
)
from baselines.models.linear import ANGLES, LinearArm, between, dead_time, linear_arm, place
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arm import COLUMN, Plant
from beltarm_env.arrays import Floats
from beltarm_env.engine import compiled, inlined
from beltarm_env.physics.drive import Drive
from beltarm_env.physics.kinematics import TipMotion, tip_motion
from beltarm_env.physics.state import ArmState
from beltarm_env.simulation import X
from beltarm_env.task.accelerometer import DECAY, NOISE, RANGE, along_and_across

AXES = 2
"""Readings of a sample: along the hand and across it."""
SPREAD = NOISE * float(np.hypot(1.0, DECAY)) / (1 - DECAY)
"""Standard deviation of n [m/s^2]."""
_CUT = 0.99 * RANGE  # a reading beyond it tells no acceleration
_SPEEDS = np.array([0.0, 10.0, 20.0, 40.0, 80.0, 160.0])  # of the motor, of the gains' tables [rad/s]
_ERROR = 1.2e-4  # kinematic error, its sine's and its cosine's standard deviation [rad]
_HELD = 1e6  # times its inertia: a motor without end
_SMALL = np.array([1e-4, 1e-3, 1e-6, 1e-4])  # differences of x


@inlined
def mean_acceleration(before: TipMotion, x: ArmState, plant: Plant, drive: Drive | None) -> tuple[float, float]:
    """Return R (v - v_before) / T [m/s^2], along and across the hand, for a sample that ends with the state x."""
    tip = tip_motion(x, plant, drive)
    x_rate = (tip.x_speed - before.x_speed) * (1 / CONTROL_PERIOD)
    y_rate = (tip.y_speed - before.y_speed) * (1 / CONTROL_PERIOD)
    return along_and_across(x_rate, y_rate, tip)


def unfiltered(now: Floats, before: Floats) -> tuple[Floats, Floats]:
    """Undo the sensor's low-pass, of readings a[k] and those of a sample before [m/s^2], shape (n, AXES).

    Returns:
        m[k] [m/s^2] and the variances of its noise, of the same shape; one that is cut off tells nothing.
    """
    cut = np.maximum(np.abs(now), np.abs(before)) > _CUT
    return (now - DECAY * before) / (1 - DECAY), np.where(cut, 1e6, SPREAD**2)


def acceleration_slopes(angle: float, plant: Plant) -> Floats:
    """Derivatives of the readings by x at a sample's end, of an arm at rest at an angle [rad]: shape (AXES, 4)."""
    rest = np.array([angle * plant.gear, 0.0, 0.0, 0.0])
    before = tip_motion(ArmState(*rest), plant)
    up, down = (
        np.array([mean_acceleration(before, ArmState(*(rest + step)), plant, None) for step in side * np.diag(_SMALL)])
        for side in (1, -1)
    )
    return (up - down).T / (2 * _SMALL)


def steady_accelerometer_gain(
    arm: LinearArm, slopes: Floats, noise: Noise, decay: float, spread: tuple[float, float]
) -> Floats:
    """Steady-state gain L, shape (5, 1 + AXES), of one linear arm at one angle.

    Args:
        arm: The linear arm.
        slopes: dv/dx / T, shape (AXES, 4).
        noise: Of the process.
        decay: Share of d that is left after a sample.
        spread: Standard deviations of the readings along and across the hand [m/s^2].
    """
    transition, process = with_disturbance(arm, noise.torque, noise.acceleration, decay)
    process[4, 4] = noise.disturbance**2 * CONTROL_PERIOD
    ends = np.zeros((1 + AXES, 5))
    ends[0, 0], ends[1:, :4] = 1.0, slopes
    begins = ends.copy()
    begins[0] = 0.0
    seen, shared = ends @ transition - begins, process @ ends.T
    measured = ends @ shared + np.diag([QUANTUM**2 / 12, *np.square(spread)])
    before = solve_discrete_are(transition.T, seen.T, process, measured, s=shared)
    return (transition @ before @ seen.T + shared) @ np.linalg.inv(seen @ before @ seen.T + measured)


class AccelerometerDesign(NamedTuple):
    """What the filter knows: beside `ObserverDesign`, the arm's kinematics, and gains for three innovations."""

    row: Floats
    delay: float
    plant: Plant
    sliding: Floats  # L of a motor that slides, at each of `ANGLES` and of `_SPEEDS`, shape (46, 6, 5, 1 + AXES)
    sticking: Floats  # and of one that sticks, shape (46, 5, 1 + AXES)


@lru_cache(maxsize=8)
def accelerometer_design(params: ArmParams, noise: Noise) -> AccelerometerDesign:
    """Filter of arms with design parameters `params` and an accelerometer on their ends."""
    plant, reach = params.plant(), 2 * params.link_length + params.hand_length
    moving, held = (linear_arm(of) for of in (params, replace(params, motor_inertia=_HELD * params.motor_inertia)))
    sliding, sticking = np.empty((len(ANGLES), len(_SPEEDS), 5, 1 + AXES)), np.empty((len(ANGLES), 5, 1 + AXES))
    for k, angle in enumerate(ANGLES):
        slopes = acceleration_slopes(angle, plant)
        arm = moving.at(k)
        for j, speed in enumerate(_SPEEDS):
            across = float(np.hypot(SPREAD, reach * 4 * _ERROR * speed**2))
            sliding[k, j] = steady_accelerometer_gain(arm, slopes, noise, 1.0, (SPREAD, across))
        sticking[k] = steady_accelerometer_gain(held.at(k), slopes, noise, 0.0, (SPREAD, SPREAD))
    sticking[:, [0, 1, 4]] = sticking[:, :, 0] = 0.0
    sticking[:, 0, 0] = AT_REST
    return AccelerometerDesign(params.row(), dead_time(params) / CONTROL_PERIOD, plant, sliding, sticking)


@inlined
def place_of_speed(speed: float) -> tuple[int, float]:
    """Index in `_SPEEDS` at or below a motor's speed [rad/s], and the weight of the next one at it."""
    low, last = 0, len(_SPEEDS) - 1
    while low < last - 1 and speed >= _SPEEDS[low + 1]:
        low += 1
    return low, min((speed - _SPEEDS[low]) / (_SPEEDS[low + 1] - _SPEEDS[low]), 1.0)


@compiled
def correct_by_both(
    design: AccelerometerDesign, measured: Measured, arm: int, predicted: Floats, estimate: Floats
) -> None:
    """Replace the last sample's estimate for one arm by the predicted state, corrected by encoder and accelerometer."""
    before, after = (ArmState._make(x[k] for k in range(X)) for x in (estimate, predicted))
    means, innovations = mean_acceleration(tip_motion(before, design.plant), after, design.plant, None), np.empty(3)
    innovations[0] = measured.angle[arm] - predicted[0]
    for k, mean in enumerate(means):
        acceleration = measured.acceleration[arm, k]
        innovations[1 + k] = 0.0 if np.isnan(acceleration) else acceleration - mean
    estimate[STATE] = predicted
    at_rest = sticks(estimate, measured.angle[arm])
    row, weight = place(estimate[0] / design.row[COLUMN.gear_ratio])
    low, part = place_of_speed(abs(estimate[1]))
    for i in range(X + 1):
        correction = 0.0
        for k in range(1 + AXES):
            gain = between(design.sticking[row, i, k], design.sticking[row + 1, i, k], weight)
            if not at_rest:
                slow = between(design.sliding[row, low, i, k], design.sliding[row + 1, low, i, k], weight)
                fast = between(design.sliding[row, low + 1, i, k], design.sliding[row + 1, low + 1, i, k], weight)
                gain = between(slow, fast, part)
            correction += gain * innovations[k]
        add_correction(estimate, i, correction)
