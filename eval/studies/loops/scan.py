"""Margins of a controller's loop over arms and angles, and its poles on the design model."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.loops.condition import CORNERS, margins_on
from baselines.loops.models import continuous
from baselines.models.linear import ANGLES
from beltarm_env.arrays import Floats

ARMS = tuple(CORNERS)
"""Arms that loops are looked at on; the first is the design model."""
NONE_LEFT = {"gain_up": 1.0, "gain_down": 1.0, "phase": 0.0, "delay": 0.0, "modulus": 0.0}
"""Margins by name, and their values for an unstable loop."""
SHOWN_ANGLES = (0, 45, 90)
"""Angles of the tables of each controller [degrees]."""
_MOST_POLES = 3  # of these tables
_PLANE = (-62.0, 72.0)  # smallest real and largest imaginary part of the poles that are drawn [1/s]


def scan(controller: Any) -> dict[str, Any]:
    """Margins and poles of a controller on `ARMS` at each of `ANGLES`, as the page shows them.

    Raises:
        ValueError: If there is no linear law for the controller.
    """
    found, closed = margins_on(controller)
    margins = {name: np.where(found.stable, getattr(found, name), none) for name, none in NONE_LEFT.items()}
    poles = [continuous(at_angle) for at_angle in closed[0]]
    upper = [at_angle[at_angle.imag > -1e-6] for at_angle in poles]
    shown = []
    for degrees in SHOWN_ANGLES:
        k = int(np.abs(np.degrees(ANGLES) - degrees).argmin())
        at_angle = {name: values[0, k] for name, values in margins.items()}
        slowest = _pairs(upper[k][:_MOST_POLES])
        shown.append({"angle": ANGLES[k], "stable": found.stable[0, k], **at_angle, "poles": slowest})
    return {
        "stable": bool(found.stable.all()),
        "stable_design": bool(found.stable[0].all()),
        "slowest": max(float(at_angle.real.max()) for at_angle in poles),
        "worst": {name: worst(name, values) for name, values in margins.items()},
        "worst_design": {name: worst(name, values[:1]) for name, values in margins.items()},
        "modulus_by_arm": margins["modulus"].min(axis=1),
        "design": {name: values[0] for name, values in margins.items()},
        "over_arms": {name: _worst_of(name)(values, axis=0) for name, values in margins.items()},
        "poles": [_pairs(each[(each.real > _PLANE[0]) & (each.imag < _PLANE[1])]) for each in upper],
        "shown": shown,
    }


def worst(name: str, values: Floats) -> dict[str, Any]:
    """Worst value of a margin, shape (arms, 46), with its arm and its angle [degrees]."""
    place = values.argmax() if name == "gain_down" else values.argmin()
    arm, k = np.unravel_index(int(place), values.shape)
    return {"value": values[arm, k], "arm": ARMS[arm], "degrees": np.degrees(ANGLES[k])}


def _worst_of(name: str) -> Any:
    return np.max if name == "gain_down" else np.min


def _pairs(poles: NDArray[np.complex128]) -> list[list[float]]:
    """Real and imaginary parts."""
    return [[float(pole.real), float(pole.imag)] for pole in poles]
