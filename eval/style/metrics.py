"""Estimates of metrics as text, rounded as `beltarm_env.metrics.METRICS` says."""

from __future__ import annotations

from math import isfinite
from typing import Any

from beltarm_env.metrics import METRICS
from eval.style.text import number


def numbers(name: str, value: Any) -> tuple[str, str, str]:
    """Estimate `iqm` of a value, its interval's ends `low` and `high`, rounded as suits the metric; dashes for none."""
    metric = METRICS[name]
    factor = 100 if metric.share else 1
    point, low, high = (
        f"{factor * number:.{metric.digits}f}" if isfinite(number) else "–"
        for number in (value.iqm, value.low, value.high)
    )
    return point, low, high


def rounded(name: str, value: float) -> str:
    """Value of a metric by itself, rounded as suits it."""
    metric = METRICS[name]
    return number(100 * value if metric.share else value, metric.digits)


def cell(name: str, value: Any) -> str:
    """Estimate with its interval, such as `4.8 [4.5, 5.2]`; a dash for none."""
    point, low, high = numbers(name, value)
    return f"{point} [{low}, {high}]" if isfinite(value.iqm) else point


def with_unit(name: str, text: str) -> str:
    """Text followed by the unit of a metric, if it has one."""
    return f"{text} {METRICS[name].unit}".rstrip()
