"""Sine, cosine, angle and exponential, written out in additions, multiplications and divisions.

So loops over arms vectorise, and a result does not depend on whose maths library is at hand: those of two machines
differ in the last digit, and the last digit of a torque can decide whether a motor sticks.
"""

from __future__ import annotations

import math

from beltarm_env.engine import inlined
from beltarm_env.engine.translation.numbers import ROUNDER

_TURN = 2 * math.pi
_LN2_HIGH, _LN2_LOW = 0.693359375, -0.00021219444005469057  # their sum is ln 2; the first times a whole number is exact
_TERMS = 14  # of the exponential's series, for |x| < ln(2) / 2
_HIGHEST_POWER = 10  # binary digits of the power of two in a float64's exponent


@inlined
def wrapped(angle: float) -> float:
    """Return the angle less whole turns, within -pi and pi [rad]."""
    turns = angle * (1 / _TURN)
    return angle - _TURN * ((turns + ROUNDER) - ROUNDER)


@inlined
def sin_cos(angle: float) -> tuple[float, float]:
    """Return sine and cosine from Taylor series of the half angle; error below 1e-15 up to 2 rad, the workspace.

    Written out because a call into the maths library would keep the loop over arms from being vectorised, and because
    its result may differ between the scalar and the vector variant of such a library. Terms are summed in groups
    (Estrin), which do not wait for each other.
    """
    half = 0.5 * angle
    z = half * half
    z2 = z * z
    z4 = z2 * z2
    s0 = (1 - z * (1 / 6)) + z2 * (1 / 120 - z * (1 / 5040))
    s1 = (1 / 362880 - z * (1 / 39916800)) + z2 * (1 / 6227020800 - z * (1 / 1307674368000))
    s2 = 1 / 355687428096000
    c0 = (1 - z * (1 / 2)) + z2 * (1 / 24 - z * (1 / 720))
    c1 = (1 / 40320 - z * (1 / 3628800)) + z2 * (1 / 479001600 - z * (1 / 87178291200))
    c2 = 1 / 20922789888000
    sine = half * (s0 + z4 * (s1 + z4 * s2))
    cosine = c0 + z4 * (c1 + z4 * c2)
    return 2 * sine * cosine, 1 - 2 * sine * sine


@inlined
def short_sin_cos(angle: float) -> tuple[float, float]:
    """Return sine and cosine up to 0.5 rad; error below 1e-7."""
    z = angle * angle
    sine = angle * ((1 - z * (1 / 6)) + z * z * (1 / 120 - z * (1 / 5040)))
    return sine, (1 - z * (1 / 2)) + z * z * (1 / 24 - z * (1 / 720))


@inlined
def turn_sin_cos(angle: float) -> tuple[float, float]:
    """Return sine and cosine up to 1.7 rad; error below 3e-9."""
    z = angle * angle
    z2 = z * z
    z4 = z2 * z2
    s0 = (1 - z * (1 / 6)) + z2 * (1 / 120 - z * (1 / 5040))
    s1 = (1 / 362880 - z * (1 / 39916800)) + z2 * (1 / 6227020800)
    c0 = (1 - z * (1 / 2)) + z2 * (1 / 24 - z * (1 / 720))
    c1 = (1 / 40320 - z * (1 / 3628800)) + z2 * (1 / 479001600 - z * (1 / 87178291200))
    return angle * (s0 + z4 * s1), c0 + z4 * c1


@inlined
def sine_cosine(angle: float) -> tuple[float, float]:
    """Return sine and cosine of any angle up to 1e6 rad; error below 1e-15 but for the rounding of whole turns."""
    sine, cosine = sin_cos(0.5 * wrapped(angle))
    return 2 * sine * cosine, 1 - 2 * sine * sine


@inlined
def polar_angle(x: float, y: float) -> float:
    """Return the angle of the point (x, y), from 0 to 2 pi [rad]; 0 of the origin.

    The tangent in the first eighth of the turn is brought below 0.2 by half-angle formulas, for a short series.
    """
    long, short = max(abs(x), abs(y)), min(abs(x), abs(y))
    t = short / long if long > 0.0 else 0.0
    t = t / (1 + math.sqrt(1 + t * t))
    t = t / (1 + math.sqrt(1 + t * t))
    z, total = t * t, 0.0
    for k in range(_TERMS, -1, -1):
        total = 1 / (2.0 * k + 1) - z * total
    angle = 4 * t * total
    angle = 0.25 * _TURN - angle if abs(y) > abs(x) else angle
    angle = 0.5 * _TURN - angle if x < 0.0 else angle
    return _TURN - angle if y < 0.0 else angle


@inlined
def exponential(x: float) -> float:
    """Return e^x; relative error below 1e-15 for |x| up to 700, beyond which it is that of 700."""
    x = min(max(x, -700.0), 700.0)
    turns = (x * (1 / (_LN2_HIGH + _LN2_LOW)) + ROUNDER) - ROUNDER
    rest = (x - turns * _LN2_HIGH) - turns * _LN2_LOW
    total = 1.0
    for k in range(_TERMS, 0, -1):
        total = 1 + rest * total / k
    power, left = 2.0 if turns > 0.0 else 0.5, abs(turns)
    for _ in range(_HIGHEST_POWER):
        half = (0.5 * left - 0.25 + ROUNDER) - ROUNDER  # rounded down
        total = total * power if left > 2.0 * half else total
        power, left = power * power, half
    return total
