"""Extended Kalman filter for an arm and its drive, from the encoder's angle and the commands.

Its state is z of `baselines.estimation.believed_arm`: the arm's state, its constants, and those of its drive. It
predicts by simulating the arm over one control period, with stiction and the drive believed in. Its Jacobian is by
differences, from a simulation with each entry perturbed. A motor that sticks hangs on a spring (presliding): its
deflection is kept beside z, moves with the corrected angle, and ends where the simulation slips.

The process noise is a torque at the motor, a torsional acceleration, a slow random walk of the constants, and d, which
decays. The encoder's rounding to counts of q counts as white noise of variance q^2 / 12. While the motor sticks, its
torque is four times as noisy: where it slips and how stiff its spring is are known least. (With as much noise as of one
that slides, `adaptive` costs some 3 % more on motors that stick without giving; with less, its motor hunts at rest.)
The encoder changes no constant but g then, nor what is known of them: their rows of the gain are zero, as in Schmidt's
filter. So what was learnt in a move is not lost at rest.

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

Where the motor sticks, as behind a dead encoder, innovations say little of the torsion. So where an entry of x leaves
its bounds, or its standard deviation exceeds them, x is not known any more, and the filter begins anew with an arm at
rest at the measured angle.

Without a part in the gripper, S is the arm's own. Where the gripper picks one at a move's start, mean and variance of
ln S are remembered, and opened by as much as the part's mass m may change them; covariances are scaled with it:

    S = S_arm + 4 l^2 m,   d ln S = (S_arm / S) d ln S_arm + (4 l^2 / S) d m

Where it places the part, S is the remembered one again, uncorrelated. All else that is known lasts.

What an accelerometer shows depends on x at both ends of the sample (`baselines.estimation.accelerometer`). So it is
predicted with x, as two more entries that last for one sample: their rows of F and Q follow from the same simulations,
and correct what stood before by their covariance with it. These innovations are watched too: the readings count as W
times as noisy as the data sheet says,

    W <- max(1, W (1 + 0.05 (min(nu^2 / S, 10) - 1)))

for each reading, so that nu^2 / S is 1 in the mean or below. Where W > 100, the readings are not this arm's: the filter
begins anew with the nominal constants, and does not listen to the accelerometer any more in this episode.
"""

from __future__ import annotations

from typing import NamedTuple

from baselines.estimation import believed_arm as z_at
from baselines.estimation.accelerometer import AXES
from baselines.estimation.filter_design import Design, Inputs, Room, Tracks
from baselines.models.linear import between, place
from beltarm_env.arm import COLUMN
from beltarm_env.arrays import Floats
from beltarm_env.engine import compiled, inlined
from beltarm_env.kernels.layout import LANES
from beltarm_env.physics.trigonometry import exponential

_WATCH = 0.05  # share of the last innovation in w
_LOST = 8.0  # of w
_SHOCK = 10.0  # most of nu^2 / S that counts in one reading of the accelerometer
_MISTRUSTED = 100.0  # of W
_DEAF = 1e6  # W of an accelerometer that is not listened to
_ROUNDING = 12**0.5  # resolution over the standard deviation of rounding to it
_LESS_SURE = (1e-4, 1.0, 1e-4, 0.09)  # variances of x of a filter that begins anew
_AT_ONCE = 5  # rows of the covariance
_SWING = z_at.LOGS.start  # entry of z: ln S


@compiled
def _write_jacobian(predicted: Floats, shapes: Floats, arm: int, jacobian: Floats) -> None:
    """Write the derivatives by z of x after a sample and of the accelerometer's readings over it, shape (rows, size).

    Args:
        predicted: As `simulate` writes it, of one arm.
        shapes: Of the ripple, as `simulate` leaves them.
        arm: Which of them.
        jacobian: Written.
    """
    rows, size = jacobian.shape
    for i in range(rows):
        for j in range(z_at.DIFFERENCED):
            jacobian[i, j] = (predicted[i, j + 1] - predicted[i, 0]) / z_at.STEPS[j]
    for k in range(len(z_at.ORDERS)):
        sine, cosine = shapes[2 * k * LANES + arm], shapes[(2 * k + 1) * LANES + arm]
        for i in range(rows):
            jacobian[i, z_at.RIPPLE.start + 2 * k] = jacobian[i, z_at.DISTURBANCE] * sine
            jacobian[i, z_at.RIPPLE.start + 2 * k + 1] = jacobian[i, z_at.DISTURBANCE] * cosine
    if size > z_at.SIZE:
        for i in range(rows):
            for j in range(2):
                k = z_at.DIFFERENCED + j
                jacobian[i, z_at.ERROR_SINE + j] = (predicted[i, k + 1] - predicted[i, 0]) / z_at.STEPS[k]
            for axis in range(AXES):
                jacobian[i, z_at.BIAS + axis] = 1.0 if i == 4 + axis else 0.0


class Innovation(NamedTuple):
    """What a measurement tells of an entry of z."""

    entry: int
    value: float  # measured less predicted
    variance: float  # of it


@inlined
def _stays(entry: int) -> bool:
    """Tell whether an entry of z is a constant of which a motor that sticks tells nothing."""
    return z_at.LOGS.start <= entry < z_at.SIZE and entry != z_at.GIVING


@compiled
def _learn(mean: Floats, covariance: Floats, new: Innovation, sticks: bool, room: Room) -> None:
    """Correct mean and covariance by an innovation."""
    entry, innovation, variance = new
    row, gain = room.row, room.gain
    width = covariance.shape[1]
    for j in range(width):
        row[j] = covariance[entry, j]
    for i in range(len(mean)):
        gain[i] = 0.0 if sticks and _stays(i) else covariance[i, entry] / variance
        mean[i] += gain[i] * innovation
    for i in range(len(mean)):
        share, own = gain[i], row[i]
        if sticks and _stays(i):
            for j in range(width):
                covariance[i, j] -= own * gain[j]
        else:
            for j in range(width):
                covariance[i, j] -= share * row[j]


@compiled
def _write_half(jacobian: Floats, covariance: Floats, half: Floats) -> None:
    """Write the product of Jacobian and covariance; its sums are in the order of their terms.

    Several terms of two rows at once, since a sum is read and written for each, and an entry of the covariance too.
    """
    rows, size = jacobian.shape
    width, whole = half.shape[1], size - size % _AT_ONCE
    for i in range(rows):
        for j in range(width):
            half[i, j] = 0.0
    for m in range(0, whole, _AT_ONCE):
        for i in range(0, rows, 2):
            f0, f1, f2, f3, f4 = _five(jacobian[i], m)
            g0, g1, g2, g3, g4 = _five(jacobian[i + 1], m)
            for j in range(width):
                c0, c1, c2 = covariance[m, j], covariance[m + 1, j], covariance[m + 2, j]
                c3, c4 = covariance[m + 3, j], covariance[m + 4, j]
                half[i, j] = half[i, j] + f0 * c0 + f1 * c1 + f2 * c2 + f3 * c3 + f4 * c4
                half[i + 1, j] = half[i + 1, j] + g0 * c0 + g1 * c1 + g2 * c2 + g3 * c3 + g4 * c4
    for m in range(whole, size):
        for i in range(rows):
            f0 = jacobian[i, m]
            for j in range(width):
                half[i, j] += f0 * covariance[m, j]


@inlined
def _five(row: Floats, m: int) -> tuple[float, float, float, float, float]:
    return row[m], row[m + 1], row[m + 2], row[m + 3], row[m + 4]


@compiled
def _propagate(covariance: Floats, decay: float, room: Room) -> None:
    """Turn a covariance into that before the measurement: F P F' + Q.

    F is the unit matrix but for its rows of x, of the accelerometer's readings, which come last, and of d; Q is of x
    and of the readings alone: `Room.noise`. The rows and columns of the readings are written.
    """
    jacobian, half, noise = room.jacobian, room.half, room.noise
    rows, size = jacobian.shape
    _write_half(jacobian, covariance, half)
    for i in range(rows):
        to = i if i < 4 else size + i - 4
        for j in range(0, rows, 2):  # two at once, since each sum waits for itself
            first = noise[0, i] * noise[0, j] + noise[1, i] * noise[1, j]
            second = noise[0, i] * noise[0, j + 1] + noise[1, i] * noise[1, j + 1]
            for m in range(size):
                first += half[i, m] * jacobian[j, m]
                second += half[i, m] * jacobian[j + 1, m]
            covariance[to, j if j < 4 else size + j - 4] = first
            covariance[to, j + 1 if j < 3 else size + j - 3] = second
        for j in range(4, size):
            covariance[to, j] = covariance[j, to] = half[i, j]
    for i in range(size + rows - 4):
        covariance[i, z_at.DISTURBANCE] *= decay
    for j in range(size + rows - 4):
        covariance[z_at.DISTURBANCE, j] *= decay


@compiled
def _write_noise(design: Design, surprise: float, predicted: Floats, sticks: bool, noise: Floats) -> None:
    """Write what deviations of torque and torsional acceleration do to x and to the readings, shape (2, rows)."""
    doubtful = design.doubtful / (1 + (predicted[1, 0] / design.slow) ** 2)
    torque = (design.torque + doubtful) * max(surprise, 1.0) * (design.sticking if sticks else 1.0)
    row, weight = place(predicted[0, 0] / design.nominal.row[COLUMN.gear_ratio])
    for i in range(4):
        by_torque = between(design.by_noise[row, 0, i], design.by_noise[row + 1, 0, i], weight)
        by_acceleration = between(design.by_noise[row, 1, i], design.by_noise[row + 1, 1, i], weight)
        noise[0, i], noise[1, i] = torque * by_torque, design.acceleration * by_acceleration
    for axis in range(4, noise.shape[1]):
        noise[0, axis] = noise[1, axis] = 0.0
        for i in range(4):
            after = predicted.shape[1] - 4 + i
            slope = (predicted[axis, after] - predicted[axis, 0]) / z_at.STEPS[i]
            noise[0, axis] += slope * noise[0, i]
            noise[1, axis] += slope * noise[1, i]


@compiled
def begin_track(design: Design, tracks: Tracks, arm: int, angle: float, resolution: float) -> None:
    """Write the filter of a nominal arm at rest at a motor angle, measured with a resolution [rad], but for `holds`."""
    z, covariance, size = tracks.mean[arm], tracks.covariance[arm], len(design.mean)
    z[:size] = design.mean
    covariance[:size, :size] = design.covariance
    z[0] = angle
    deviation = resolution / _ROUNDING
    covariance[0, 0] = deviation * deviation
    tracks.surprise[arm] = tracks.noise_factor[arm] = 1.0
    tracks.without_part[arm, 0], tracks.without_part[arm, 1] = design.arm_swing, design.arm_variance
    if not tracks.holds[arm]:
        z[_SWING], covariance[_SWING, _SWING] = design.arm_swing, design.arm_variance


@compiled
def change_part(design: Design, tracks: Tracks, arm: int, holds: bool) -> None:
    """Open what is known of ln S where a part is placed or picked, or placed and another picked.

    `holds` says whether the gripper holds a part from now on.
    """
    z, covariance, without_part = tracks.mean[arm], tracks.covariance[arm], tracks.without_part[arm]
    if tracks.holds[arm]:
        for i in range(len(design.mean)):
            covariance[i, _SWING] = covariance[_SWING, i] = 0.0
        z[_SWING], covariance[_SWING, _SWING] = without_part[0], without_part[1]
    else:
        without_part[0], without_part[1] = z[_SWING], covariance[_SWING, _SWING]
    if holds:
        added = design.part * exponential(-z[_SWING])  # 4 l^2 m / S_arm
        for i in range(len(design.mean)):
            covariance[i, _SWING] /= 1 + added
        for i in range(len(design.mean)):
            covariance[_SWING, i] /= 1 + added
        deviation = added / (1 + added) * (design.part_deviation / design.part)
        covariance[_SWING, _SWING] += deviation * deviation
        z[_SWING] += _logarithm(1 + added)
    tracks.holds[arm] = holds


@inlined
def _logarithm(x: float) -> float:
    """Natural logarithm of a number from 1 to 100, by Halley's iteration: of the same bits on all processors."""
    y = 1.0
    for _ in range(6):
        power = exponential(y)
        y += 2 * (x - power) / (x + power)
    return y


@compiled
def _watch(design: Design, tracks: Tracks, arm: int, noise_factor: float, measured: float) -> None:
    """Keep z within its bounds; where a filter is lost, let it begin with the nominal constants again, less sure."""
    z, covariance = tracks.mean[arm], tracks.covariance[arm]
    known = True
    for i in range(4):
        known = known and abs(z[i]) <= z_at.HIGHEST[i] and covariance[i, i] <= z_at.HIGHEST[i] * z_at.HIGHEST[i]
    if not known:
        z[0], z[1], z[2], z[3] = measured, 0.0, 0.0, 0.0
    for i in range(len(design.mean)):
        z[i] = min(max(z[i], z_at.LOWEST[i]), z_at.HIGHEST[i])
    noise_factor = _DEAF if tracks.noise_factor[arm] >= _DEAF else max(noise_factor, 1.0)
    mistrusted = _MISTRUSTED < noise_factor < _DEAF
    if mistrusted or not known or tracks.surprise[arm] > _LOST:
        angle, speed, torsion, torsion_speed = z[0], z[1], z[2], z[3]
        begin_track(design, tracks, arm, angle, 0.0)
        z[1], z[2], z[3] = speed, torsion, torsion_speed
        for i in range(4):
            covariance[i, i] = _LESS_SURE[i]
    tracks.noise_factor[arm] = _DEAF if mistrusted else noise_factor


@compiled
def correct(design: Design, tracks: Tracks, arm: int, seen: Inputs, sticks: bool, room: Room) -> None:
    """Correct one filter by its measurement, once its arm has been simulated into `room`.

    Args:
        design: Of the filters.
        tracks: Changed.
        arm: Which of them.
        seen: Measurements.
        sticks: Whether the motor does after the sample.
        room: With the encoders' resolutions, too; changed.
    """
    z, covariance, predicted = tracks.mean[arm], tracks.covariance[arm], room.predicted[arm]
    resolution = room.resolution[arm]
    measured, size, axes = seen.angle[arm], len(design.mean), len(z) - len(design.mean)
    _write_jacobian(predicted, room.simulation.shapes, arm, room.jacobian)
    _write_noise(design, tracks.surprise[arm], predicted, sticks, room.noise)
    _propagate(covariance, design.decay, room)
    z[:4] = predicted[:4, 0]
    for axis in range(axes):
        z[size + axis] = predicted[4 + axis, 0] + z[z_at.BIAS + axis]
    z[z_at.DISTURBANCE] *= design.decay
    for i in range(4, size):
        covariance[i, i] += design.growth[i]
    innovation, rounding = measured - z[0], resolution * resolution
    covariance[0, 0] += rounding / 120  # keeps the angle open to the encoder
    variance = covariance[0, 0] + rounding / 12
    noise_factor = tracks.noise_factor[arm]
    tracks.surprise[arm] += _WATCH * (innovation * innovation / variance - tracks.surprise[arm])
    _learn(z, covariance, Innovation(0, innovation, variance), sticks, room)
    for axis in range(axes):
        innovation = seen.acceleration[arm, axis] - z[size + axis]
        noise, mistrust = seen.acceleration_variance[arm, axis], tracks.noise_factor[arm]
        variance = covariance[size + axis, size + axis] + noise * (mistrust * mistrust)
        shock = min(innovation * innovation / variance, _SHOCK)
        noise_factor *= 1 + _WATCH * (shock - 1)
        _learn(z, covariance, Innovation(size + axis, innovation, variance), False, room)
    _watch(design, tracks, arm, noise_factor, measured)
