"""Estimates of metrics as text, rounded as `beltarm_env.metrics.METRICS` says."""

from __future__ import annotations

from typing import Protocol

from beltarm_env.metrics import METRICS


class Interval(Protocol):
    """Estimate with the ends of its interval."""

    @property
    def iqm(self) -> float:
        """Interquartile mean, or plain mean of a share."""
        ...

    @property
    def low(self) -> float:
        """Lower end."""
        ...

    @property
    def high(self) -> float:
        """Upper end."""
        ...


def numbers(name: str, value: Interval) -> tuple[str, str, str]:
    """Estimate, lower and upper end, rounded as suits the metric."""
    metric = METRICS[name]
    factor = 100 if metric.share else 1
    point, low, high = (f"{factor * number:.{metric.digits}f}" for number in (value.iqm, value.low, value.high))
    return point, low, high


def cell(name: str, value: Interval) -> str:
    """Estimate with its interval, such as `4.8 [4.5, 5.2]`."""
    point, low, high = numbers(name, value)
    return f"{point} [{low}, {high}]"


def with_unit(name: str, text: str) -> str:
    """Text followed by the unit of a metric, if it has one."""
    return f"{text} {METRICS[name].unit}".rstrip()
