"""Titles, units and digits of the metrics, as every table and picture shows them."""

from __future__ import annotations

from typing import Protocol

_TITLES = {
    "tip_rms_mm": ("tip RMS", "mm"),
    "tip_max_mm": ("tip max", "mm"),
    "residual_pp_mm": ("residual p-p", "mm"),
    "tip_acc_rms": ("tip acc. RMS", "m/s²"),
    "settling_s": ("settling", "s"),
    "failure_share": ("not settled", "%"),
    "torque_rms": ("torque RMS", "N m"),
    "torque_rate_rms": ("torque rate", "N m/s"),
    "saturated_share": ("saturated", "%"),
    "cost": ("cost", ""),
}
_DIGITS = {"tip_acc_rms": 2, "settling_s": 2, "torque_rms": 3, "torque_rate_rms": 1, "cost": 0}
REPORTED_METRICS = tuple(_TITLES)
"""Metrics of `results.json`; `episodes.csv` also has the two parts of the residual vibration."""
SHARES = ("failure_share", "saturated_share")
"""Metrics that are shares, shown in per cent; their plain mean is reported: the middle half of 0 and 1 says nothing."""


class Interval(Protocol):
    """An estimate with the ends of its interval."""

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


def title(name: str) -> str:
    """Name of a metric, without its unit."""
    return _TITLES[name][0]


def with_unit(name: str, number: str) -> str:
    """A number or text followed by the unit of a metric."""
    return f"{number} {_TITLES[name][1]}".strip()


def heading(name: str) -> str:
    """Name of a metric with its unit, such as `tip RMS (mm)`."""
    text, unit = _TITLES[name]
    return f"{text} ({unit})" if unit else text


def numbers(name: str, value: Interval) -> tuple[str, str, str]:
    """Estimate, lower and upper end, rounded as suits the metric."""
    factor = 100 if name in SHARES else 1
    digits = _DIGITS.get(name, 0 if name in SHARES else 1)
    point, low, high = (f"{factor * number:.{digits}f}" for number in (value.iqm, value.low, value.high))
    return point, low, high


def cell(name: str, value: Interval) -> str:
    """Estimate with its interval, such as `4.8 [4.5, 5.2]`."""
    point, low, high = numbers(name, value)
    return f"{point} [{low}, {high}]"
