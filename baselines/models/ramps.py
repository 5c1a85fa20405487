"""Motions of the joint whose speed is a sum of ramps: references other than the task's own.

A ramp gains `speed` between `onset` and `onset + time`, linearly or as 3u^2 - 2u^3, and keeps it. The task's trapezoid
is one ramp up and one down, an S-curve has smooth ramps, and a shaped move several up and several down.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from baselines.models.rigid_arm import Motion
from baselines.reading import Reading
from beltarm_env import CONTROL_PERIOD
from beltarm_env.arrays import Floats


class Ramps(NamedTuple):
    """k ramps for each of n arms; arrays of shape (n, k)."""

    onset: Floats  # [s] from the move's start
    time: Floats  # [s]
    speed: Floats  # gained [rad/s]


def motion_at(ramps: Ramps, start: Floats, time: Floats, smooth: bool = False) -> Motion:
    """Motion at `time` [s] of arms at rest at `start` [rad] before their ramps, both of shape (n,).

    Where the acceleration jumps, it is the one after the jump.
    """
    u = (time[:, None] - ramps.onset) / ramps.time
    c = np.minimum(np.maximum(u, 0.0), 1.0)
    if smooth:
        area, height, slope = c * c * c * (1.0 - 0.5 * c), c * c * (3.0 - 2.0 * c), 6.0 * c * (1.0 - c)
    else:
        area, height, slope = 0.5 * c * c, c, (u >= 0.0) & (u < 1.0)
    beyond = np.maximum(u - 1.0, 0.0)
    return Motion(
        start + _total(ramps.speed * ramps.time * (area + beyond)),
        _total(ramps.speed * height),
        _total(ramps.speed / ramps.time * slope),
    )


def task_motion(now: Reading, lead: float = 0.0) -> Motion:
    """Motion of the task's trapezoid, `lead` seconds after this sample."""
    start, goal, duration, ramp = now.move.T
    cruise = (goal - start) / (duration - ramp)
    onsets = np.column_stack([np.zeros_like(ramp), duration - ramp])
    trapezoid = Ramps(onsets, np.column_stack([ramp, ramp]), np.column_stack([cruise, -cruise]))
    return motion_at(trapezoid, start, CONTROL_PERIOD * now.step.astype(np.float64) + lead)


def _total(columns: Floats) -> Floats:
    """Sum over the ramps, in an order that does not depend on the number of arms."""
    total = columns[:, 0]
    for k in range(1, columns.shape[1]):
        total = total + columns[:, k]
    return total
