"""Extended Kalman filter for the state and the unknown constants of an arm, from its encoder's angle and its torque.

The filter's state is x of eq. (6c) and the logarithms of six constants over their nominal values:

    inertia's swing S (with it the payload), belt stiffness K_s, motor inertia M_a1, viscous friction V_a1, Coulomb
    friction tau_c, inertia M2(0)

It predicts by simulating the arm over one control period, Coulomb friction included, with the estimated constants. Its
Jacobian is by differences, from a simulation with each of the ten perturbed: so a motor that sticks tells the filter
nothing, by itself, for its simulation does not depend on torsion and constants. The process noise is a torque at the
motor, a torsional acceleration, and a slow random walk of the logarithms; the encoder's rounding to counts of q counts
as white noise of variance q^2 / 12. If the encoder moves by more than two counts while the simulation sticks, noise at
the motor lets it go. See L. Ljung: Asymptotic behavior of the extended Kalman filter as a parameter estimator, IEEE TAC
24, 1979.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from baselines.models.linear import at_angle, linear_arm
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arm import COLUMN, FIELDS, params_table
from beltarm_env.arrays import Floats, Integers
from beltarm_env.jit import compiled
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.advance import WORK_ROWS, advance_block
from beltarm_env.kernels.layout import LANES
from beltarm_env.physics.models import LUMPED
from beltarm_env.simulation import load_arms

IDENTIFIED = (
    "arm_inertia_swing",
    "belt_stiffness",
    "motor_inertia",
    "motor_viscous_friction",
    "coulomb_friction",
    "arm_inertia",
)
_ROWS = np.array([FIELDS.index(name) for name in IDENTIFIED])
_LOWEST = np.array([-0.5, -0.4, -0.3, -0.6, -0.6, -0.4])
_HIGHEST = np.array([1.4, 0.4, 0.3, 0.6, 0.6, 0.4])
"""Bounds of the logarithms: they hold all arms of the benchmark, and only arms that can be integrated."""
_LARGEST = np.array([300.0, 2000.0, 2.0, 200.0])  # of x: keeps an estimate that has diverged finite
_STEPS = np.array([1e-2, 1e-1, 1e-4, 1e-2, *[1e-2] * len(IDENTIFIED)])  # of the filter state, for the Jacobian
_SIZE = len(_STEPS)
_SLIDES = 2  # counts that a motor at rest cannot move by
_LOOSE = 1e-2  # torque noise that lets a simulated motor go [N m]


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """Standard deviations: of the constants before anything is measured, their drift, and the process noise."""

    swing: float = 0.35  # of ln S: most of it is the payload
    stiffness: float = 0.12  # of ln K_s
    motor_inertia: float = 0.06  # of ln M_a1
    friction: float = 0.17  # of ln V_a1 and ln tau_c
    inertia: float = 0.12  # of ln M2(0)
    drift: float = 0.02  # growth of all of them [1/sqrt(s)]
    torque: float = 1e-3  # at the motor, white [N m]
    acceleration: float = 1.0  # torsional, white [rad/s^2]

    def covariance(self, resolution: float) -> Floats:
        """Initial covariance of the filter's state, shape (10, 10), at rest, for an encoder of `resolution` [rad]."""
        constants = [self.swing, self.stiffness, self.motor_inertia, self.friction, self.friction, self.inertia]
        return np.diag(np.square([resolution / 12**0.5, 0.0, 1e-4, 1e-4, *constants]))


class Tracks(NamedTuple):
    """State of m filters, each of one arm, along the last axis: kernels process many of them side by side."""

    state: Floats  # x, shape (4, m)
    logs: Floats  # ln of each of IDENTIFIED over its nominal value, shape (6, m)
    covariance: Floats  # of both, shape (10, 10, m)
    evidence: Floats  # ln of the likelihood of all that the encoder has shown, shape (m,)

    def of(self, rows: Integers) -> Tracks:
        """Selection of filters."""
        return Tracks(*(part.take(rows, axis=-1) for part in self))


@compiled
def _simulated(state: Floats, table: Floats, torque: Floats, simulations: int) -> Floats:
    """Simulate one period from the estimate, and from copies with one of the ten filter states perturbed in each.

    Args:
        state: Estimated x, shape (4, m).
        table: Estimated constants, rows as the fields of `ArmParams`, shape (12, m).
        torque: Held over the period [N m], shape (m,); cut at the torque limit.
        simulations: Number of simulations of each arm, 1 to 11.

    Returns:
        Shape (simulations, 4, m).
    """
    result, factors = np.empty((simulations, *state.shape)), np.exp(_STEPS)
    block, work, actions = np.zeros(at.ROWS * LANES), np.zeros(WORK_ROWS * LANES), np.zeros(LANES)
    for low in range(0, len(torque), LANES):
        count = min(LANES, len(torque) - low)
        arms = table[:, low : low + count].copy()
        for j in range(count):
            actions[j] = min(max(torque[low + j] / arms[COLUMN.torque_limit, j], -1.0), 1.0)
        load_arms(block, arms, LUMPED)
        for k in range(simulations):
            for i in range(4):
                for j in range(count):
                    block[(at.STATE + i) * LANES + j] = state[i, low + j]
            if 1 <= k <= 4:
                for j in range(count):
                    block[(at.STATE + k - 1) * LANES + j] += _STEPS[k - 1]
            elif k > 4:
                constant = _ROWS[k - 5]
                arms[constant] *= factors[k - 1]
                load_arms(block, arms, LUMPED)
                arms[constant] = table[constant, low : low + count]
            advance_block(block, work, actions, count, LUMPED)
            for i in range(4):
                for j in range(count):
                    result[k, i, low + j] = block[(at.STATE + i) * LANES + j]
    return result


@compiled
def _prior(predicted: Floats, covariance: Floats, noise: Floats) -> Floats:
    """Covariance before the measurement: F P F' + Q, where F is the unit matrix but for its rows of x.

    Args:
        predicted: From `_simulated`, shape (11, 4, m).
        covariance: P, shape (10, 10, m).
        noise: What torque and torsional acceleration do to x, each by its standard deviation, shape (2, 4, m).

    Returns:
        Shape (10, 10, m).
    """
    count = covariance.shape[2]
    jacobian, half, prior = np.empty((4, _SIZE, count)), np.empty((4, _SIZE, count)), covariance.copy()
    for i in range(4):
        for j in range(_SIZE):
            for arm in range(count):
                jacobian[i, j, arm] = (predicted[j + 1, i, arm] - predicted[0, i, arm]) / _STEPS[j]
    for j in range(_SIZE):
        for i in range(4):
            for arm in range(count):
                total = 0.0
                for m in range(_SIZE):
                    total += jacobian[i, m, arm] * covariance[m, j, arm]
                half[i, j, arm] = total
    for i in range(4):
        for j in range(4):
            for arm in range(count):
                total = noise[0, i, arm] * noise[0, j, arm] + noise[1, i, arm] * noise[1, j, arm]
                for m in range(_SIZE):
                    total += half[i, m, arm] * jacobian[j, m, arm]
                prior[i, j, arm] = total
        for j in range(4, _SIZE):
            for arm in range(count):
                prior[i, j, arm] = prior[j, i, arm] = half[i, j, arm]
    return prior


@compiled
def _corrected(
    predicted: Floats,
    tracks: Tracks,
    measured: Floats,
    resolution: Floats,
    by_noise: Floats,
    deviations: tuple[float, float, float],
) -> tuple[Floats, Floats, Floats, Floats]:
    """Kalman filter step from the simulations of `_simulated`, shape (11, 4, m)."""
    arms = len(measured)
    noise, holds = np.empty((2, 4, arms)), np.empty(arms, np.bool_)
    for arm in range(arms):
        sticks = predicted[0, 1, arm] == 0.0
        holds[arm] = sticks and abs(measured[arm] - predicted[0, 0, arm]) <= _SLIDES * resolution[arm]
        torque = (0.0 if holds[arm] else _LOOSE) if sticks else deviations[0]
        for i in range(4):
            noise[0, i, arm], noise[1, i, arm] = torque * by_noise[arm, 0, i], deviations[1] * by_noise[arm, 1, i]
    prior, gain = _prior(predicted, tracks.covariance, noise), np.empty((_SIZE, arms))
    for i in range(4, _SIZE):
        for arm in range(arms):
            prior[i, i, arm] += deviations[2] * deviations[2] * CONTROL_PERIOD
    state, logs, evidence = predicted[0].copy(), tracks.logs.copy(), tracks.evidence.copy()
    for arm in range(arms):
        innovation, rounding = measured[arm] - predicted[0, 0, arm], resolution[arm] * resolution[arm]
        prior[0, 0, arm] += rounding / 120  # keeps the angle open to the encoder
        total = prior[0, 0, arm] + rounding / 12
        evidence[arm] -= 0.5 * (innovation * innovation / total + np.log(total))
        for i in range(_SIZE):
            gain[i, arm] = prior[i, 0, arm] / total
        for i in range(4):
            state[i, arm] += gain[i, arm] * innovation
        for i in range(4, _SIZE):
            logs[i - 4, arm] += gain[i, arm] * innovation
        if holds[arm]:
            state[1, arm] = 0.0
    covariance = np.empty_like(prior)
    for i in range(_SIZE):
        for j in range(_SIZE):
            for arm in range(arms):
                covariance[i, j, arm] = prior[i, j, arm] - gain[i, arm] * prior[0, j, arm]
    return state, logs, covariance, evidence


class ArmFilter:
    """Extended Kalman filter for arms that are nominally `params`."""

    def __init__(self, params: ArmParams, uncertainty: Uncertainty) -> None:
        self.params = params
        self.uncertainty = uncertainty
        self._nominal = params_table([params]).T
        arm = linear_arm(params)
        self._by_noise = np.stack([arm.by_torque, arm.by_acceleration], axis=1)  # shape (46, 2, 4)

    def initial(self, angles: Floats, resolution: float) -> Tracks:
        """Filters of nominal arms at rest at motor angles of shape (m,), measured with a resolution [rad]."""
        state = np.zeros((4, len(angles)))
        state[0] = angles
        covariance = np.repeat(self.uncertainty.covariance(resolution)[:, :, None], len(angles), axis=2)
        return Tracks(state, np.zeros((len(IDENTIFIED), len(angles))), covariance, np.zeros(len(angles)))

    def table(self, logs: Floats) -> Floats:
        """Estimated constants of the arms, rows as the fields of `ArmParams`, shape (12, m)."""
        table = np.repeat(self._nominal, logs.shape[1], axis=1)
        table[_ROWS] *= np.exp(logs)
        return table

    def step(self, tracks: Tracks, torque: Floats, measured: Floats, resolution: Floats) -> Tracks:
        """Predict over one sample and correct by its measurement.

        Args:
            tracks: The filters.
            torque: Held over the period up to this sample [N m], shape (m,).
            measured: Motor angle [rad], shape (m,).
            resolution: Of the encoder [rad], shape (m,).
        """
        predicted = _simulated(tracks.state, self.table(tracks.logs), torque, 1 + _SIZE)
        by_noise = at_angle(self._by_noise, predicted[0, 0] / self.params.gear_ratio)
        deviations = self.uncertainty.torque, self.uncertainty.acceleration, self.uncertainty.drift
        new = Tracks(*_corrected(predicted, tracks, measured, resolution, by_noise, deviations))
        state = np.clip(new.state, -_LARGEST[:, None], _LARGEST[:, None])
        return new._replace(state=state, logs=np.clip(new.logs, _LOWEST[:, None], _HIGHEST[:, None]))

    def predict(self, state: Floats, logs: Floats, torque: Floats) -> Floats:
        """Predict states, shape (4, m), over one sample under torques [N m] of shape (m,)."""
        return _simulated(state, self.table(logs), torque, 1)[0]
