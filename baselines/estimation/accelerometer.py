"""What an accelerometer on the arm's end tells a filter: its measurement equation.

The sensor low-passes, from one reading a[k] to the next by the factor lambda (`beltarm_env.task.accelerometer`). Known,
the low-pass is undone without a state of its own:

    m[k] = (a[k] - lambda a[k-1]) / (1 - lambda) = R[k] (v[k] - v[k-1]) / T + b + n

where v is the velocity of the end (`beltarm_env.physics.kinematics`), R turns it into the hand's axes, b is the zero-g
output and n white noise but for a correlation of lambda / (1 + lambda^2) = 0.09 with its neighbours. Left out: between
two samples the hand turns by about a milliradian. m is a function of the states at both ends of a sample, those that
a filter's prediction begins and ends with.
"""

from __future__ import annotations

import numpy as np

from beltarm_env.arm import Plant
from beltarm_env.arrays import Floats
from beltarm_env.engine import inlined
from beltarm_env.physics.drive import Drive
from beltarm_env.physics.kinematics import TipMotion, tip_motion
from beltarm_env.physics.state import ArmState
from beltarm_env.task.accelerometer import DECAY, NOISE, RANGE, along_and_across
from beltarm_env.timing import CONTROL_PERIOD

AXES = 2
"""Readings of a sample: along the hand and across it."""
SPREAD = NOISE * float(np.hypot(1.0, DECAY)) / (1 - DECAY)
"""Standard deviation of n [m/s^2]."""
_CUT = 0.99 * RANGE  # a reading beyond it tells no acceleration


@inlined
def mean_acceleration(before: TipMotion, x: ArmState, plant: Plant, drive: Drive | None) -> tuple[float, float]:
    """Return R (v - v_before) / T [m/s^2], along and across the hand, for a sample that ends with the state x."""
    tip = tip_motion(x, plant, drive)
    x_rate = (tip.x_speed - before.x_speed) * (1 / CONTROL_PERIOD)
    y_rate = (tip.y_speed - before.y_speed) * (1 / CONTROL_PERIOD)
    return along_and_across(x_rate, y_rate, tip)


def unfiltered(now: Floats, before: Floats) -> tuple[Floats, Floats]:
    """Undo the sensor's low-pass.

    Args:
        now: Readings a[k] [m/s^2], shape (n, AXES).
        before: Those of a sample before.

    Returns:
        m[k] [m/s^2] and the variances of its noise, both of shape (n, AXES); one that is cut off tells nothing.
    """
    cut = np.maximum(np.abs(now), np.abs(before)) > _CUT
    return (now - DECAY * before) / (1 - DECAY), np.where(cut, 1e6, SPREAD**2)
