"""Numbers, estimates and tables as text, written the same everywhere."""

from collections.abc import Iterable, Sequence
from math import isfinite
from typing import Any

import numpy as np

from beltarm_env.arrays import Floats
from beltarm_env.metrics import METRICS


def number(value: float | np.floating | Floats, digits: int) -> str:
    """A number with a proper minus sign, none before zero; a dash where there is no number."""
    if not np.isfinite(value):
        return "–"
    text = f"{float(value):.{digits}f}"
    return (text if float(text) else text.lstrip("-")).replace("-", "−")


def degrees(angle: float) -> str:
    """An angle [rad] as text in degrees."""
    return f"{np.degrees(angle):.0f}°"


def numbers(name: str, value: Any, more: int = 0) -> tuple[str, str, str]:
    """Estimate `iqm` of a value, and its interval's `low` and `high`, rounded as suits the metric; dashes for none.

    `more` digits beyond those of the metric are for differences.
    """
    metric, three = METRICS[name], (value.iqm, value.low, value.high)
    factor, digits = 100 if metric.share else 1, metric.digits + more
    point, low, high = (f"{factor * each:.{digits}f}" if isfinite(each) else "–" for each in three)
    return point, low, high


def rounded(name: str, value: float) -> str:
    """Value of a metric by itself, rounded as suits it."""
    metric = METRICS[name]
    return number(100 * value if metric.share else value, metric.digits)


def cell(name: str, value: Any, more: int = 0) -> str:
    """Estimate with its interval, such as `4.8 [4.5, 5.2]`; a dash for none. Arguments are those of `numbers`."""
    point, low, high = numbers(name, value, more)
    return f"{point} [{low}, {high}]" if isfinite(value.iqm) else point


_RULES = {"l": "---", "r": "---:"}


def markdown_table(titles: Sequence[str], rows: Iterable[Sequence[str]], align: str = "") -> str:
    """A table in Markdown; `align` has "l" or "r" for each column, by default numbers right of a column of names."""
    rules = [_RULES[side] for side in align or "l" + "r" * (len(titles) - 1)]
    lines = [f"| {' | '.join(titles)} |", f"|{'|'.join(rules)}|"]
    return "\n".join(lines + [f"| {' | '.join(row)} |" for row in rows])
