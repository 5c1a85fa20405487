"""Encoder of the motor: counts, and speed by differencing.

The encoder counts `motor angle / resolution`, rounded to the nearest whole count (half a count either way, unbiased);
the motor speed is the difference of two successive counts over the control period, as in the paper's software servo.
An index pulse, one per turn, tells where in its turn the motor is.
"""

from __future__ import annotations

from beltarm_env.jit import inlined
from beltarm_env.physics.trigonometry import sin_cos
from beltarm_env.timing import CONTROL_PERIOD

ENCODER_COUNTS = 4000
"""Counts per motor revolution: 1000 pulses, four edges each."""

_ROUNDER = 1.5 * 2.0**52  # adding it pushes the fraction out of a float64
_PI = 3.141592653589793


@inlined
def to_counts(angle: float, resolution: float) -> float:
    """Return the nearest whole count for a motor angle [rad], resolution in rad per count; halves round to even.

    Exact for magnitudes below 2^51 counts. Addition and subtraction of one constant, instead of a call to round, keep
    the loop over arms vectorised.
    """
    return (angle / resolution + _ROUNDER) - _ROUNDER


@inlined
def speed_from_counts(now: float, before: float, resolution: float) -> float:
    """Return the motor speed [rad/s] by differencing two successive counts."""
    return (now - before) * resolution * (1 / CONTROL_PERIOD)


@inlined
def around_half_a_turn(angle: float) -> tuple[float, float]:
    """Return sine and cosine of twice a motor angle [rad]: where in its half turn the motor is; error below 1e-12.

    Whole periods are taken off first, because `sin_cos` is for small angles; so it is for angles of up to 1000 rad.
    """
    return sin_cos(2.0 * (angle - _PI * ((angle * (1 / _PI) + _ROUNDER) - _ROUNDER)))
