"""Results of the comparison as data; `eval.comparison.schema` writes them, `eval.report` shows them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from beltarm_env import __version__
from beltarm_env.metrics import METRICS, NOT_ARRIVED, OF_ARRIVED, SHOWN
from eval.comparison import splits
from eval.comparison.cache import LEFT, Metrics
from eval.comparison.failures import Failure
from eval.comparison.methods import PRIMARY, Method, policies_of
from eval.comparison.provenance import provenance as about
from eval.comparison.sets import SetLabel
from eval.comparison.statistics import (
    LEAST_SCENARIOS,
    Estimate,
    Floats,
    Paired,
    all_paired,
    estimates,
    holm,
    interquartile_mean,
    together,
)

MEASURES, STARTS = "eval.comparison.run", ("choose_methods", "compare")
"""Module and functions that measure a comparison, for the digest of the code."""
PAIRED_METRICS = ("cost", "tip_rms_mm", "residual_pp_mm")
MOSTLY = 0.95
"""Share of its runs that a method has to arrive in, to be marked in a metric of `OF_ARRIVED`: the average of one that
arrives on easy arms alone looks better than it is."""

Against = dict[str, dict[str, dict[str, Paired]]]
"""Comparisons scenario by scenario, by split, method and metric."""
Mark = Literal["best", "tie"]
"""Of a metric on a split: the lowest of all ranked methods, or not shown to differ from it."""


@dataclass(frozen=True, slots=True)
class MethodOutcome:
    """Outcome of one method on one split."""

    method: Method
    split: str
    metrics: Metrics  # each (seeds, episodes)
    estimates: dict[str, Estimate]  # of `OF_ARRIVED` over scenarios in which all seeds arrive; not numbers for none
    action_times: tuple[float, float]  # median, 99th percentile [us]

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
        """Number of runs, of those that never settled, and of those that left the workspace."""
        settled = self.metrics["failure_share"]
        left = self.metrics[LEFT]
        return {"runs": settled.size, "not_settled": int(settled.sum()), LEFT: int(left.sum())}

    @property
    def not_arrived(self) -> float:
        """Share of its runs that do not arrive."""
        return float(self.metrics[NOT_ARRIVED].mean())

    @property
    def median_seed(self) -> int:
        """Training seed of median cost."""
        costs = [interquartile_mean(of_seed) for of_seed in self.metrics["cost"]]
        return int(np.argsort(costs)[len(costs) // 2])


def arrived(metrics: Metrics) -> NDArray[np.bool_]:
    """Scenarios in which all training seeds of a method arrive, shape (episodes,)."""
    return ~np.any(metrics[NOT_ARRIVED], axis=0)


def estimated(measured: Sequence[Metrics]) -> list[dict[str, Estimate]]:
    """Estimate the metrics that are shown, each of several methods and splits; see `MethodOutcome.estimates`."""
    nothing = Estimate(float("nan"), float("nan"), float("nan"))
    by_name = [dict.fromkeys(SHOWN, nothing) for _ in measured]
    for share in (False, True):
        cells: list[tuple[int, str, Floats]] = []
        for k, metrics in enumerate(measured):
            there = arrived(metrics)
            for name in SHOWN:
                values = metrics[name][:, there] if name in OF_ARRIVED else metrics[name]
                if METRICS[name].share == share and values.shape[1] > 1:
                    cells.append((k, name, values))
        of_cells = together([values for _, _, values in cells], partial(estimates, mean=share))
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
class Comparison:
    """Outcomes of all methods on all splits, compared with one another."""

    outcomes: list[MethodOutcome]
    against_best: Against  # every ranked method against the classical one of the lowest cost
    against_base: Against  # every learned method against the controller that it corrects
    marks: dict[str, dict[str, dict[str, Mark]]]  # by split, metric and method, of `PAIRED_METRICS`
    failures: list[Failure]
    scenario_set: SetLabel  # of the splits
    provenance: dict[str, Any]

    def with_failures(self, failures: list[Failure]) -> Comparison:
        """Copy with more failures, one per method and split."""
        first: dict[tuple[str, str], Failure] = {}
        for failure in [*self.failures, *failures]:
            first.setdefault((failure.method, failure.split), failure)
        return replace(self, failures=list(first.values()))

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

    def methods(self) -> list[MethodOutcome]:
        """One outcome of every method, in order; those that are not ranked last."""
        first = {outcome.method.name: outcome for outcome in reversed(self.outcomes)}
        order = dict.fromkeys(outcome.method.name for outcome in self.outcomes)
        return sorted((first[name] for name in order), key=lambda outcome: not outcome.ranked)

    def challengers(self, split: str) -> list[MethodOutcome]:
        """Challengers of the classical controllers on a split, best first: learned methods, or else added ones."""
        kinds = {outcome.method.kind for outcome in self.outcomes}
        wanted = next((kind for kind in ("learned", "added") if kind in kinds), None)
        outcomes = [outcome for outcome in self.on(split) if outcome.method.kind == wanted]
        return sorted(outcomes, key=lambda outcome: outcome.estimates["cost"].iqm)

    def primary_pair(self) -> tuple[MethodOutcome, MethodOutcome] | None:
        """Challenger and classical controller of the primary comparison, on the main split; None without both.

        Those of the protocol where both took part, or else the ones of the lowest cost.
        """
        home = {outcome.method.name: outcome for outcome in self.on(self.main_split)}
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
    """Compare the outcomes with one another."""
    by_split = {split: [o for o in outcomes if o.split == split] for split in dict.fromkeys(o.split for o in outcomes)}
    best, base = _against(by_split, _best_opponent), _against(by_split, _bases)
    marks = {split: {name: _marks(o, name, best[split]) for name in PAIRED_METRICS} for split, o in by_split.items()}
    return Comparison(outcomes, best, base, marks, failures, scenario_set, provenance)


def best_classical(outcomes: list[MethodOutcome]) -> MethodOutcome | None:
    """Classical method of the lowest cost among the outcomes of one split, if there is any."""
    classical = [outcome for outcome in outcomes if outcome.method.kind == "classical"]
    return min(classical, key=lambda outcome: outcome.estimates["cost"].iqm, default=None)


def _best_opponent(outcomes: list[MethodOutcome]) -> dict[str, MethodOutcome]:
    best = best_classical(outcomes)
    return {o.method.name: best for o in outcomes if best and o is not best}


def _bases(outcomes: list[MethodOutcome]) -> dict[str, MethodOutcome]:
    by_name = {o.method.name: o for o in outcomes}
    return {o.method.name: by_name[o.method.base] for o in outcomes if o.method.base in by_name}


def _against(
    by_split: dict[str, list[MethodOutcome]], opponents: Callable[[list[MethodOutcome]], dict[str, MethodOutcome]]
) -> Against:
    """Ranked methods against their opponents on every split, by split, method and metric.

    All comparisons in one metric on one split are a family for Holm's correction: one question, asked of every method.
    """
    pairs = [
        (outcome, other)
        for outcomes in by_split.values()
        for against in [opponents(outcomes)]
        for outcome in outcomes
        if outcome.ranked and (other := against.get(outcome.method.name))
    ]
    compared = iter(all_paired([tables_of(*pair, name) for pair in pairs for name in PAIRED_METRICS]))
    results: Against = {split: {} for split in by_split}
    for outcome, _ in pairs:
        results[outcome.split][outcome.method.name] = {name: next(compared) for name in PAIRED_METRICS}
    for of_split in results.values():
        for name in PAIRED_METRICS:
            adjusted = holm([of_method[name].p for of_method in of_split.values()])
            for of_method, p in zip(of_split.values(), adjusted, strict=True):
                of_method[name] = replace(of_method[name], p_holm=p)
    return results


def _marks(outcomes: list[MethodOutcome], name: str, against_best: dict[str, dict[str, Paired]]) -> dict[str, Mark]:
    """Marks of one split in one metric; a tie outlives the paired test against the best, with Holm's correction.

    None where there are too few scenarios to say anything.
    """
    ranked = [outcome for outcome in outcomes if outcome.ranked]
    if name in OF_ARRIVED:
        ranked = [outcome for outcome in ranked if outcome.not_arrived <= 1 - MOSTLY]
    best = min(ranked, key=lambda outcome: outcome.estimates[name].iqm, default=None)
    if best is None or best.metrics[name].shape[1] < LEAST_SCENARIOS:
        return {}
    shown = {outcome.method.name for outcome in ranked}
    pairs = {method: of_method[name] for method, of_method in against_best.items()}
    classical = best_classical(outcomes)
    if best is not classical:
        others = [outcome for outcome in outcomes if outcome.ranked and outcome is not best]
        compared = all_paired([tables_of(other, best, name) for other in others])
        pairs = {other.method.name: pair for other, pair in zip(others, compared, strict=True)}
        if classical and best.method.name in against_best:  # a pair has one p value
            same = against_best[best.method.name][name]
            pairs[classical.method.name] = replace(pairs[classical.method.name], p=same.p)
        adjusted = holm([pair.p for pair in pairs.values()])
        pairs = {method: replace(pair, p_holm=p) for (method, pair), p in zip(pairs.items(), adjusted, strict=True)}
    marks: dict[str, Mark] = {method: "tie" for method, pair in pairs.items() if not pair.survives and method in shown}
    marks[best.method.name] = "best"
    return marks


def provenance(
    command: str, seconds: float, methods: Sequence[Method], chosen: dict[str, splits.Split]
) -> dict[str, Any]:
    """Provenance of the results: command, commit, digest of the code, scenarios, policies, packages."""
    packages = ("numpy", "numba", "gymnasium", "stable-baselines3", "torch")
    return {
        **about(MEASURES, seconds, STARTS),
        "command": command,
        "beltarm": __version__,
        "splits_version": splits.VERSION,
        "split_seeds": {name: split.seed for name, split in chosen.items()},
        "split_sha256": {name: split.digest for name, split in chosen.items()},
        "policies": policies_of(methods),
        "packages": {name: version(name) for name in packages},
    }
