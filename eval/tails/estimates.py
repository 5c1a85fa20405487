"""Estimates of a distribution and of its tail, from many scenarios that are independent of one another.

A percentile is the smallest value that at least this share of all values does not exceed: one of the values. Its
interval is between two others, whose places in the order follow from the binomial distribution, whatever the values'
own distribution is (W. J. Conover, Practical Nonparametric Statistics, 1999, section 3.2). Where there are too few
values for an end of the interval, it is not a number.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest, ks_2samp, quantile_test

from eval.comparison.statistics import CONFIDENCE, holm, interquartile_mean

Floats = NDArray[np.float64]
SHARES = (0.5, 0.9, 0.99, 0.999)
"""Of the percentiles that are shown."""
OF_DIFFERENCE = (0.001, 0.01, 0.5, 0.99, 0.999)
"""Of those of the difference between two methods."""
WORST = 0.001
"""Share of all scenarios that counts as the tail."""


class Interval(NamedTuple):
    """An estimate with its 95 % interval; an end that too few values show is not a number."""

    value: float
    low: float
    high: float


class Tail(NamedTuple):
    """What is told of a metric."""

    mean: float
    error: float  # standard error of the mean
    iqm: float
    percentiles: dict[float, Interval]  # by share
    worst_mean: float  # of the share `WORST` of all values
    worst: float


def percentile(values: Floats, share: float) -> Interval:
    """Percentile of some values with its interval, see above."""
    point = float(np.quantile(values, share, method="inverted_cdf"))
    found = quantile_test(values, p=share).confidence_interval(CONFIDENCE)
    return Interval(point, float(found.low), float(found.high))


def tail_size(count: int) -> int:
    """Number of values that count as the tail of `count`."""
    return max(1, round(WORST * count))


def tail_of(values: Floats) -> Tail:
    """Estimates of a metric from its values, shape (n,); not numbers from fewer than two."""
    if len(values) < 2:
        nothing = Interval(math.nan, math.nan, math.nan)
        return Tail(math.nan, math.nan, math.nan, dict.fromkeys(SHARES, nothing), math.nan, math.nan)
    ordered = np.sort(values)
    return Tail(
        mean=float(values.mean()),
        error=float(values.std(ddof=1) / math.sqrt(len(values))),
        iqm=interquartile_mean(values),
        percentiles={share: percentile(ordered, share) for share in SHARES},
        worst_mean=float(ordered[-tail_size(len(values)) :].mean()),
        worst=float(ordered[-1]),
    )


def share_of(happened: NDArray[np.bool_]) -> Interval:
    """Share of scenarios in which something happened, with its exact interval (Clopper and Pearson)."""
    count, total = int(happened.sum()), len(happened)
    found = binomtest(count, total).proportion_ci(CONFIDENCE, method="exact")
    return Interval(count / total, float(found.low), float(found.high))


class Against(NamedTuple):
    """A method against another one, scenario by scenario."""

    dearer: Interval  # share of scenarios in which it costs more
    mean: float  # difference of the costs, it minus the other
    error: float  # standard error of that
    percentiles: dict[float, Interval]  # of the difference, by share
    least: float
    most: float


def against(values: Floats, others: Floats) -> Against:
    """Compare the values of two methods on the same scenarios, shape (n,) both."""
    difference = np.sort(values - others)
    return Against(
        dearer=share_of(difference > 0),
        mean=float(difference.mean()),
        error=float(difference.std(ddof=1) / math.sqrt(len(difference))),
        percentiles={share: percentile(difference, share) for share in OF_DIFFERENCE},
        least=float(difference[0]),
        most=float(difference[-1]),
    )


class Unlike(NamedTuple):
    """How far the distribution of a quantity among some scenarios is from that among all."""

    name: str
    distance: float  # of Kolmogorov and Smirnov: between the two cumulative distributions, at most
    p: float  # of no difference, with Holm's correction for all quantities
    median: float
    usual: float  # median among all


def unlike(some: dict[str, Floats], usual: dict[str, Floats]) -> list[Unlike]:
    """Quantities whose distribution among some scenarios is shown to differ from the usual one, the farthest first.

    Args:
        some: Values of each quantity in some scenarios.
        usual: The same in scenarios as they come.
    """
    tests: dict[str, Any] = {name: ks_2samp(values, usual[name], method="asymp") for name, values in some.items()}
    adjusted = holm([float(test.pvalue) for test in tests.values()])
    found = [
        Unlike(name, float(test.statistic), p, float(np.median(some[name])), float(np.median(usual[name])))
        for (name, test), p in zip(tests.items(), adjusted, strict=True)
        if p < 1 - CONFIDENCE
    ]
    return sorted(found, key=lambda one: -one.distance)
