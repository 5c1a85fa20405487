"""Margins and poles of a controller's loop at every tabulated angle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from baselines.loops.margins import Margins, margins_from_poles
from baselines.loops.models import (
    Loop,
    Poles,
    System,
    arms_at_angles,
    closed_poles,
    continuous,
    laws_at_angles,
    open_poles,
)
from baselines.models.linear import ANGLES


@dataclass(frozen=True)
class Scan:
    """The loops of one controller at each of `ANGLES`."""

    margins: Margins  # each of shape (46,)
    poles: list[Poles]  # continuous equivalents [1/s]


def scan(controller: Any) -> Scan:
    """Margins and poles of a controller on the arm that it believes in, over all angles."""
    loops = Loop(laws_at_angles(controller), System(*(part[0] for part in arms_at_angles([controller.params]))))
    closed = closed_poles(loops)
    return Scan(margins_from_poles(open_poles(loops), closed), [continuous(poles) for poles in closed])


def worst(found: Scan, name: str) -> tuple[float, float]:
    """Worst value of a margin over the angles, and its angle [degrees]; only of `gain_down` is it the largest."""
    values = getattr(found.margins, name)
    k = int(values.argmax() if name == "gain_down" else values.argmin())
    return float(values[k]), float(np.degrees(ANGLES[k]))


def at_angle(found: Scan, degrees: float) -> tuple[Margins, int]:
    """Margins at the tabulated angle nearest to one [degrees], and the index of that angle."""
    k = int(np.abs(np.degrees(ANGLES) - degrees).argmin())
    return Margins(*(values[k] for values in found.margins)), k
