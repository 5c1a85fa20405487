"""Integration until a margin is used up: SciPy's DOP853 with the instant located on its interpolant."""

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.integrate import DOP853
from scipy.optimize import brentq, minimize_scalar

from beltarm_env.arrays import Floats

_LOOKS = 8
"""Times at which the margin is looked at within each step of the integrator."""


def integrate_until(
    rates: Callable[[float, Floats], list[float]],
    margin: Callable[[float, Floats], float] | None,
    start: float,
    end: float,
    y: Floats,
) -> tuple[float, Floats, bool]:
    """Integrate y' = rates(t, y) until margin(t, y) falls below zero, or to the end; return t, y, and whether it fell.

    Raises:
        ArithmeticError: If the integrator gives up.
    """
    solver = DOP853(rates, start, y, end, rtol=1e-12, atol=1e-13)  # pyright: ignore
    while solver.status == "running":
        message = solver.step()
        if solver.status == "failed":
            raise ArithmeticError(f"DOP853 at {solver.t} s: {message}")
        if margin is None:
            continue
        path: Any = solver.dense_output()
        left = lambda t, path=path: margin(t, path(t))  # noqa: E731
        times = np.linspace(float(solver.t_old), solver.t, _LOOKS + 1)  # pyright: ignore
        values = [margin(t, y) for t, y in zip(times.tolist(), path(times).T, strict=True)]
        crossing = first_crossing(left, times, values)
        if crossing is not None:
            return crossing, path(crossing), True
    return end, solver.y, False


def first_crossing(function: Callable[[float], float], times: Floats, values: list[float]) -> float | None:
    """Locate the first time at which a function, of some values at some times, falls below zero; None if it does not.

    Between the times it may also dip below zero and come back: wherever it comes so close to zero that a parabola
    through three neighbours could, its minimum is looked for.

    A function that begins at zero may rise from there. If it is below zero already at the next time, that time is
    returned: it rose less than can be seen.
    """
    last = len(values) - 1
    for k in range(last + 1):
        before, after = max(k - 1, 0), min(k + 1, last)
        if k > 0 and values[k] < 0:
            return _root(function, times[k - 1], times[k]) if values[k - 1] > 0 else float(times[k])
        middle = min(max(k, 1), last - 1)
        bend = abs(values[middle - 1] - 2 * values[middle] + values[middle + 1])
        if 0 < values[k] <= min(values[before], values[after]) and values[k] < bend:
            dip: Any = minimize_scalar(
                function, bounds=(times[before], times[after]), method="bounded", options={"xatol": 1e-13}
            )
            if dip.fun < 0:
                return _root(function, times[before], dip.x) if values[before] > 0 else float(dip.x)
    return None


def _root(function: Callable[[float], float], low: float, high: float) -> float:
    return float(brentq(function, low, high, xtol=1e-18, rtol=1e-15))  # pyright: ignore
