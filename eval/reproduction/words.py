"""Numbers and lists as text, written the same everywhere."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

LEFT = "the arm left its workspace"
_MOST_NAMES = 8  # longer lists are told by their exceptions, or counted


def number(value: float | np.floating | NDArray[np.float64], digits: int, *, plus: bool = False) -> str:
    """A number with a proper minus sign, none before zero; a dash where there is no number."""
    if not np.isfinite(value):
        return "–"
    text = f"{float(value):{'+' if plus else ''}.{digits}f}"
    return (text if float(text) else text.lstrip("+-")).replace("-", "−")


def percent(share: float) -> str:
    """A share as a percentage; a dash where there is none."""
    return f"{number(100 * share, 0)} %" if np.isfinite(share) else "–"


def degrees(angle: float) -> str:
    """An angle in rad as text in degrees."""
    return f"{np.degrees(angle):.0f}°"


def among(named: Sequence[str], others: Sequence[str], where: str) -> str:
    """Some of the values tried: by name, or where these are many by the others' names, or by their number and place."""
    total = len(named) + len(others)
    if not others:
        return f"all {total} others tried"
    if len(named) <= _MOST_NAMES:
        return "; ".join(named)
    if len(others) <= _MOST_NAMES:
        return f"{len(named)} of {total} others tried, all but {'; '.join(others)}"
    return f"{len(named)} of {total} others tried ({where})"
