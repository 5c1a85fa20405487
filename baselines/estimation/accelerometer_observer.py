"""State of the arm from encoder, commanded torque and an accelerometer on the arm's end.

As `baselines.estimation.observer`, with two readings more (`baselines.estimation.accelerometer`) in its correction,

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

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.linalg import solve_discrete_are

from baselines.estimation.accelerometer import AXES, SPREAD, mean_acceleration, unfiltered
from baselines.estimation.observer import Estimate, Noise, StickSlipObserver
from baselines.estimation.tracking import AT_REST, LARGEST, LARGEST_TORQUE, QUANTUM, SLIDES
from baselines.models.linear import ANGLES, LinearArms, at_angle, linear_arm
from baselines.reading import Reading
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arm import Plant
from beltarm_env.arrays import Flags, Floats
from beltarm_env.engine import compiled
from beltarm_env.physics.kinematics import tip_motion
from beltarm_env.physics.state import ArmState
from beltarm_env.simulation import X

_SPEEDS = np.array([0.0, 10.0, 20.0, 40.0, 80.0, 160.0])  # of the motor, of the gains' tables [rad/s]
_ERROR = 1.2e-4  # kinematic error, its sine's and its cosine's standard deviation [rad]
_HELD = 1e6  # times its inertia: a motor without end
_SMALL = np.array([1e-4, 1e-3, 1e-6, 1e-4])  # differences of x


@dataclass(frozen=True)
class AccelerometerEstimate(Estimate):
    """Estimated states of n arms, and the readings of their accelerometers."""

    acceleration: Floats  # last readings [m/s^2], shape (n, AXES)
    bias: Floats  # zero-g outputs [m/s^2], shape (n, AXES)


@compiled
def mean_accelerations(before: Floats, after: Floats, plant: Plant) -> Floats:
    """Mean accelerations along and across the hand [m/s^2], shape (n, AXES), from x to x, both of shape (n, 4)."""
    result = np.empty((len(after), AXES))
    for i in range(len(after)):
        x = ArmState(before[i, 0], before[i, 1], before[i, 2], before[i, 3])
        y = ArmState(after[i, 0], after[i, 1], after[i, 2], after[i, 3])
        result[i, 0], result[i, 1] = mean_acceleration(tip_motion(x, plant), y, plant, None)
    return result


def acceleration_slopes(angle: float, plant: Plant) -> Floats:
    """Derivatives of the readings by x at a sample's end, of an arm at rest at an angle [rad]: shape (AXES, 4)."""
    at_rest = np.tile([angle * plant.gear, 0.0, 0.0, 0.0], (4, 1))
    up, down = (mean_accelerations(at_rest, at_rest + side * np.diag(_SMALL), plant) for side in (1, -1))
    return (up - down).T / (2 * _SMALL)


def steady_accelerometer_gain(
    arm: LinearArms, slopes: Floats, noise: Noise, decay: float, spread: tuple[float, float]
) -> Floats:
    """Steady-state gain L, shape (5, 1 + AXES), of one linear arm at one angle.

    Args:
        arm: The linear arm.
        slopes: dv/dx / T, shape (AXES, 4).
        noise: Of the process.
        decay: Share of d that is left after a sample.
        spread: Standard deviations of the readings along and across the hand [m/s^2].
    """
    transition, process = np.diag([0.0, 0.0, 0.0, 0.0, decay]), np.zeros((5, 5))
    transition[:4, :4], transition[:4, 4] = arm.transition, arm.by_torque
    for by_noise, deviation in ((arm.by_torque, noise.torque), (arm.by_acceleration, noise.acceleration)):
        process[:4, :4] += deviation**2 * np.outer(by_noise, by_noise)
    process[4, 4] = noise.disturbance**2 * CONTROL_PERIOD
    ends = np.zeros((1 + AXES, 5))
    ends[0, 0], ends[1:, :4] = 1.0, slopes
    begins = ends.copy()
    begins[0] = 0.0
    seen, shared = ends @ transition - begins, process @ ends.T
    measured = ends @ shared + np.diag([QUANTUM**2 / 12, *np.square(spread)])
    before = solve_discrete_are(transition.T, seen.T, process, measured, s=shared)
    return (transition @ before @ seen.T + shared) @ np.linalg.inv(seen @ before @ seen.T + measured)


@lru_cache(maxsize=8)
def accelerometer_gains(params: ArmParams, noise: Noise) -> tuple[Floats, Floats]:
    """Gains L at each of `ANGLES`: of a motor that slides, at each of `_SPEEDS`, and of one that sticks."""
    plant, reach = params.plant(), 2 * params.link_length + params.hand_length
    moving, held = (linear_arm(of) for of in (params, replace(params, motor_inertia=_HELD * params.motor_inertia)))
    slides, sticks = np.empty((len(ANGLES), len(_SPEEDS), 5, 1 + AXES)), np.empty((len(ANGLES), 5, 1 + AXES))
    for k, angle in enumerate(ANGLES):
        slopes = acceleration_slopes(angle, plant)
        arm = LinearArms(*(part[k] for part in moving))
        for j, speed in enumerate(_SPEEDS):
            across = float(np.hypot(SPREAD, reach * 4 * _ERROR * speed**2))
            slides[k, j] = steady_accelerometer_gain(arm, slopes, noise, 1.0, (SPREAD, across))
        rest = LinearArms(*(part[k] for part in held))
        sticks[k] = steady_accelerometer_gain(rest, slopes, noise, 0.0, (SPREAD, SPREAD))
    sticks[:, [0, 1, 4]] = sticks[:, :, 0] = 0.0
    sticks[:, 0, 0] = AT_REST
    return slides, sticks


class AccelerometerObserver(StickSlipObserver):
    """Kalman filter for arms with design parameters `params` and an accelerometer on their ends."""

    def __init__(self, params: ArmParams, noise: Noise | None = None) -> None:
        super().__init__(params, noise)
        self._plant = params.plant()
        self._slides, self._sticks = accelerometer_gains(params, noise or Noise())

    def update(self, estimate: Estimate | None, reading: Reading, begins: Flags) -> AccelerometerEstimate:
        """Bring the estimate up to this sample, see `StickSlipObserver`."""
        assert reading.acceleration is not None
        found = super().update(estimate, reading, begins)
        first = estimate.bias if isinstance(estimate, AccelerometerEstimate) else reading.acceleration
        bias = np.where(begins[:, None], reading.acceleration, first)
        return AccelerometerEstimate(
            found.arm, found.ahead, found.disturbance, found.simulation, reading.acceleration, bias
        )

    def _correct(
        self, estimate: Estimate, reading: Reading, begins: Flags, states: Floats, disturbances: Floats
    ) -> None:
        """Correct predicted states, see `StickSlipObserver`."""
        assert isinstance(estimate, AccelerometerEstimate)
        correction = self._correction(estimate, reading, states)
        states[:, :X] = np.clip(states[:, :X] + correction[:, :X], -LARGEST, LARGEST)
        disturbances[:] = np.clip(estimate.disturbance + correction[:, X], -LARGEST_TORQUE, LARGEST_TORQUE)

    def _correction(self, estimate: AccelerometerEstimate, reading: Reading, predicted: Floats) -> Floats:
        """Correction of [x; d], shape (n, 5)."""
        assert reading.acceleration is not None
        rests = (predicted[:, 1] == 0) & (np.abs(reading.motor_angle - predicted[:, 0]) <= SLIDES)
        readings, variance = unfiltered(reading.acceleration, estimate.acceleration)
        acceleration = readings - estimate.bias - mean_accelerations(estimate.state, predicted[:, :X], self._plant)
        acceleration[variance > SPREAD**2] = 0.0
        innovation = np.column_stack([reading.motor_angle - predicted[:, 0], acceleration])
        angle = predicted[:, 0] / self.params.gear_ratio
        place = np.interp(np.abs(predicted[:, 1]), _SPEEDS, np.arange(len(_SPEEDS)))
        low = np.minimum(place.astype(np.intp), len(_SPEEDS) - 2)
        tables, rows = at_angle(self._slides, angle), np.arange(len(angle))
        part = (place - low)[:, None, None]
        gains = (1 - part) * tables[rows, low] + part * tables[rows, low + 1]
        gains[rests] = at_angle(self._sticks, angle[rests])
        return np.einsum("nij,nj->ni", gains, innovation)
