"""Margins of a controller's loop over arms and angles, and its poles on the design model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from baselines.loops.condition import CORNERS, margins_on
from baselines.loops.margins import Margins
from baselines.loops.models import Poles, continuous
from baselines.models.linear import ANGLES
from beltarm_env.arrays import Floats

ARMS = tuple(CORNERS)
"""Arms that loops are looked at on; the first is the design model."""
_NONE_LEFT = {"gain_up": 1.0, "gain_down": 1.0, "phase": 0.0, "delay": 0.0, "modulus": 0.0}
"""Margins of a loop that is unstable."""


@dataclass(frozen=True)
class Scan:
    """The loops of one controller on `ARMS` at each of `ANGLES`."""

    margins: Margins  # each of shape (arms, 46)
    poles: list[Poles]  # on the design model, by angle: continuous equivalents [1/s], slowest first

    def worst(self, name: str, arms: slice = slice(None)) -> tuple[float, str, float]:
        """Worst value of a margin over some of `ARMS` and all angles, its arm, and its angle [degrees]."""
        values = getattr(self.margins, name)[arms]
        place = values.argmax() if name == "gain_down" else values.argmin()
        arm, k = np.unravel_index(int(place), values.shape)
        return float(values[arm, k]), ARMS[arms][arm], float(np.degrees(ANGLES[k]))

    def over_arms(self, name: str) -> Floats:
        """Worst value of a margin over `ARMS` at each angle, shape (46,)."""
        values = getattr(self.margins, name)
        return values.max(axis=0) if name == "gain_down" else values.min(axis=0)


def scan(controller: Any) -> Scan:
    """Margins and poles of a controller over all arms and angles.

    Raises:
        ValueError: If there is no linear law for the controller.
    """
    found, closed = margins_on(controller)
    known = {name: np.where(found.stable, getattr(found, name), none) for name, none in _NONE_LEFT.items()}
    return Scan(Margins(found.stable, **known), [continuous(poles) for poles in closed[0]])


def at_angle(found: Scan, degrees: float) -> tuple[Margins, int]:
    """Margins on the design model at the tabulated angle nearest to one [degrees], and the index of that angle."""
    k = int(np.abs(np.degrees(ANGLES) - degrees).argmin())
    return Margins(*(values[0, k] for values in found.margins)), k
