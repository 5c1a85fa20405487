"""Numbers, angles and poles as text, written the same everywhere."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def number(value: float | np.floating | NDArray[np.float64], digits: int) -> str:
    """A number with a proper minus sign, none before zero; a dash where there is no number."""
    if not np.isfinite(value):
        return "–"
    text = f"{float(value):.{digits}f}"
    return (text if float(text) else text.lstrip("-")).replace("-", "−")


def degrees(angle: float) -> str:
    """An angle [rad] as text in degrees."""
    return f"{np.degrees(angle):.0f}°"


def poles_text(poles: NDArray[np.complex128], digits: int = 1) -> str:
    """Poles [1/s] in their order, each conjugate pair once with its damping ratio to one digit more."""
    parts = []
    for pole in poles[poles.imag > -1e-6]:
        pair = f" ± {number(pole.imag, 1)}j (ζ {number(-pole.real / abs(pole), digits + 1)})"
        parts.append(number(pole.real, digits) + (pair if pole.imag > 1e-6 else ""))
    return ", ".join(parts)
