"""Extended Kalman filter for an arm and its drive, from the encoder's angle and the commands.

Its state is z of `baselines.estimation.believed_arm`: the arm's state, its constants, and those of its drive. It
predicts by simulating the arm over one control period, with stiction and the drive believed in. Its Jacobian is by
differences, from a simulation with each entry perturbed: so a motor that sticks tells the filter nothing, by itself,
for its simulation does not depend on torsion and constants.

The process noise is a torque at the motor, a torsional acceleration, a slow random walk of the constants, and d, which
decays. The encoder's rounding to counts of q counts as white noise of variance q^2 / 12. If the encoder moves by more
than two counts while the simulation sticks, noise at the motor lets it go.

At which speed friction falls from breakaway to Coulomb's is not identified. So the torque at the motor has the noise

    sigma_tau + s tau_c / (1 + (omega_a / omega_s)^2) / sqrt(3)

where the second term is what the friction of the nominal arm has beyond Coulomb's at that speed, taken to be anything
between none and twice as much. Without it the friction of a slow motor is explained by a wrong belt, and nothing says
otherwise once the motor sticks.

The filter watches itself: with innovations nu of variance S,

    w <- w + 0.05 (nu^2 / S - w)

is 1 where the encoder moves as expected. Where w > 1, the torque noise is multiplied by it, so that the filter trusts
its arm less. Where w > 8, nothing that it has identified explains the encoder: it begins anew with the nominal
constants, and with it the plans that rely on it. See L. Ljung: Asymptotic behavior of the extended Kalman filter as a
parameter estimator, IEEE TAC 24, 1979; R. K. Mehra: Approaches to adaptive filtering, IEEE TAC 17, 1972.

What an accelerometer feels depends on x at both ends of the sample (`baselines.estimation.felt`). So it is predicted
with x, as two more entries that last for one sample: their rows of F and Q follow from the same simulations, and
correct what stood before by their covariance with it. These innovations are watched too: the readings count as W times
as noisy as the data sheet says,

    W <- max(1, W (1 + 0.05 (min(nu^2 / S, 10) - 1)))

for each reading, so that nu^2 / S is 1 in the mean or below. Where W > 100, what is felt is not this arm's: the filter
begins anew with the nominal constants, and does not listen to the accelerometer any more in this episode.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from baselines.estimation import believed_arm as arm_of
from baselines.estimation.believed_arm import (
    BIAS,
    DELAY,
    DIFFERENCED,
    DISTURBANCE,
    ERROR_SINE,
    FELT_SIZE,
    HIGHEST,
    LAG,
    LOGS,
    LOWEST,
    ORDERS,
    RIPPLE,
    SHORTEST,
    SIZE,
    STEPS,
    ripple_shape,
    simulated,
)
from baselines.estimation.felt import AXES
from baselines.models.linear import at_angle, linear_arms
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arrays import Flags, Floats
from beltarm_env.jit import compiled
from beltarm_env.task.accelerometer import BIAS as ZERO_G

UNFELT = np.empty((0, 0)), np.empty((0, 0))
"""What is felt without an accelerometer."""
_SLIDES = 2  # counts that a motor at rest cannot move by
_LOOSE = 1e-2  # torque noise that lets a simulated motor go [N m]
_WATCH = 0.05  # share of the last innovation in w
_LOST = 8.0  # of w
_SHOCK = 10.0  # most of nu^2 / S that counts in one reading of the accelerometer
_MISTRUSTED = 100.0  # of W
_DEAF = 1e6  # W of an accelerometer that is not listened to
_FRICTION = LOGS.start + arm_of.IDENTIFIED.index("motor_viscous_friction")  # the Coulomb friction follows


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """Standard deviations: of the constants before anything is measured, their drift, and the process noise."""

    swing: float = 0.3  # of ln S: most of it is the payload
    stiffness: float = 0.3  # of ln K_s
    motor_inertia: float = 0.06  # of ln M_a1
    friction: float = 0.2  # of ln V_a1 and ln tau_c
    inertia: float = 0.12  # of ln M2(0)
    torque_constant: float = 0.06  # of ln(1 + k), which all of these have in common
    delay: float = 0.5  # of D [samples]
    lag: float = 0.2  # of T_i [samples]
    variation: float = 0.1  # of p and q
    excess: float = 0.14  # of s
    stiffening: float = 0.1  # of b
    ripple: float = 1e-3  # of s_n and c_n [N m]
    drift: float = 0.01  # growth of all but the ripple's [1/sqrt(s)]
    friction_drift: float = 0.06  # further growth of ln V_a1 and ln tau_c, which drift [1/sqrt(s)]
    torque: float = 3e-3  # at the motor, white [N m]
    acceleration: float = 1.0  # torsional, white [rad/s^2]
    disturbance: float = 5e-4  # of d [N m]
    memory: float = 0.02  # time in which d decays [s]
    kinematic_error: float = 1.2e-4  # of e_s and e_c [rad]

    def covariance(self, resolution: float) -> Floats:
        """Initial covariance of z, shape (SIZE, SIZE), at rest, for an encoder of `resolution` [rad]."""
        constants = [self.swing, self.stiffness, self.motor_inertia, self.friction, self.friction, self.inertia]
        drive = [self.delay, self.lag, self.variation, self.variation, self.excess, self.stiffening, self.disturbance]
        ripple = [self.ripple] * (2 * len(ORDERS))
        result = np.diag(np.square([resolution / 12**0.5, 0.0, 1e-4, 1e-4, *constants, *drive, *ripple]))
        result[LOGS, LOGS] += self.torque_constant**2
        return result

    def covariance_felt(self, resolution: float) -> Floats:
        """Initial covariance of z with an accelerometer, shape (FELT_SIZE, FELT_SIZE)."""
        result = np.diag(np.square([*[0.0] * SIZE, *[self.kinematic_error] * 2, *[ZERO_G / 3**0.5] * AXES]))
        result[:SIZE, :SIZE] = self.covariance(resolution)
        return result

    @property
    def kept(self) -> float:
        """Share of d that is left after a sample."""
        return float(np.exp(-CONTROL_PERIOD / self.memory))

    def growth(self) -> Floats:
        """Variance that each entry of z gains in a sample, but for x: shape (FELT_SIZE,)."""
        result = np.zeros(FELT_SIZE)
        result[LOGS.start : DISTURBANCE] = self.drift**2 * CONTROL_PERIOD
        result[_FRICTION : _FRICTION + 2] += self.friction_drift**2 * CONTROL_PERIOD
        result[DISTURBANCE] = (1 - self.kept**2) * self.disturbance**2
        return result


class Tracks(NamedTuple):
    """State of m filters, each of one arm, along the last axis: kernels process many of them side by side."""

    mean: Floats  # z, shape (SIZE or FELT_SIZE, m)
    covariance: Floats  # of it, shape (SIZE, SIZE, m) or (FELT_SIZE, FELT_SIZE, m)
    surprise: Floats  # w, shape (m,)
    unrest: Floats  # W of the accelerometer, shape (m,); 1 without one


@compiled
def _jacobian(before: Floats, predicted: Floats, rows: int) -> Floats:
    """Derivatives by z of x after a sample, and of what is felt over it, shape (rows, size, m); see `_prior`."""
    size, count = before.shape
    jacobian = np.zeros((rows, size, count))
    for i in range(rows):
        for j in range(DIFFERENCED):
            for arm in range(count):
                jacobian[i, j, arm] = (predicted[j + 1, i, arm] - predicted[0, i, arm]) / STEPS[j]
    for k in range(len(ORDERS)):
        for arm in range(count):
            sine, cosine = ripple_shape(before[0, arm], before[1, arm], k)
            for i in range(rows):
                jacobian[i, RIPPLE.start + 2 * k, arm] = jacobian[i, DISTURBANCE, arm] * sine
                jacobian[i, RIPPLE.start + 2 * k + 1, arm] = jacobian[i, DISTURBANCE, arm] * cosine
    if size > SIZE:
        for j in range(2):
            for i in range(rows):
                for arm in range(count):
                    k = DIFFERENCED + j
                    jacobian[i, ERROR_SINE + j, arm] = (predicted[k + 1, i, arm] - predicted[0, i, arm]) / STEPS[k]
        for axis in range(AXES):
            jacobian[4 + axis, BIAS + axis] = 1.0
    return jacobian


@compiled
def _learn(mean: Floats, covariance: Floats, entry: int, innovation: Floats, total: Floats) -> None:
    """Correct mean and covariance, in place, by the innovation of one entry and its variance; both of shape (m,)."""
    row, gain = covariance[entry].copy(), covariance[:, entry].copy()
    for i in range(len(mean)):
        for arm in range(len(total)):
            gain[i, arm] = gain[i, arm] / total[arm]
            mean[i, arm] += gain[i, arm] * innovation[arm]
    for i in range(len(mean)):
        for j in range(len(mean)):
            for arm in range(len(total)):
                covariance[i, j, arm] = covariance[i, j, arm] - gain[i, arm] * row[j, arm]


@compiled
def _prior(before: Floats, predicted: Floats, covariance: Floats, noise: Floats, kept: float) -> Floats:
    """Covariance before the measurement: F P F' + Q, where F is the unit matrix but for its rows of x, and of d.

    Args:
        before: z, shape (size, m).
        predicted: From `simulated`.
        covariance: P, shape (size, size, m).
        noise: What torque and torsional acceleration do to x and to what is felt, each by its standard deviation, shape
            (2, rows, m) with rows = 4, or 4 + AXES with an accelerometer.
        kept: Share of d that is left.

    Returns:
        Shape (size + rows - 4, size + rows - 4, m), what is felt coming last; Q of x and of what is felt alone.
    """
    size, _, count = covariance.shape
    rows = noise.shape[1]
    jacobian, half = _jacobian(before, predicted, rows), np.empty((rows, size, count))
    prior = np.empty((size + rows - 4, size + rows - 4, count))
    prior[:size, :size] = covariance
    for j in range(size):
        for i in range(rows):
            for arm in range(count):
                total = 0.0
                for m in range(size):
                    total += jacobian[i, m, arm] * covariance[m, j, arm]
                half[i, j, arm] = total
    for i in range(rows):
        to = i if i < 4 else size + i - 4
        for j in range(rows):
            for arm in range(count):
                total = noise[0, i, arm] * noise[0, j, arm] + noise[1, i, arm] * noise[1, j, arm]
                for m in range(size):
                    total += half[i, m, arm] * jacobian[j, m, arm]
                prior[to, j if j < 4 else size + j - 4, arm] = total
        for j in range(4, size):
            for arm in range(count):
                prior[to, j, arm] = prior[j, to, arm] = half[i, j, arm]
    for i in range(len(prior)):
        for arm in range(count):
            prior[i, DISTURBANCE, arm] *= kept
            prior[DISTURBANCE, i, arm] *= kept
    return prior


@compiled
def _corrected(
    predicted: Floats,
    tracks: Tracks,
    measured: Floats,
    resolution: Floats,
    felt: Floats,
    felt_variance: Floats,
    by_noise: Floats,
    deviations: tuple[float, float],
    slow: tuple[float, float],
    growth: Floats,
    kept: float,
) -> tuple[Floats, Floats, Floats, Floats]:
    """Kalman filter step from the simulations of `simulated`; `growth` and `kept` are those of `Uncertainty`.

    `deviations` are those of torque and torsional acceleration, `slow` that of the friction of a slow motor [N m] and
    the speed at which half of it is left [rad/s].
    """
    arms, size, axes = len(measured), len(tracks.mean), len(felt)
    noise, holds = np.zeros((2, 4 + axes, arms)), np.empty(arms, np.bool_)
    for arm in range(arms):
        sticks = predicted[0, 1, arm] == 0.0
        holds[arm] = sticks and abs(measured[arm] - predicted[0, 0, arm]) <= _SLIDES * resolution[arm]
        doubtful = slow[0] / (1 + (predicted[0, 1, arm] / slow[1]) ** 2)
        sliding = (deviations[0] + doubtful) * max(tracks.surprise[arm], 1.0)
        torque = (0.0 if holds[arm] else _LOOSE) if sticks else sliding
        for i in range(4):
            noise[0, i, arm], noise[1, i, arm] = torque * by_noise[arm, 0, i], deviations[1] * by_noise[arm, 1, i]
            for axis in range(4, 4 + axes):
                slope = (predicted[i - 4, axis, arm] - predicted[0, axis, arm]) / STEPS[i]
                noise[0, axis, arm] += slope * noise[0, i, arm]
                noise[1, axis, arm] += slope * noise[1, i, arm]
    covariance = _prior(tracks.mean, predicted, tracks.covariance, noise, kept)
    mean, surprise, unrest = np.empty((size + axes, arms)), tracks.surprise.copy(), tracks.unrest.copy()
    mean[:size] = tracks.mean
    innovation, total = np.empty(arms), np.empty(arms)
    for arm in range(arms):
        for i in range(4):
            mean[i, arm] = predicted[0, i, arm]
        for axis in range(axes):
            mean[size + axis, arm] = predicted[0, 4 + axis, arm] + mean[BIAS + axis, arm]
        mean[DISTURBANCE, arm] *= kept
        for i in range(4, size):
            covariance[i, i, arm] += growth[i]
        innovation[arm], rounding = measured[arm] - mean[0, arm], resolution[arm] * resolution[arm]
        covariance[0, 0, arm] += rounding / 120  # keeps the angle open to the encoder
        total[arm] = covariance[0, 0, arm] + rounding / 12
        if not holds[arm]:
            surprise[arm] += _WATCH * (innovation[arm] * innovation[arm] / total[arm] - surprise[arm])
    _learn(mean, covariance, 0, innovation, total)
    for axis in range(axes):
        innovation[:] = felt[axis] - mean[size + axis]
        total[:] = covariance[size + axis, size + axis] + felt_variance[axis] * tracks.unrest**2
        unrest *= 1 + _WATCH * (np.minimum(innovation**2 / total, _SHOCK) - 1)
        _learn(mean, covariance, size + axis, innovation, total)
    for arm in range(arms):
        if holds[arm]:
            mean[1, arm] = 0.0
    return (
        mean[:size].copy(),
        covariance[:size, :size].copy(),
        surprise,
        np.where(tracks.unrest >= _DEAF, _DEAF, np.maximum(unrest, 1.0)),
    )


class ArmFilter:
    """Extended Kalman filter for arms that are nominally `params`, with an accelerometer on their ends if `felt`."""

    def __init__(self, params: ArmParams, uncertainty: Uncertainty, felt: bool = False) -> None:
        self.params = params
        self.uncertainty = uncertainty
        self._felt = felt
        self.nominal = arm_of.nominal_row(params)
        self._growth = uncertainty.growth()
        excess = params.static_friction_excess * params.coulomb_friction
        self._slow = excess / 3**0.5, params.stribeck_speed
        arm = linear_arms(self.nominal[None])
        self._by_noise = np.stack([arm.by_torque[0], arm.by_acceleration[0]], axis=1)  # shape (46, 2, 4)

    def initial(self, angles: Floats, resolution: float) -> Tracks:
        """Filters of nominal arms at rest at motor angles of shape (m,), measured with a resolution [rad]."""
        mean = np.zeros((FELT_SIZE if self._felt else SIZE, len(angles)))
        mean[0] = angles
        mean[LAG] = max(self.params.current_loop_time_constant / CONTROL_PERIOD, SHORTEST)
        mean[DELAY] = mean[LAG] + self.params.command_latency / CONTROL_PERIOD
        u = self.uncertainty
        spread = u.covariance_felt(resolution) if self._felt else u.covariance(resolution)
        covariance = np.repeat(spread[:, :, None], len(angles), axis=2)
        return Tracks(mean, covariance, np.ones(len(angles)), np.ones(len(angles)))

    def step(
        self,
        tracks: Tracks,
        commands: Floats,
        measured: Floats,
        resolution: Floats,
        felt: tuple[Floats, Floats] = UNFELT,
    ) -> Tracks:
        """Predict over one sample and correct by its measurement.

        Args:
            tracks: The filters.
            commands: Up to this sample, latest first [N m], shape (m, HISTORY).
            measured: Motor angle [rad], shape (m,).
            resolution: Of the encoder [rad], shape (m,).
            felt: From `felt.unfiltered`, of an accelerometer.
        """
        u, predicted = self.uncertainty, simulated(tracks.mean, self.nominal, commands, True)
        by_noise = at_angle(self._by_noise, predicted[0, 0] / self.params.gear_ratio)
        noise = (u.torque, u.acceleration), self._slow, self._growth, u.kept
        mean, covariance, surprise, unrest = _corrected(
            predicted, tracks, measured, resolution, *felt, by_noise, *noise
        )
        size = len(mean)
        new = Tracks(np.clip(mean, LOWEST[:size, None], HIGHEST[:size, None]), covariance, surprise, unrest)
        mistrusted = (unrest > _MISTRUSTED) & (unrest < _DEAF)
        lost = (surprise > _LOST) | mistrusted
        if not lost.any():
            return new
        anew = self._begun_anew(new, lost)
        return anew._replace(unrest=np.where(mistrusted, _DEAF, np.where(lost, unrest, anew.unrest)))

    def _begun_anew(self, tracks: Tracks, lost: Flags) -> Tracks:
        """Filters of which some are lost, those with the nominal constants again; in their states, but less sure."""
        fresh = self.initial(tracks.mean[0], 0.0)
        fresh.mean[:4] = tracks.mean[:4]
        fresh.covariance[range(4), range(4)] = np.square([1e-2, 1.0, 1e-2, 0.3])[:, None]
        return Tracks(*(np.where(lost, new, old) for new, old in zip(fresh, tracks, strict=True)))
