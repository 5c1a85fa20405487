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
    ripple_shape,
)
from baselines.estimation.believed_motion import simulate
from baselines.estimation.felt import AXES
from baselines.estimation.filter_design import Design, Room, Tracks
from baselines.models.linear import between, place
from beltarm_env.arm import COLUMN
from beltarm_env.arrays import Floats
from beltarm_env.jit import compiled

_SLIDES = 2  # counts that a motor at rest cannot move by
_LOOSE = 1e-2  # torque noise that lets a simulated motor go [N m]
_WATCH = 0.05  # share of the last innovation in w
_LOST = 8.0  # of w
_SHOCK = 10.0  # most of nu^2 / S that counts in one reading of the accelerometer
_MISTRUSTED = 100.0  # of W
_DEAF = 1e6  # W of an accelerometer that is not listened to
_ROUNDING = 12**0.5  # resolution over the standard deviation of rounding to it
_LESS_SURE = (1e-4, 1.0, 1e-4, 0.09)  # variances of x of a filter that begins anew


@compiled
def _write_jacobian(before: Floats, room: Room) -> None:
    """Write the derivatives by z, before it, of x after a sample and of what is felt over it, see `_propagate`."""
    jacobian, predicted = room.jacobian, room.predicted
    rows, size, count = jacobian.shape
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
            k = DIFFERENCED + j
            for i in range(rows):
                for arm in range(count):
                    jacobian[i, ERROR_SINE + j, arm] = (predicted[k + 1, i, arm] - predicted[0, i, arm]) / STEPS[k]
        for axis in range(AXES):
            for i in range(rows):
                for arm in range(count):
                    jacobian[i, BIAS + axis, arm] = 1.0 if i == 4 + axis else 0.0


@compiled
def _learn(tracks: Tracks, entry: int, room: Room) -> None:
    """Correct mean and covariance by the innovation of one entry and its variance."""
    mean, covariance, row, gain = tracks.mean, tracks.covariance, room.row, room.gain
    size, count = mean.shape
    for i in range(size):
        for arm in range(count):
            row[i, arm] = covariance[entry, i, arm]
            gain[i, arm] = covariance[i, entry, arm] / room.total[arm]
            mean[i, arm] += gain[i, arm] * room.innovation[arm]
    for i in range(size):
        for j in range(size):
            for arm in range(count):
                covariance[i, j, arm] = covariance[i, j, arm] - gain[i, arm] * row[j, arm]


@compiled
def _propagate(tracks: Tracks, kept: float, room: Room) -> None:
    """Turn a covariance into that before the measurement: F P F' + Q.

    F is the unit matrix but for its rows of x, of what is felt, which come last, and of d; Q is of x and of what is
    felt alone, from what torque and torsional acceleration do to them, each by its standard deviation: `Room.noise`.

    Args:
        tracks: With an accelerometer, there are AXES more rows and columns, which are written.
        kept: Share of d that is left.
        room: With the simulations; changed.
    """
    _write_jacobian(tracks.mean, room)
    covariance, jacobian, half, noise = tracks.covariance, room.jacobian, room.half, room.noise
    rows, size, count = jacobian.shape
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
                covariance[to, j if j < 4 else size + j - 4, arm] = total
        for j in range(4, size):
            for arm in range(count):
                covariance[to, j, arm] = covariance[j, to, arm] = half[i, j, arm]
    for i in range(len(covariance)):
        for arm in range(count):
            covariance[i, DISTURBANCE, arm] *= kept
            covariance[DISTURBANCE, i, arm] *= kept


@compiled
def _write_noise(design: Design, tracks: Tracks, measured: Floats, resolution: Floats, room: Room) -> None:
    """Write what the process noise does to x and to what is felt, and whether motors hold."""
    predicted, noise = room.predicted, room.noise
    rows = noise.shape[1]
    for arm in range(len(measured)):
        speed = predicted[0, 1, arm]
        sticks = speed == 0.0
        holds = sticks and abs(measured[arm] - predicted[0, 0, arm]) <= _SLIDES * resolution[arm]
        doubtful = design.doubtful / (1 + (speed / design.slow) ** 2)
        sliding = (design.torque + doubtful) * max(tracks.surprise[arm], 1.0)
        torque = (0.0 if holds else _LOOSE) if sticks else sliding
        room.holds[arm] = 1.0 if holds else 0.0
        row, weight = place(predicted[0, 0, arm] / design.nominal[COLUMN.gear_ratio])
        for i in range(4):
            by_torque = between(design.by_noise[row, 0, i], design.by_noise[row + 1, 0, i], weight)
            by_acceleration = between(design.by_noise[row, 1, i], design.by_noise[row + 1, 1, i], weight)
            noise[0, i, arm], noise[1, i, arm] = torque * by_torque, design.acceleration * by_acceleration
        for axis in range(4, rows):
            noise[0, axis, arm] = noise[1, axis, arm] = 0.0
            for i in range(4):
                after = len(predicted) - 4 + i
                slope = (predicted[after, axis, arm] - predicted[0, axis, arm]) / STEPS[i]
                noise[0, axis, arm] += slope * noise[0, i, arm]
                noise[1, axis, arm] += slope * noise[1, i, arm]


@compiled
def begin_track(design: Design, tracks: Tracks, arm: int, angle: float, resolution: float) -> None:
    """Write the filter of a nominal arm at rest at a motor angle, measured with a resolution [rad]."""
    size = len(design.mean)
    for i in range(size):
        tracks.mean[i, arm] = design.mean[i]
        for j in range(size):
            tracks.covariance[i, j, arm] = design.covariance[i, j]
    tracks.mean[0, arm] = angle
    deviation = resolution / _ROUNDING
    tracks.covariance[0, 0, arm] = deviation * deviation
    tracks.surprise[arm] = tracks.unrest[arm] = 1.0


@compiled
def _watch(design: Design, tracks: Tracks, room: Room) -> None:
    """Keep z within its bounds; where a filter is lost, let it begin with the nominal constants again, less sure."""
    for i in range(len(design.mean)):
        for arm in range(len(tracks.surprise)):
            tracks.mean[i, arm] = min(max(tracks.mean[i, arm], LOWEST[i]), HIGHEST[i])
    for arm in range(len(tracks.surprise)):
        unrest = _DEAF if tracks.unrest[arm] >= _DEAF else max(room.unrest[arm], 1.0)
        mistrusted = _MISTRUSTED < unrest < _DEAF
        if mistrusted or tracks.surprise[arm] > _LOST:
            angle, speed = tracks.mean[0, arm], tracks.mean[1, arm]
            torsion, torsion_speed = tracks.mean[2, arm], tracks.mean[3, arm]
            begin_track(design, tracks, arm, angle, 0.0)
            tracks.mean[1, arm], tracks.mean[2, arm], tracks.mean[3, arm] = speed, torsion, torsion_speed
            for i in range(4):
                tracks.covariance[i, i, arm] = _LESS_SURE[i]
        tracks.unrest[arm] = _DEAF if mistrusted else unrest


@compiled
def step(design: Design, tracks: Tracks, commands: Floats, measured: Floats, resolution: Floats, room: Room) -> None:
    """Predict over one sample and correct by its measurement.

    Args:
        design: Of the filters.
        tracks: The filters; changed. With an accelerometer, z and its covariance have room for AXES more entries.
        commands: Up to this sample, latest first [N m], shape (m, HISTORY).
        measured: Motor angle [rad], shape (m,).
        resolution: Of the encoder [rad], shape (m,).
        room: With what is felt; changed.
    """
    mean, covariance, innovation, total = tracks.mean, tracks.covariance, room.innovation, room.total
    predicted, size, axes = room.predicted, len(design.mean), len(mean) - len(design.mean)
    simulate(mean[:size], design.nominal, commands, room.simulation, predicted)
    _write_noise(design, tracks, measured, resolution, room)
    _propagate(tracks, design.kept, room)
    for arm in range(len(measured)):
        for i in range(4):
            mean[i, arm] = predicted[0, i, arm]
        for axis in range(axes):
            mean[size + axis, arm] = predicted[0, 4 + axis, arm] + mean[BIAS + axis, arm]
        mean[DISTURBANCE, arm] *= design.kept
        for i in range(4, size):
            covariance[i, i, arm] += design.growth[i]
        innovation[arm], rounding = measured[arm] - mean[0, arm], resolution[arm] * resolution[arm]
        covariance[0, 0, arm] += rounding / 120  # keeps the angle open to the encoder
        total[arm] = covariance[0, 0, arm] + rounding / 12
        room.unrest[arm] = tracks.unrest[arm]
        if room.holds[arm] == 0.0:
            tracks.surprise[arm] += _WATCH * (innovation[arm] * innovation[arm] / total[arm] - tracks.surprise[arm])
    _learn(tracks, 0, room)
    for axis in range(axes):
        for arm in range(len(measured)):
            innovation[arm] = room.felt[axis, arm] - mean[size + axis, arm]
            variance, unrest = room.felt_variance[axis, arm], tracks.unrest[arm]
            total[arm] = covariance[size + axis, size + axis, arm] + variance * (unrest * unrest)
            shock = min(innovation[arm] * innovation[arm] / total[arm], _SHOCK)
            room.unrest[arm] *= 1 + _WATCH * (shock - 1)
        _learn(tracks, size + axis, room)
    for arm in range(len(measured)):
        if room.holds[arm] == 1.0:
            mean[1, arm] = 0.0
    _watch(design, tracks, room)
