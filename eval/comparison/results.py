"""Results of the comparison as data; `eval.comparison.schema` writes them, `eval.report` shows them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from importlib.util import find_spec
from itertools import product
from typing import Any, Literal

import numpy as np

from beltarm_env import __version__
from beltarm_env.arrays import Flags, Floats
from beltarm_env.metrics import METRICS, NOT_ARRIVED, OF_ARRIVED, SHOWN
from eval.comparison import splits, statistics
from eval.comparison.cache import LEFT, Metrics
from eval.comparison.methods import PRIMARY, Method, policies_of
from eval.comparison.provenance import provenance as about
from eval.comparison.rollouts import Failure
from eval.comparison.sets import SetLabel

MEASURES, STARTS = "eval.comparison.run", ("choose_methods", "compare")
"""Module and functions that measure a comparison, for the digest of the code."""
PAIRED_METRICS = ("cost", "still_s", "tip_rms_mm", "residual_pp_mm")
MOSTLY = 0.95
"""Share of its moves that a method has to arrive in, to be marked in anything but the cost: the average of one that
arrives on easy arms alone, or whose arms leave while their error is small, looks better than it is."""

Against = Literal["best classical", "base"]
"""Other method of a pair: the classical one of the lowest cost, or the one that a learned method corrects."""
Mark = Literal["best", "tie"]
"""Of a metric on a split: the lowest of all ranked methods, or not shown to differ from it."""


@dataclass(frozen=True, slots=True, eq=False)
class MethodOutcome:
    """Outcome of one method on one split."""

    method: Method
    split: str
    metrics: Metrics  # each (seeds, episodes)
    estimates: dict[str, statistics.Estimate]  # of `OF_ARRIVED` where all seeds arrive; not numbers for none
    action_times: tuple[float, float]  # median, 99th percentile [us]
    moves: int = 1  # of a scenario; metrics are averages over them

    @property
    def name(self) -> str:
        """Name of the method."""
        return self.method.name

    @property
    def cost(self) -> float:
        """Interquartile mean of the cost."""
        return self.estimates["cost"].iqm

    @property
    def seeds(self) -> int:
        """Number of training seeds; 1 for a classical controller."""
        return len(self.method.sources)

    @property
    def ranked(self) -> bool:
        """Whether it is compared with others, because it has the same observations."""
        return self.method.kind != "privileged"

    @property
    def failures(self) -> dict[str, int]:
        """Number of moves that were run, of those that never settled, and of runs that left the workspace."""
        unsettled = self.metrics["failure_share"] * self.moves
        left = self.metrics[LEFT]
        return {"runs": unsettled.size * self.moves, "not_settled": round(unsettled.sum()), LEFT: int(left.sum())}

    @property
    def not_arrived(self) -> float:
        """Share of its moves that do not arrive."""
        return float(self.metrics[NOT_ARRIVED].mean())

    @property
    def median_seed(self) -> int:
        """Training seed of median cost."""
        costs = [statistics.interquartile_mean(of_seed) for of_seed in self.metrics["cost"]]
        return int(np.argsort(costs)[len(costs) // 2])


def arrived(metrics: Metrics) -> Flags:
    """Scenarios in which all training seeds of a method arrive, in every move; shape (episodes,)."""
    return ~np.any(metrics[NOT_ARRIVED], axis=0)


def estimated(measured: Sequence[Metrics]) -> list[dict[str, statistics.Estimate]]:
    """Estimate the metrics that are shown, each of several methods and splits; see `MethodOutcome.estimates`."""
    by_name = [dict.fromkeys(SHOWN, statistics.NOTHING) for _ in measured]
    for share in (False, True):
        cells: list[tuple[int, str, Floats]] = []
        for k, metrics in enumerate(measured):
            there = arrived(metrics)
            for name in SHOWN:
                values = metrics[name][:, there] if name in OF_ARRIVED else metrics[name]
                if METRICS[name].share == share and values.shape[1] > 1:
                    cells.append((k, name, values))
        of_cells = statistics.together([values for _, _, values in cells], partial(statistics.estimates, mean=share))
        for (k, name, _), estimate in zip(cells, of_cells, strict=True):
            by_name[k][name] = estimate
    return by_name


def tables_of(method: MethodOutcome, other: MethodOutcome, name: str) -> tuple[Floats, Floats]:
    """Values of two methods in the scenarios in which they are compared: for `OF_ARRIVED` those where both arrive."""
    if name not in OF_ARRIVED:
        return method.metrics[name], other.metrics[name]
    both = arrived(method.metrics) & arrived(other.metrics)
    return method.metrics[name][:, both], other.metrics[name][:, both]


@dataclass(frozen=True, slots=True)
class Pair:
    """Paired comparison of a ranked method with another one on a split, by metric."""

    outcome: MethodOutcome
    other: MethodOutcome
    against: Against
    metrics: dict[str, statistics.Paired]  # of `PAIRED_METRICS`


@dataclass(frozen=True, slots=True)
class Comparison:
    """Outcomes of all methods on all splits, compared with one another."""

    outcomes: list[MethodOutcome]
    pairs: list[Pair]
    marks: dict[str, dict[str, dict[str, Mark]]]  # by split, metric and method, of `PAIRED_METRICS`
    failures: list[Failure]
    scenario_set: SetLabel  # of the splits
    provenance: dict[str, Any]

    def with_failures(self, failures: list[Failure]) -> Comparison:
        """Copy with more failures, one per method and split, and without outcomes that do not repeat."""
        failed: dict[tuple[str, str], Failure] = {}
        for failure in (*self.failures, *failures):
            failed.setdefault((failure.method, failure.split), failure)
        varying = {(failure.method, failure.split) for failure in failures if failure.varies}
        left = [outcome for outcome in self.outcomes if (outcome.name, outcome.split) not in varying]
        copy = replace(self, failures=[*failed.values()])
        return make_comparison(left, copy.failures, self.scenario_set, self.provenance) if varying else copy

    def on(self, split: str) -> list[MethodOutcome]:
        """Outcomes on one split, in the order of the methods; those that are not ranked last."""
        outcomes = [outcome for outcome in self.outcomes if outcome.split == split]
        return sorted(outcomes, key=lambda outcome: not outcome.ranked)

    def splits(self) -> list[str]:
        """Names of the splits, in order."""
        return list(dict.fromkeys(outcome.split for outcome in self.outcomes))

    @property
    def main_split(self) -> str:
        """Split that is asked about first, see `eval.comparison.splits.main_split`."""
        return splits.main_split(self.splits())

    def challengers(self, split: str) -> list[MethodOutcome]:
        """Challengers of the classical controllers on a split, best first: learned methods, or else added ones."""
        kinds = {outcome.method.kind for outcome in self.outcomes}
        wanted = next((kind for kind in ("learned", "added") if kind in kinds), None)
        outcomes = [outcome for outcome in self.on(split) if outcome.method.kind == wanted]
        return sorted(outcomes, key=lambda outcome: outcome.cost)

    def primary_pair(self) -> tuple[MethodOutcome, MethodOutcome] | None:
        """Challenger and classical controller of the primary comparison, on the main split; None without both.

        Those of the protocol where both took part, or else the ones of the lowest cost.
        """
        home = {outcome.name: outcome for outcome in self.on(self.main_split)}
        if all(name in home for name in PRIMARY):
            return home[PRIMARY[0]], home[PRIMARY[1]]
        challengers, best = self.challengers(self.main_split), self.best_classical(self.main_split)
        return (challengers[0], best) if challengers and best else None

    def best_classical(self, split: str) -> MethodOutcome | None:
        """Classical method of the lowest cost, if there is any."""
        return best_classical(self.on(split))


def make_comparison(
    outcomes: list[MethodOutcome], failures: list[Failure], scenario_set: SetLabel, provenance: dict[str, Any]
) -> Comparison:
    """Compare the outcomes with one another.

    Raises:
        ValueError: If there is none of a ranked method.
    """
    if not any(outcome.ranked for outcome in outcomes):
        first = failures[0]
        error = ValueError(f"no method could be run: {first.method} on {first.split}: {first.message}")
        error.add_note(first.trace)
        raise error
    by_split = {split: [o for o in outcomes if o.split == split] for split in dict.fromkeys(o.split for o in outcomes)}
    best = _pairs(by_split, "best classical", lambda _, of_split: best_classical(of_split))
    base = _pairs(by_split, "base", lambda o, of_split: {b.name: b for b in of_split}.get(o.method.base or ""))
    marks = {split: {name: _marks(o, name) for name in PAIRED_METRICS} for split, o in by_split.items()}
    return Comparison(outcomes, [*best, *base], marks, failures, scenario_set, provenance)


def best_classical(outcomes: list[MethodOutcome]) -> MethodOutcome | None:
    """Classical method of the lowest cost among the outcomes of one split, if there is any."""
    classical = [outcome for outcome in outcomes if outcome.method.kind == "classical"]
    return min(classical, key=lambda outcome: outcome.cost, default=None)


def _pairs(
    by_split: dict[str, list[MethodOutcome]],
    against: Against,
    other_of: Callable[[MethodOutcome, list[MethodOutcome]], MethodOutcome | None],
) -> list[Pair]:
    """Ranked methods and their others on every split, compared.

    All comparisons in one metric on one split are a family for Holm's correction: one question, asked of every method.
    """
    both = [
        (outcome, other)
        for outcomes in by_split.values()
        for outcome in outcomes
        if outcome.ranked and (other := other_of(outcome, outcomes)) and other is not outcome
    ]
    compared = iter(statistics.all_paired([tables_of(*pair, name) for pair in both for name in PAIRED_METRICS]))
    pairs = [Pair(*pair, against, {name: next(compared) for name in PAIRED_METRICS}) for pair in both]
    for split, name in product(by_split, PAIRED_METRICS):
        family = [pair.metrics for pair in pairs if pair.outcome.split == split]
        for metrics, corrected in zip(family, _corrected([metrics[name] for metrics in family]), strict=True):
            metrics[name] = corrected
    return pairs


def _corrected(family: Sequence[statistics.Paired]) -> list[statistics.Paired]:
    """A family of comparisons after Holm's correction."""
    adjusted = statistics.holm([pair.p for pair in family])
    return [replace(pair, p_holm=p) for pair, p in zip(family, adjusted, strict=True)]


def _marks(outcomes: list[MethodOutcome], name: str) -> dict[str, Mark]:
    """Marks of one split in one metric; a tie outlives the paired test against the best, with Holm's correction.

    None where there are too few scenarios to say anything.
    """
    ranked = [outcome for outcome in outcomes if outcome.ranked]
    shown = [outcome for outcome in ranked if name == "cost" or outcome.not_arrived <= 1 - MOSTLY]
    shown = [outcome for outcome in shown if np.isfinite(outcome.estimates[name].iqm)]
    best = min(shown, key=lambda outcome: outcome.estimates[name].iqm, default=None)
    if best is None or best.metrics[name].shape[1] < statistics.LEAST_SCENARIOS:
        return {}
    others = [outcome for outcome in ranked if outcome is not best]
    compared = _corrected(statistics.all_paired([tables_of(other, best, name) for other in others]))
    pairs = {other.name: pair for other, pair in zip(others, compared, strict=True)}
    marks: dict[str, Mark] = {
        outcome.name: "tie" for outcome in shown if outcome is not best and not pairs[outcome.name].survives
    }
    return {**marks, best.name: "best"}


def provenance(methods: Sequence[Method], chosen: dict[str, splits.Split]) -> dict[str, Any]:
    """Provenance of results to come: command, commit, digest of the code, scenarios, policies, packages."""
    packages = ["numpy", "scipy", "ziglang", "gymnasium"]
    packages += [name for name in ("torch", "stable-baselines3") if find_spec(name.replace("-", "_"))]  # of users' own
    return {
        **about(MEASURES, STARTS),
        "beltarm": __version__,
        "splits_version": splits.VERSION,
        "split_seeds": {name: split.seed for name, split in chosen.items()},
        "split_sha256": {name: split.digest for name, split in chosen.items()},
        "policies": policies_of(methods),
        "added": {method.name: files for method in methods if (files := method.own_files)},
        "packages": {name: version(name) for name in packages},
    }
