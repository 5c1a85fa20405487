"""Sine and cosine, written out so that loops over arms vectorise."""

from __future__ import annotations

import math

from beltarm_env.jit import inlined

_TURN = 2 * math.pi
_ROUNDER = 1.5 * 2.0**52  # adding it pushes the fraction out of a float64


@inlined
def wrapped(angle: float) -> float:
    """Return the angle less whole turns, within -pi and pi [rad]."""
    turns = angle * (1 / _TURN)
    return angle - _TURN * ((turns + _ROUNDER) - _ROUNDER)


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
