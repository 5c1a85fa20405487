"""Verdict of a comparison: its numbers here, its sentences in `verdict.txt.j2`.

docs/benchmark/protocol.md fixed the question before the test scenarios were drawn: does the learned method beat the
classical one, both chosen on the development set (`eval.comparison.methods.PRIMARY`)? "Better" takes both averages,
for an interquartile mean alone drops the worst quarter of the arms: the difference of interquartile means outlives
Holm's correction over all splits, and the 95 % interval of the mean difference is clear of zero. Fewer than
`eval.comparison.statistics.LEAST_SCENARIOS` scenarios decide nothing.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import jinja2

from baselines import CONTROLLERS, DOMINATED
from beltarm_env.metrics import ARRIVAL_BOUND, NOT_ARRIVED
from beltarm_env.task.cost import STILL_BAND
from eval.comparison.methods import PRIMARY, PRIVILEGED, is_shipped, learned_names, shipped_policies
from eval.comparison.results import PAIRED_METRICS, Comparison, MethodOutcome, tables_of
from eval.comparison.splits import EPISODES, MOVES, SPLITS
from eval.comparison.statistics import LEAST_SCENARIOS, Estimate, Paired, all_paired, average, holm, mean_differences

Result = Literal["better", "worse", "open"]

PRACTICALLY_EQUAL = 0.03
"""Share of the cost below which a difference that is shown is called a practical tie."""


def is_tie(metric: str, result: Result, relative: float) -> bool:
    """Tell whether a test shows a difference in cost that is a practical tie."""
    return metric == "cost" and result != "open" and abs(relative) < PRACTICALLY_EQUAL


_KINDS = {"learned": "learned method", "classical": "classical controller", "added": "added controller"}


def called(name: str, kind: str, ranking: Sequence[str]) -> str:
    """Call a method by its kind, and the best by its rank in all of them, or in those alone that took part."""
    usual = {"classical": {*CONTROLLERS} - {*DOMINATED}, "learned": {*learned_names()}}
    best = "best " if ranking[0] == name else ""
    here = " of this run" if best and usual.get(kind, set[str]()) - {*ranking} else ""
    return f"the {best}{_KINDS[kind]}{here}, {name}"


_WORDS: dict[str, Any] = {
    "practically_equal": PRACTICALLY_EQUAL,
    "is_tie": is_tie,
    "least": LEAST_SCENARIOS,
    "whole": EPISODES,
    "all_moves": MOVES,
    "arrival_mm": f"{1000 * ARRIVAL_BOUND:g}",
    "still_mm": f"{1000 * STILL_BAND:g}",
}
_TEMPLATE = jinja2.Environment(
    loader=jinja2.FileSystemLoader(Path(__file__).parent),
    undefined=jinja2.StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
).get_template("verdict.txt.j2", globals=_WORDS)


@dataclass(frozen=True, slots=True)
class PairwiseTest:
    """A challenger against a classical controller on one split, in one metric."""

    challenger: MethodOutcome
    classical: MethodOutcome
    metric: str
    middle: Paired  # of interquartile means
    mean: Estimate  # of the difference, with its interval
    averages: tuple[float, float]  # of both, over the scenarios that are compared

    @property
    def split(self) -> str:
        """Split of both."""
        return self.challenger.split

    @property
    def result(self) -> Result:
        """Whether the challenger is better in both averages, worse in both, or neither."""
        if self.middle.better and self.mean.high < 0:
            return "better"
        return "worse" if self.middle.survives and self.middle.difference.iqm > 0 and self.mean.low > 0 else "open"

    @property
    def alone(self) -> str:
        """What is shown of one average where the other does not show it; empty for nothing."""
        shown = list[str]()
        if self.middle.survives:
            shown.append(f"the interquartile mean is {'lower' if self.middle.difference.iqm < 0 else 'higher'}")
        if self.mean.high < 0 or self.mean.low > 0:
            shown.append(f"the mean is {'lower' if self.mean.high < 0 else 'higher'}")
        return " and ".join(shown) if self.result == "open" else ""

    @property
    def relative(self) -> float:
        """Difference over the classical controller's value."""
        return self.middle.difference.iqm / max(self.classical.estimates[self.metric].iqm, 1e-12)

    def row(self) -> dict[str, Any]:
        """Entry of `results.json`."""
        return {
            "metric": self.metric,
            "split": self.split,
            "challenger": self.challenger.name,
            "classical": self.classical.name,
            "result": self.result,
            **asdict(self.middle.difference),
            "p_holm": self.middle.p_holm,
            "relative": self.relative,
            "mean": self.mean.iqm,
            "mean_low": self.mean.low,
            "mean_high": self.mean.high,
        }


def verdict(comparison: Comparison) -> tuple[list[str], list[dict[str, Any]]]:
    """Decide the primary comparison: sentences, and tests for `results.json`, none where nothing is decided."""
    pair, home = comparison.primary_pair(), comparison.main_split
    if pair is None:
        best = [comparison.best_classical(split) for split in comparison.splits()]
        failures = {failure.method.removesuffix("+guard") for failure in comparison.failures}
        words = {"failed": failures - {*CONTROLLERS, PRIVILEGED}, "lost": failures & {*CONTROLLERS}}
        return _sentences(pair=pair, leaders=[one for one in best if one], away=[], **words), []
    ranked = [outcome for outcome in comparison.on(home) if outcome.ranked]
    own = [outcome for outcome in ranked if not is_shipped(outcome.method) and outcome is not pair[0]]
    arrivals = [(outcome, outcome.metrics[NOT_ARRIVED]) for outcome in (*pair, *own)]
    away = [(outcome, shares) for outcome, shares in arrivals if shares.any()]
    words = {"pair": pair, "home": home, "moves": pair[0].moves, "away": away, "asked": _asked(comparison)}
    words |= {"policies": pair[0].seeds, "all_policies": len(shipped_policies(method=pair[0].name))}
    episodes = pair[0].metrics["cost"].shape[1]
    if episodes < LEAST_SCENARIOS:
        return _sentences(tests={}, episodes=episodes, **words), []
    tests = {metric: pairwise_tests(comparison, metric) for metric in PAIRED_METRICS}
    best = comparison.best_classical(home)
    ordered = sorted(ranked, key=lambda outcome: outcome.cost)
    titles = [called(m.name, m.method.kind, [o.name for o in ordered if o.method.kind == m.method.kind]) for m in pair]
    against = [each for each in comparison.pairs if (each.against, each.outcome.split) == ("best classical", home)]
    corrected = {each.outcome.name: each.metrics["cost"] for each in against}  # for all methods of this split
    of_own = _tested([(outcome, best) for outcome in own if best], "cost")
    of_own = [replace(test, middle=corrected[test.challenger.name]) for test in of_own]
    sentences = _sentences(tests=tests, titles=titles, own=of_own, episodes=episodes, **words)
    return sentences, [test.row() for of_metric in tests.values() for test in of_metric.values()]


def _sentences(**numbers: Any) -> list[str]:
    return [" ".join(part.split()) for part in _TEMPLATE.render(numbers).split("\n\n") if part.strip()]


def pairwise_tests(comparison: Comparison, metric: str = "cost") -> dict[str, PairwiseTest]:
    """Tests of the primary comparison by split, corrected for their number; none where nothing is decided.

    A challenger that the protocol does not name is the best of some on these scenarios: they are counted as well.
    """
    pair = comparison.primary_pair()
    if pair is None:
        return {}
    names = pair[0].name, pair[1].name
    by_split = [{outcome.name: outcome for outcome in comparison.on(split)} for split in comparison.splits()]
    pairs = [(of_split[names[0]], of_split[names[1]]) for of_split in by_split if {*names} <= of_split.keys()]
    tests = _tested(pairs, metric)
    undecided = [1.0] * (len(_asked(comparison)) - len(tests))  # which belong to the family
    challengers = 1 if names == PRIMARY else len(comparison.challengers(comparison.main_split))
    adjusted = holm([*(min(1.0, challengers * test.middle.p) for test in tests), *undecided])
    corrected = zip(tests, adjusted, strict=False)
    return {test.split: replace(test, middle=replace(test.middle, p_holm=p)) for test, p in corrected}


def _asked(comparison: Comparison) -> list[str]:
    """Splits that were asked for, those where all methods failed last."""
    failed = [failure.split for failure in comparison.failures if failure.split in SPLITS]
    return list(dict.fromkeys([*comparison.splits(), *failed]))


def _tested(pairs: Sequence[tuple[MethodOutcome, MethodOutcome]], metric: str) -> list[PairwiseTest]:
    """Tests of pairs in one metric, not corrected for their number; none of too few scenarios to decide anything."""
    tables = [tables_of(*pair, metric) for pair in pairs]
    enough = [k for k, (values, _) in enumerate(tables) if values.shape[1] >= LEAST_SCENARIOS]
    pairs, tables = [pairs[k] for k in enough], [tables[k] for k in enough]
    middles = [replace(middle, p_holm=middle.p) for middle in all_paired(tables)]
    averages = [(average(metric, values), average(metric, others)) for values, others in tables]
    compared = zip(pairs, middles, mean_differences(tables), averages, strict=True)
    return [PairwiseTest(*pair, metric, middle, mean, both) for pair, middle, mean, both in compared]
