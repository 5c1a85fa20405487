"""Interquartile means and their bootstrap intervals, over scenarios and training seeds.

Values come as a table of shape (seeds, episodes): one row per training seed, one column per scenario, the same
scenarios for every method. Scenarios and seeds are resampled independently of each other, so that an interval accounts
for both; a classical controller has a single row.

A p value is the larger of two: that of the bootstrap, and that of a t test of the interquartile mean, which counts
scenarios and training seeds as samples. The bootstrap alone shows too much where there are few of either. By
simulation, without any difference about 5 % of these p values are below 0.05 or fewer, from 20 scenarios on, with one
seed, two and five, also of skewed differences (tests/eval/test_statistics.py has a part of it). Of two seeds whose
policies differ as much as scenarios do, 12 % are: no shipped policies differ by that much.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import numpy as np
from scipy.special import stdtr
from scipy.stats import bootstrap

from beltarm_env.arrays import Floats, Integers
from beltarm_env.metrics import METRICS

Result = TypeVar("Result")

RESAMPLES = 2000
LEAST_P = 2 / (RESAMPLES + 1)
"""Smallest p value that so many resamples can show."""
LEAST_SCENARIOS = 20
"""With fewer scenarios nothing is said of a difference."""
LEAST_OF_TAIL = 40
"""Scenarios of which the worst 5 % are shown, at least: with fewer they are a single one."""
CONFIDENCE = 0.95
_LARGE, _AT_ONCE = 500, 4_000_000  # episodes beyond which resamples are drawn in batches of so many values


@dataclass(frozen=True, slots=True)
class Estimate:
    """Interquartile mean with its 95 % interval."""

    iqm: float  # of shares the plain mean
    low: float
    high: float


def interquartile_mean(values: Floats) -> float:
    """Mean of the middle half of all values, as `scipy.stats.trim_mean` has it, without its cost per call."""
    return float(_middle_mean(np.array(values).reshape(-1)))


def worst_mean(values: Floats) -> float:
    """Mean of the largest 5 % of all values."""
    ordered = np.sort(values, axis=None)
    return float(ordered[-max(1, round(0.05 * ordered.size)) :].mean())


def average(name: str, values: Floats) -> float:
    """Interquartile mean of a metric's values; of shares the plain mean."""
    return float(values.mean()) if METRICS[name].share else interquartile_mean(values)


def _middle_mean(values: Floats) -> Floats:
    """Mean of the middle half along the last axis; sorts the values in place."""
    values.sort(axis=-1)
    cut = values.shape[-1] // 4
    return values[..., cut : values.shape[-1] - cut].mean(axis=-1)


def resampled(values: Floats, mean: bool = False) -> Floats:
    """Interquartile means (or plain means) of bootstrap samples of a (seeds, episodes) table, shape (RESAMPLES,).

    Several tables, along axes before these two, are resampled in the same way; axes of the result likewise.
    """
    *several, seeds, episodes = values.shape
    tables = values.reshape(-1, seeds * episodes)

    def centers(scenarios: Integers, runs: Integers | None = None, *, axis: int) -> Floats:
        places = scenarios
        if runs is not None:
            places = (episodes * runs[..., :, None] + scenarios[..., None, :]).reshape(len(runs), -1)
        samples = (table.take(places) for table in tables)
        return np.stack([sample.mean(axis=-1) if mean else _middle_mean(sample) for sample in samples])

    result = bootstrap(
        (np.arange(episodes), np.arange(seeds)) if seeds > 1 else (np.arange(episodes),),
        centers,
        n_resamples=RESAMPLES,
        batch=max(1, _AT_ONCE // (seeds * episodes)) if episodes > _LARGE else None,
        confidence_level=CONFIDENCE,
        method="percentile",
        vectorized=True,
        rng=np.random.default_rng(0),
    )
    return result.bootstrap_distribution.reshape(*several, RESAMPLES)


def estimate(values: Floats, mean: bool = False) -> Estimate:
    """Interquartile mean (or plain mean, for shares) of a (seeds, episodes) table, with its bootstrap interval.

    Raises:
        ValueError: If there are fewer than two episodes.
    """
    return estimates(values[None], mean)[0]


def estimates(tables: Floats, mean: bool = False) -> list[Estimate]:
    """Estimate several tables of one shape together, as `estimate` does each, in less time."""
    if tables.shape[2] < 2:
        raise ValueError(f"an interval needs at least 2 episodes, got {tables.shape[2]}")
    points = [float(values.mean()) if mean else interquartile_mean(values) for values in tables]
    results = [Estimate(point, point, point) for point in points]
    varied = np.flatnonzero(np.ptp(tables, axis=(1, 2)))
    for k, distribution in zip(varied.tolist(), resampled(tables[varied], mean) if len(varied) else (), strict=True):
        results[k] = _interval(points[k], distribution)
    return results


def _interval(point: float, distribution: Floats) -> Estimate:
    tail = 50 * (1 - CONFIDENCE)
    low, high = np.percentile(distribution, [tail, 100 - tail])
    return Estimate(point, float(low), float(high))


@dataclass(frozen=True, slots=True)
class Paired:
    """Paired comparison of two methods on the same scenarios; lower values are better."""

    difference: Estimate  # method minus other
    win_rate: Estimate  # probability of improvement: share of (seed, scenario) pairs that are lower, ties half
    p: float  # of no difference, two-sided, see above; at least `LEAST_P`
    p_holm: float = 1.0  # the same after Holm's correction for all comparisons of one family
    scenarios: int = LEAST_SCENARIOS  # that were compared

    @property
    def decides(self) -> bool:
        """Whether there are scenarios enough to say something of a difference."""
        return self.scenarios >= LEAST_SCENARIOS

    @property
    def verdict(self) -> str:
        """Whether a difference was shown, this comparison taken on its own: by its p value, and by its interval."""
        if not self.decides:
            return "too few scenarios" if self.scenarios else "not compared"
        if self.p >= 1 - CONFIDENCE or self.difference.low <= 0 <= self.difference.high:
            return "no difference shown"
        return "worse" if self.difference.iqm > 0 else "better"

    @property
    def survives(self) -> bool:
        """Whether the difference is still shown once all comparisons of its family are accounted for."""
        return self.p_holm < 1 - CONFIDENCE

    @property
    def better(self) -> bool:
        """Whether the method is shown to be lower, all comparisons of its family accounted for."""
        return self.survives and self.difference.iqm < 0


NOTHING = Estimate(float("nan"), float("nan"), float("nan"))
NOT_COMPARED = Paired(NOTHING, NOTHING, 1.0, scenarios=0)
"""Two methods that have no two scenarios in common of which a metric says something."""


def paired(values: Floats, other: Floats) -> Paired:
    """Compare two methods scenario by scenario.

    A method with one controller is compared with every seed of the other. Where both have several, seeds are paired in
    their order, as samples of both methods; those that the other has not are left out.
    """
    return all_paired([(values, other)])[0]


def all_paired(tables: Sequence[tuple[Floats, Floats]]) -> list[Paired]:
    """Compare several pairs of methods, as `paired` does each, in less time."""
    return together(_differences(tables), _paired)


def mean_differences(tables: Sequence[tuple[Floats, Floats]]) -> list[Estimate]:
    """Estimate the mean difference of several pairs of methods, whose seeds are paired as `paired` does."""
    return together(_differences(tables), partial(estimates, mean=True))


def together(tables: Sequence[Floats], compute: Callable[[Floats], list[Result]]) -> list[Result]:
    """Compute something of each table, in their order, with one call for all tables of a shape."""
    results: dict[int, Result] = {}
    for shape in {table.shape for table in tables}:
        places = [k for k, table in enumerate(tables) if table.shape == shape]
        results |= zip(places, compute(np.stack([tables[k] for k in places])), strict=True)
    return [results[k] for k in range(len(tables))]


def _differences(tables: Sequence[tuple[Floats, Floats]]) -> list[Floats]:
    shared = [min(len(values), len(other)) for values, other in tables]
    return [
        values - other if seeds == 1 else values[:seeds] - other[:seeds]
        for seeds, (values, other) in zip(shared, tables, strict=True)
    ]


def _paired(differences: Floats) -> list[Paired]:
    """Comparisons by their differences, tables of one shape."""
    count = differences.shape[2]
    if count < 2:
        return [NOT_COMPARED] * len(differences)
    wins = estimates((differences < 0) + 0.5 * (differences == 0), mean=True)
    results = []
    for difference, win_rate, distribution in zip(differences, wins, resampled(differences), strict=True):
        beyond = min(np.sum(distribution <= 0), np.sum(distribution >= 0))
        p = max(min(1.0, LEAST_P * (1 + float(beyond))), _t_test(difference)) if count >= LEAST_SCENARIOS else 1.0
        results.append(Paired(_interval(interquartile_mean(difference), distribution), win_rate, p, scenarios=count))
    return results


def _t_test(differences: Floats) -> float:
    """P value of an interquartile mean of zero, from a (seeds, episodes) table, two-sided.

    The test of Tukey and McLaughlin for a trimmed mean, whose standard error is that of the winsorized values (R. R.
    Wilcox, Introduction to Robust Estimation and Hypothesis Testing, 2012, section 4.3). Variances of the averages of
    scenarios and of seeds are added; degrees of freedom after Satterthwaite.
    """
    seeds, count = differences.shape
    ordered = np.sort(differences, axis=None)
    cut = ordered.size // 4
    values = np.clip(differences, ordered[cut], ordered[-1 - cut]) * (ordered.size / (ordered.size - 2 * cut))
    variances = [values.mean(axis=0).var(ddof=1) / count]
    freedoms = [count - 2 * (count // 4) - 1]
    if seeds > 1:
        variances.append(values.mean(axis=1).var(ddof=1) / seeds)
        freedoms.append(seeds - 1)
    variance, size = sum(variances), abs(interquartile_mean(differences))
    if variance == 0:
        return 0.0 if size else 1.0
    freedom = variance**2 / sum(part**2 / free for part, free in zip(variances, freedoms, strict=True))
    return float(2 * stdtr(freedom, -size / np.sqrt(variance)))


def holm(p_values: Sequence[float]) -> list[float]:
    """P values adjusted for their number by Holm's step-down method: reject those below the level.

    The k-th smallest of m is multiplied by m - k + 1, kept at least as large as the one before, and at most 1. The
    probability of any false rejection among the m is then at most the level, whatever their dependence (S. Holm, A
    simple sequentially rejective multiple test procedure, Scand. J. Statist. 6, 1979).
    """
    values = np.asarray(p_values, np.float64)
    order = np.argsort(values, kind="stable")
    factors = len(values) - np.arange(len(values))
    adjusted = np.empty_like(values)
    adjusted[order] = np.minimum(np.maximum.accumulate(factors * values[order]), 1.0)
    return adjusted.tolist()
