"""Cut of a number at a limit, for kernels: what is no number stays none, so that it is noticed."""

from __future__ import annotations

from beltarm_env.engine import inlined


@inlined
def cut(x: float, most: float) -> float:
    """Number between -most and most that is nearest to x."""
    above = -most if x < -most else x
    return most if above > most else above
