"""Motions of the joint whose speed is a sum of ramps: references other than the task's own.

A ramp gains `speed` between `onset` and `onset + time`, linearly or as 3u^2 - 2u^3, and keeps it. The task's trapezoid
is one ramp up and one down, an S-curve has smooth ramps, and a shaped move several up and several down.
"""

from __future__ import annotations

from typing import NamedTuple

from baselines.reading import Sample
from beltarm_env import CONTROL_PERIOD
from beltarm_env.arrays import Floats
from beltarm_env.engine import compiled, inlined
from beltarm_env.task.reference import TRAPEZOID, MoveShape, Reference, linear_ramp, reference_at, smooth_ramp


class Ramps(NamedTuple):
    """Ramps of one arm; arrays of shape (most,), of which the first few count."""

    onset: Floats  # [s] from the move's start
    time: Floats  # [s]
    speed: Floats  # gained [rad/s]


@compiled
def motion_at(ramps: Ramps, count: int, smooth: bool, start: float, time: float) -> Reference:
    """Motion at `time` [s] of an arm at rest at `start` [rad] before its ramps.

    Where the acceleration jumps, it is the one after the jump.
    """
    angle, speed, acceleration = start, 0.0, 0.0
    for k in range(count):
        u = (time - ramps.onset[k]) / ramps.time[k]
        if smooth:
            area, height, slope = smooth_ramp(u)
        else:
            area, height, slope = linear_ramp(u)
        angle += ramps.speed[k] * ramps.time[k] * area
        speed += ramps.speed[k] * height
        acceleration += ramps.speed[k] / ramps.time[k] * slope
    return Reference(angle, speed, acceleration)


@inlined
def move_of(now: Sample) -> MoveShape:
    """The move that one arm is on."""
    return MoveShape(now.start, now.goal, now.duration, now.ramp_time)


@inlined
def task_motion(now: Sample, lead: float) -> Reference:
    """Motion of the task's trapezoid, `lead` seconds after this sample."""
    return reference_at(TRAPEZOID, move_of(now), CONTROL_PERIOD * now.step + lead)
