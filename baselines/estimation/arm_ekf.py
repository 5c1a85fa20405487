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

Where the motor sticks, as behind a dead encoder, innovations say nothing of the torsion, and w stays. So where an entry
of x leaves its bounds, or its standard deviation exceeds them, x is not known any more, and the filter begins anew with
an arm at rest at the measured angle.

What an accelerometer feels depends on x at both ends of the sample (`baselines.estimation.felt`). So it is predicted
with x, as two more entries that last for one sample: their rows of F and Q follow from the same simulations, and
correct what stood before by their covariance with it. These innovations are watched too: the readings count as W times
as noisy as the data sheet says,

    W <- max(1, W (1 + 0.05 (min(nu^2 / S, 10) - 1)))

for each reading, so that nu^2 / S is 1 in the mean or below. Where W > 100, what is felt is not this arm's: the filter
begins anew with the nominal constants, and does not listen to the accelerometer any more in this episode.
"""

from __future__ import annotations

from baselines.estimation.believed_arm import (
    BIAS,
    DIFFERENCED,
    DISTURBANCE,
    ERROR_SINE,
    HIGHEST,
    LOWEST,
    ORDERS,
    RIPPLE,
    SIZE,
    STEPS,
)
from baselines.estimation.believed_motion import simulate
from baselines.estimation.felt import AXES
from baselines.estimation.filter_design import Design, Inputs, Room, Tracks
from baselines.models.linear import between, place
from beltarm_env.arm import COLUMN
from beltarm_env.arrays import Floats
from beltarm_env.jit import compiled
from beltarm_env.kernels.layout import LANES

_SLIDES = 2  # counts that a motor at rest cannot move by
_LOOSE = 1e-2  # torque noise that lets a simulated motor go [N m]
_WATCH = 0.05  # share of the last innovation in w
_LOST = 8.0  # of w
_SHOCK = 10.0  # most of nu^2 / S that counts in one reading of the accelerometer
_MISTRUSTED = 100.0  # of W
_DEAF = 1e6  # W of an accelerometer that is not listened to
_ROUNDING = 12**0.5  # resolution over the standard deviation of rounding to it
_LESS_SURE = (1e-4, 1.0, 1e-4, 0.09)  # variances of x of a filter that begins anew
_AT_ONCE = 5  # rows of the covariance


@compiled
def _write_jacobian(predicted: Floats, shapes: Floats, arm: int, jacobian: Floats) -> None:
    """Write the derivatives by z of x after a sample and of what is felt over it, see `_propagate`.

    Args:
        predicted: As `simulate` writes it, of one arm.
        shapes: Of the ripple, as `simulate` leaves them.
        arm: Which of them.
        jacobian: Shape (rows, size), written.
    """
    rows, size = jacobian.shape
    for i in range(rows):
        for j in range(DIFFERENCED):
            jacobian[i, j] = (predicted[i, j + 1] - predicted[i, 0]) / STEPS[j]
    for k in range(len(ORDERS)):
        sine, cosine = shapes[2 * k * LANES + arm], shapes[(2 * k + 1) * LANES + arm]
        for i in range(rows):
            jacobian[i, RIPPLE.start + 2 * k] = jacobian[i, DISTURBANCE] * sine
            jacobian[i, RIPPLE.start + 2 * k + 1] = jacobian[i, DISTURBANCE] * cosine
    if size > SIZE:
        for i in range(rows):
            for j in range(2):
                k = DIFFERENCED + j
                jacobian[i, ERROR_SINE + j] = (predicted[i, k + 1] - predicted[i, 0]) / STEPS[k]
            for axis in range(AXES):
                jacobian[i, BIAS + axis] = 1.0 if i == 4 + axis else 0.0


@compiled
def _learn(mean: Floats, covariance: Floats, entry: int, innovation: float, variance: float, room: Room) -> None:
    """Correct mean and covariance by the innovation of one entry and its variance."""
    row, gain = room.row, room.gain
    for i in range(len(mean)):
        row[i] = covariance[entry, i]
        gain[i] = covariance[i, entry] / variance
        mean[i] += gain[i] * innovation
    for i in range(len(mean)):
        share = gain[i]
        for j in range(len(mean)):
            covariance[i, j] -= share * row[j]


@compiled
def _times_covariance(factors: Floats, covariance: Floats, product: Floats) -> None:
    """Write some rows times the covariance, of which they may be shorter; sums are in the order of their terms."""
    size = len(factors)
    for j in range(size):
        product[j] = 0.0
    whole = size - size % _AT_ONCE
    for m in range(0, whole, _AT_ONCE):  # several rows at once, since a sum is read and written for each
        f0, f1, f2, f3, f4 = factors[m], factors[m + 1], factors[m + 2], factors[m + 3], factors[m + 4]
        for j in range(size):
            total = product[j] + f0 * covariance[m, j] + f1 * covariance[m + 1, j] + f2 * covariance[m + 2, j]
            product[j] = total + f3 * covariance[m + 3, j] + f4 * covariance[m + 4, j]
    for m in range(whole, size):
        f0 = factors[m]
        for j in range(size):
            product[j] += f0 * covariance[m, j]


@compiled
def _propagate(covariance: Floats, kept: float, room: Room) -> None:
    """Turn a covariance into that before the measurement: F P F' + Q.

    F is the unit matrix but for its rows of x, of what is felt, which come last, and of d; Q is of x and of what is
    felt alone, from what torque and torsional acceleration do to them, each by its standard deviation: `Room.noise`.

    Args:
        covariance: With an accelerometer, there are AXES more rows and columns, which are written.
        kept: Share of d that is left.
        room: With noise and Jacobian; changed.
    """
    jacobian, half, noise = room.jacobian, room.half, room.noise
    rows, size = jacobian.shape
    for i in range(rows):
        _times_covariance(jacobian[i], covariance, half[i])
    for i in range(rows):
        to = i if i < 4 else size + i - 4
        for j in range(rows):
            total = noise[0, i] * noise[0, j] + noise[1, i] * noise[1, j]
            for m in range(size):
                total += half[i, m] * jacobian[j, m]
            covariance[to, j if j < 4 else size + j - 4] = total
        for j in range(4, size):
            covariance[to, j] = covariance[j, to] = half[i, j]
    for i in range(len(covariance)):
        covariance[i, DISTURBANCE] *= kept
        covariance[DISTURBANCE, i] *= kept


@compiled
def _write_noise(
    design: Design, surprise: float, predicted: Floats, measured: float, resolution: float, noise: Floats
) -> bool:
    """Write what the process noise does to x and to what is felt, and return whether the motor holds.

    Args:
        design: Of the filter.
        surprise: w.
        predicted: As `simulate` writes it, of one arm.
        measured: Motor angle [rad].
        resolution: Of the encoder [rad].
        noise: Shape (2, rows), written.
    """
    speed = predicted[1, 0]
    sticks = speed == 0.0
    holds = sticks and abs(measured - predicted[0, 0]) <= _SLIDES * resolution
    doubtful = design.doubtful / (1 + (speed / design.slow) ** 2)
    sliding = (design.torque + doubtful) * max(surprise, 1.0)
    torque = (0.0 if holds else _LOOSE) if sticks else sliding
    row, weight = place(predicted[0, 0] / design.nominal[COLUMN.gear_ratio])
    for i in range(4):
        by_torque = between(design.by_noise[row, 0, i], design.by_noise[row + 1, 0, i], weight)
        by_acceleration = between(design.by_noise[row, 1, i], design.by_noise[row + 1, 1, i], weight)
        noise[0, i], noise[1, i] = torque * by_torque, design.acceleration * by_acceleration
    for axis in range(4, noise.shape[1]):
        noise[0, axis] = noise[1, axis] = 0.0
        for i in range(4):
            after = predicted.shape[1] - 4 + i
            slope = (predicted[axis, after] - predicted[axis, 0]) / STEPS[i]
            noise[0, axis] += slope * noise[0, i]
            noise[1, axis] += slope * noise[1, i]
    return holds


@compiled
def begin_track(design: Design, tracks: Tracks, arm: int, angle: float, resolution: float) -> None:
    """Write the filter of a nominal arm at rest at a motor angle, measured with a resolution [rad]."""
    z, covariance, size = tracks.mean[arm], tracks.covariance[arm], len(design.mean)
    for i in range(size):
        z[i] = design.mean[i]
        for j in range(size):
            covariance[i, j] = design.covariance[i, j]
    z[0] = angle
    deviation = resolution / _ROUNDING
    covariance[0, 0] = deviation * deviation
    tracks.surprise[arm] = tracks.unrest[arm] = 1.0


@compiled
def _watch(design: Design, tracks: Tracks, arm: int, unrest: float, measured: float) -> None:
    """Keep z within its bounds; where a filter is lost, let it begin with the nominal constants again, less sure."""
    z, covariance = tracks.mean[arm], tracks.covariance[arm]
    known = True
    for i in range(4):
        known = known and abs(z[i]) <= HIGHEST[i] and covariance[i, i] <= HIGHEST[i] * HIGHEST[i]
    if not known:
        z[0], z[1], z[2], z[3] = measured, 0.0, 0.0, 0.0
    for i in range(len(design.mean)):
        z[i] = min(max(z[i], LOWEST[i]), HIGHEST[i])
    unrest = _DEAF if tracks.unrest[arm] >= _DEAF else max(unrest, 1.0)
    mistrusted = _MISTRUSTED < unrest < _DEAF
    if mistrusted or not known or tracks.surprise[arm] > _LOST:
        angle, speed, torsion, torsion_speed = z[0], z[1], z[2], z[3]
        begin_track(design, tracks, arm, angle, 0.0)
        z[1], z[2], z[3] = speed, torsion, torsion_speed
        for i in range(4):
            covariance[i, i] = _LESS_SURE[i]
    tracks.unrest[arm] = _DEAF if mistrusted else unrest


@compiled
def _correct(design: Design, tracks: Tracks, arm: int, seen: Inputs, resolution: float, room: Room) -> None:
    """Correct one filter by its measurement, once its arm has been simulated."""
    z, covariance, predicted = tracks.mean[arm], tracks.covariance[arm], room.predicted[arm]
    measured, size, axes = seen.angle[arm], len(design.mean), len(z) - len(design.mean)
    _write_jacobian(predicted, room.simulation.shapes, arm, room.jacobian)
    holds = _write_noise(design, tracks.surprise[arm], predicted, measured, resolution, room.noise)
    _propagate(covariance, design.kept, room)
    for i in range(4):
        z[i] = predicted[i, 0]
    for axis in range(axes):
        z[size + axis] = predicted[4 + axis, 0] + z[BIAS + axis]
    z[DISTURBANCE] *= design.kept
    for i in range(4, size):
        covariance[i, i] += design.growth[i]
    innovation, rounding = measured - z[0], resolution * resolution
    covariance[0, 0] += rounding / 120  # keeps the angle open to the encoder
    variance = covariance[0, 0] + rounding / 12
    unrest = tracks.unrest[arm]
    if not holds:
        tracks.surprise[arm] += _WATCH * (innovation * innovation / variance - tracks.surprise[arm])
    _learn(z, covariance, 0, innovation, variance, room)
    for axis in range(axes):
        innovation = seen.felt[arm, axis] - z[size + axis]
        noise, mistrust = seen.felt_variance[arm, axis], tracks.unrest[arm]
        variance = covariance[size + axis, size + axis] + noise * (mistrust * mistrust)
        shock = min(innovation * innovation / variance, _SHOCK)
        unrest *= 1 + _WATCH * (shock - 1)
        _learn(z, covariance, size + axis, innovation, variance, room)
    if holds:
        z[1] = 0.0
    _watch(design, tracks, arm, unrest, measured)


@compiled
def step(design: Design, tracks: Tracks, commands: Floats, seen: Inputs, resolution: Floats, room: Room) -> None:
    """Predict over one sample and correct by its measurement.

    Args:
        design: Of the filters.
        tracks: The filters of up to `ARMS` arms; changed. With an accelerometer, z and its covariance have room for
            AXES more entries.
        commands: Up to this sample, latest first [N m], shape (arms, HISTORY).
        seen: Measurements.
        resolution: Of the encoder [rad], shape (arms,).
        room: Changed.
    """
    simulate(tracks.mean, design.nominal, commands, room.simulation, room.predicted)
    for arm in range(len(tracks.surprise)):
        _correct(design, tracks, arm, seen, resolution[arm], room)
