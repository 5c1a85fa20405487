"""Margins of a controller's loop over arms and angles, and its poles on the design model."""

from __future__ import annotations

from typing import Any

import numpy as np

from baselines.loops.condition import CORNERS, margins_on
from baselines.loops.models import continuous
from baselines.models.linear import ANGLES
from beltarm_env.arrays import Floats

ARMS = tuple(CORNERS)
"""Arms that loops are looked at on; the first is the design model."""
NONE_LEFT = {"gain_up": 1.0, "gain_down": 1.0, "phase": 0.0, "delay": 0.0, "modulus": 0.0}
"""Margins by name, and their values for an unstable loop."""
_PLANE = (-62.0, 72.0)  # smallest real and largest imaginary part of the poles that are drawn [1/s]


def scan(controller: Any) -> dict[str, Any]:
    """Margins and poles of a controller on `ARMS` at each of `ANGLES`, as the page shows them.

    Raises:
        ValueError: If there is no linear law for the controller.
    """
    least, closed = margins_on(controller)
    margins = {name: np.where(least.stable, getattr(least, name), none) for name, none in NONE_LEFT.items()}
    poles = [continuous(at_angle) for at_angle in closed[0]]
    shown = [p[(p.imag > -1e-6) & (p.imag < _PLANE[1]) & (p.real > _PLANE[0])] for p in poles]
    return {
        "stable": bool(least.stable.all()),
        "stable_design": bool(least.stable[0].all()),
        "slowest": max(float(at_angle.real.max()) for at_angle in poles),
        "worst": {name: worst(name, values) for name, values in margins.items()},
        "worst_design": {name: worst(name, values[:1]) for name, values in margins.items()},
        "modulus_by_arm": margins["modulus"].min(axis=1),
        "design": {name: values[0] for name, values in margins.items()},
        "over_arms": {
            name: values.max(axis=0) if name == "gain_down" else values.min(axis=0) for name, values in margins.items()
        },
        "poles": [np.stack([each.real, each.imag], axis=-1) for each in shown],
    }


def worst(name: str, values: Floats) -> dict[str, Any]:
    """Worst value of a margin, shape (arms, 46), with its arm and its angle [degrees]."""
    place = values.argmax() if name == "gain_down" else values.argmin()
    arm, k = np.unravel_index(int(place), values.shape)
    return {"value": values[arm, k], "arm": ARMS[arm], "degrees": np.degrees(ANGLES[k])}
