"""Metrics of an episode, all against the unshaped task reference, from the recorded motion of the tip.

Arrays have time as first axis: row k is the sample after step k + 1, at (k + 1) control periods.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from beltarm_env.arrays import Flags, Floats
from beltarm_env.engine import compiled
from beltarm_env.task.cost import STILL_BAND, still_time
from beltarm_env.timing import CONTROL_PERIOD, EPISODE_TIME

SETTLING_BAND = 0.001
"""Both coordinates of the tip error must stay within +- this for the arm to have settled [m]."""
ARRIVAL_BOUND = 0.015
"""Mean error of the tip after the move, in which vibration averages out, up to which an arm has arrived [m].

The shortest moves, 15 degrees from an end of the workspace, take the tip 17 mm far: an arm that stays never arrives."""
REVERSAL_SWING = 0.1
"""Swing of the torque through zero that counts as a reversal, over the torque limit."""


class Metric(NamedTuple):
    """How a metric is shown."""

    title: str
    unit: str = ""
    digits: int = 1  # after the point
    share: bool = False  # of episodes or samples: averaged plainly, and shown in per cent
    detail: bool = False  # a part of another metric: recorded for every episode, not shown


METRICS = {
    "tip_rms_mm": Metric("tip RMS", "mm"),
    "tip_max_mm": Metric("tip max", "mm"),
    "residual_pp_mm": Metric("residual p-p", "mm"),
    "residual_radial_pp_mm": Metric("residual p-p, radial", "mm", detail=True),
    "residual_lateral_pp_mm": Metric("residual p-p, lateral", "mm", detail=True),
    "tip_acc_rms": Metric("tip acc. RMS", "m/s²", digits=2),
    "settling_s": Metric("settling", "s", digits=2),
    "still_s": Metric("time until still", "s", digits=3),
    "failure_share": Metric("not settled", "%", digits=0, share=True),
    "not_arrived_share": Metric("not arrived", "%", digits=0, share=True),
    "torque_rms": Metric("torque RMS", "N m", digits=3),
    "torque_rate_rms": Metric("torque rate", "N m/s"),
    "torque_reversals_hz": Metric("reversals", "1/s"),
    "saturated_share": Metric("saturated", "%", digits=0, share=True),
    "cost": Metric("cost", digits=0),
}
"""All metrics of an episode, by name, in the order in which they are shown; lower is better in every one."""
SHOWN = tuple(name for name, metric in METRICS.items() if not metric.detail)
TORQUE_QUALITY = ("torque_rate_rms", "torque_reversals_hz", "saturated_share")
"""What tells a method that wins by hammering: columns of every table that compares methods."""
TORQUES = ("torque_rms", *TORQUE_QUALITY)
"""What a motor has to follow."""
NOT_ARRIVED = "not_arrived_share"
OF_ARRIVED = ("residual_pp_mm", "residual_radial_pp_mm", "residual_lateral_pp_mm", "settling_s", *TORQUES)
"""Metrics that say something of arms that have arrived alone: one that never moves is at rest, with no effort."""


def heading(name: str) -> str:
    """Return a metric's title with its unit."""
    metric = METRICS[name]
    return f"{metric.title} ({metric.unit})" if metric.unit else metric.title


class Episodes(NamedTuple):
    """What the metrics of n episodes of T steps are computed from."""

    tip_error: Floats  # tip minus reference tip, radial (x) and lateral (y) [m], shape (T, n, 2)
    tip_velocity_error: Floats  # the same for the velocity [m/s], shape (T, n, 2)
    torque: Floats  # commanded [N m], shape (T, n)
    torque_limit: Floats  # [N m], shape (n,)
    move_duration: Floats  # [s], shape (n,)
    cost: Floats  # of the whole episode, shape (n,)
    finished: Flags  # False where the arm left the workspace, which counts as a failure; shape (n,)
    torque_before: Floats | float = 0.0  # commanded before the first step [N m], shape (n,)


def episode_metrics(episodes: Episodes) -> dict[str, Floats]:
    """Compute the metrics of n episodes.

    Returns:
        For each of `METRICS` an array of shape (n,): RMS and largest distance of the tip from its reference (mm);
        peak-to-peak residual vibration, its radial and lateral part, and both together (mm); RMS error of the tip's
        acceleration (m/s^2); settling time (s); time from the move's end until the tip stays within 0.5 mm of its
        reference, or what is left of the move (s); failure (0 or 1); whether it did not arrive (0 or 1); RMS torque
        (N m) and torque rate (N m/s); reversals of the torque per second; share of samples at the torque limit; cost.
    """
    tip_error, tip_velocity_error, torque, torque_limit, move_duration, cost, finished, torque_before = episodes
    distance = np.linalg.norm(tip_error, axis=2)
    acceleration_error = np.diff(tip_velocity_error, axis=0) / CONTROL_PERIOD
    residual = 1000 * residual_vibration(tip_error, move_duration)
    settling = settling_time(tip_error)
    failed = ~finished | np.isinf(settling)
    before = np.broadcast_to(torque_before, (1, torque.shape[1]))
    torque_rate = np.diff(torque, axis=0, prepend=before) / CONTROL_PERIOD
    last = len(distance) - np.argmax(distance[::-1] > STILL_BAND, axis=0)  # step after which it was last away
    unstill = np.where((distance > STILL_BAND).any(axis=0), last, 0)
    return {
        "tip_rms_mm": 1000 * np.sqrt(_mean(distance**2)),
        "tip_max_mm": 1000 * distance.max(axis=0),
        "residual_pp_mm": np.hypot(residual[:, 0], residual[:, 1]),
        "residual_radial_pp_mm": residual[:, 0],
        "residual_lateral_pp_mm": residual[:, 1],
        "tip_acc_rms": np.sqrt(_mean(np.sum(acceleration_error**2, axis=2))),
        "settling_s": np.where(failed, EPISODE_TIME, settling),
        "still_s": np.array([still_time(*each) for each in zip(unstill.tolist(), move_duration.tolist(), strict=True)]),
        "failure_share": failed.astype(np.float64),
        "not_arrived_share": (~finished | (mean_error(tip_error, move_duration) > ARRIVAL_BOUND)).astype(np.float64),
        "torque_rms": np.sqrt(_mean(torque**2)),
        "torque_rate_rms": np.sqrt(_mean(torque_rate**2)),
        "torque_reversals_hz": torque_reversals(torque, REVERSAL_SWING * torque_limit) / (len(torque) * CONTROL_PERIOD),
        "saturated_share": _mean(np.abs(torque) >= torque_limit * (1 - 1e-6)),
        "cost": cost,
    }


def _mean(values: Floats | Flags) -> Floats:
    """Average over time, shape (T, n); of each arm the same bits in any batch."""
    arms = values.shape[1]
    return np.mean(np.repeat(values, 2, axis=1) if arms == 1 else values, axis=0)[
        :arms
    ]  # one column is summed in pairs


def mean_error(tip_error: Floats, move_duration: Floats) -> Floats:
    """Compute the distance of the tip's mean error after the move from none [m].

    Args:
        tip_error: Shape (T, n, 2) [m].
        move_duration: Shape (n,) [s].

    Returns:
        Shape (n,).
    """
    time = _times(tip_error)
    result = np.empty(tip_error.shape[1])
    for arm, duration in enumerate(move_duration):
        result[arm] = np.linalg.norm(tip_error[time >= duration, arm].mean(axis=0))
    return result


def _times(tip_error: Floats) -> Floats:
    """Times of the samples since the move's start [s]."""
    return np.arange(1.0, len(tip_error) + 1) * np.float64(CONTROL_PERIOD)


def residual_vibration(tip_error: Floats, move_duration: Floats) -> Floats:
    """Compute the peak-to-peak motion of the tip after the move's end, less its straight-line trend.

    Belt torsion moves the tip along a line, so the two parts are in phase, and their hypotenuse is the peak-to-peak
    amplitude along that line.

    Args:
        tip_error: Shape (T, n, 2) [m].
        move_duration: Shape (n,) [s].

    Returns:
        Shape (n, 2) [m].
    """
    time = _times(tip_error)
    result = np.empty((tip_error.shape[1], 2))
    for arm, duration in enumerate(move_duration):
        after = time >= duration
        line = np.column_stack([np.ones(after.sum()), time[after] - duration])
        motion = tip_error[after, arm]
        trend, *_ = np.linalg.lstsq(line, motion, rcond=None)
        result[arm] = np.ptp((motion - line @ trend).T.copy(), axis=1)  # along contiguous rows, it takes a tenth
    return result


def settling_time(tip_error: Floats) -> Floats:
    """Compute the time from the move's start until the tip stays within the band for good [s]; inf for never.

    The band holds for both axes; an arm that never leaves it takes one sample. Shape (n,).
    """
    outside = np.any(np.abs(tip_error) > SETTLING_BAND, axis=2)
    steps = len(outside)
    last_outside = np.where(outside.any(axis=0), steps - 1 - np.argmax(outside[::-1], axis=0), -1)
    return np.where(last_outside == steps - 1, np.inf, (last_outside + 2) * CONTROL_PERIOD)


def torque_reversals(torque: Floats, swing: Floats) -> Floats:
    """Count the reversals of a torque: successive extremes on opposite sides of zero that differ by more than `swing`.

    With hysteresis: between two extremes the torque has no swing through zero of more than `swing`. So a torque that
    chatters about zero has no reversals, nor has one that comes back to zero, and a large swing counts once.

    Args:
        torque: Shape (T, n) [N m].
        swing: Shape (n,) [N m].

    Returns:
        Shape (n,).
    """
    counts = np.empty(len(swing))
    _count_reversals(np.ascontiguousarray(torque, np.float64), np.ascontiguousarray(swing, np.float64), counts)
    return counts


@compiled
def _count_reversals(torque: Floats, swing: Floats, counts: Floats) -> None:
    for arm in range(len(swing)):
        high, low, side, count = 0.0, 0.0, 0, 0  # largest and smallest torque, and its side, since the last one
        for k in range(len(torque)):
            now = torque[k, arm]
            high, low = max(high, now), min(low, now)
            if side >= 0 and now < 0 and high > 0 and high - now > swing[arm]:
                side, high, low, count = -1, 0.0, now, count + 1
            elif side <= 0 and now > 0 and low < 0 and now - low > swing[arm]:
                side, high, low, count = 1, now, 0.0, count + 1
        counts[arm] = count
