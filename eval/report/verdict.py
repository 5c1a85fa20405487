"""Verdict of a comparison in a few plain sentences, made from the numbers alone.

One question comes first: does the best learned method beat the best classical controller? Both were chosen on the
development set (`eval.comparison.methods.PRIMARY`), and they are compared scenario by scenario on every split, in the
cost and in what the arm's end does. "Better" takes both averages: the difference of interquartile means outlives Holm's
correction over all splits, and the 95 % interval of the mean difference is clear of zero. An interquartile mean alone
drops the worst quarter of the arms. docs/benchmark/protocol.md fixed this before the test scenarios were drawn.

Vibration is compared where both arrive: a method that never moves does not vibrate. Fewer than
`eval.comparison.statistics.LEAST_SCENARIOS` scenarios decide nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

from baselines import CONTROLLERS
from beltarm_env.metrics import ARRIVAL_BOUND, METRICS, NOT_ARRIVED
from eval.comparison.methods import is_shipped
from eval.comparison.results import PAIRED_METRICS, Comparison, MethodOutcome, tables_of
from eval.comparison.statistics import LEAST_SCENARIOS, Estimate, Paired, all_paired, holm, mean_differences

Result = Literal["better", "worse", "open"]

_PRACTICALLY_EQUAL = 0.03
"""Share of the cost below which a difference that is shown is called a practical tie."""
_KINDS = {"learned": "learned method", "added": "added controller"}
_TIP = {
    "residual_pp_mm": "After the move the arm's end still swings by {}",
    "tip_rms_mm": "Over the whole episode its error is {}",
}
_RESULTS: dict[Result, str] = {"better": "better", "worse": "worse", "open": "no difference shown"}


@dataclass(frozen=True, slots=True)
class PairwiseTest:
    """A challenger against a classical controller on one split, in one metric."""

    challenger: MethodOutcome
    classical: MethodOutcome
    metric: str
    middle: Paired  # of interquartile means
    mean: Estimate  # of the difference, with its interval

    @property
    def result(self) -> Result:
        """Whether the challenger is better in both averages, worse in both, or neither."""
        if self.middle.better and self.mean.high < 0:
            return "better"
        return "worse" if self.middle.survives and self.middle.difference.iqm > 0 and self.mean.low > 0 else "open"

    @property
    def relative(self) -> float:
        """Difference over the classical controller's value."""
        return self.middle.difference.iqm / max(self.classical.estimates[self.metric].iqm, 1e-12)

    def row(self) -> dict[str, Any]:
        """Entry of `results.json`."""
        return {
            "metric": self.metric,
            "split": self.challenger.split,
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
    """Decide the primary comparison.

    Returns:
        Sentences, with one for each of a user's own methods; and the pairwise tests as entries of `results.json`, none
        where the question is not decided.
    """
    pair = comparison.primary_pair()
    if pair is None:
        return _without_pair(comparison), []
    home = comparison.main_split
    own = [o for o in comparison.on(home) if o.ranked and not is_shipped(o.method) and o is not pair[0]]
    away = [
        f"On {home}, {o.name} does not arrive in {int(runs.sum())} of {runs.size} runs: the mean error after the move "
        f"is more than {1000 * ARRIVAL_BOUND:g} mm."
        for o in [*pair, *own]
        if (runs := o.metrics[NOT_ARRIVED]).any()
    ]
    episodes = pair[0].metrics["cost"].shape[1]
    if episodes < LEAST_SCENARIOS:
        few = (
            f"There is no verdict: {episodes} scenarios per split are too few, --episodes {LEAST_SCENARIOS} are enough."
        )
        return [few, *away], []
    tests = {metric: pairwise_tests(comparison, metric) for metric in PAIRED_METRICS}
    sentences = [_answer(tests["cost"][home], comparison)]
    if len(tests["cost"]) > 1:
        words = {"better": f"{pair[0].name} costs less", "worse": f"{pair[0].name} costs more"}
        everywhere = []
        for result, splits in _by_result(tests["cost"]).items():
            listed = f"{len(splits)} of {len(tests['cost'])} splits ({', '.join(splits)})"
            where = f"all {len(splits)} splits" if len(splits) == len(tests["cost"]) else listed
            everywhere.append(f"On {where} {words.get(result, 'no difference is shown')}.")
        sentences.append(" ".join(everywhere))
    sentences += _of_tip(tests, home, pair)
    best = comparison.best_classical(home)
    sentences += [_costs(test, home) for test in _tested([(outcome, best) for outcome in own if best], "cost")]
    return [*sentences, *away], [test.row() for of_metric in tests.values() for test in of_metric.values()]


def pairwise_tests(comparison: Comparison, metric: str = "cost") -> dict[str, PairwiseTest]:
    """Tests of the primary comparison by split, corrected for the number of splits; none where nothing is decided."""
    pair = comparison.primary_pair()
    if pair is None:
        return {}
    pairs = []
    for split in comparison.splits():
        by_name = {outcome.name: outcome for outcome in comparison.on(split)}
        challenger, classical = (by_name.get(member.name) for member in pair)
        if challenger and classical:
            pairs.append((challenger, classical))
    tests = _tested(pairs, metric)
    adjusted = holm([test.middle.p for test in tests])
    return {
        test.challenger.split: replace(test, middle=replace(test.middle, p_holm=p))
        for test, p in zip(tests, adjusted, strict=True)
    }


def _tested(pairs: Sequence[tuple[MethodOutcome, MethodOutcome]], metric: str) -> list[PairwiseTest]:
    """Tests of pairs in one metric, not corrected for their number; none of too few scenarios to decide anything."""
    tables = [tables_of(*pair, metric) for pair in pairs]
    enough = [k for k, (values, _) in enumerate(tables) if values.shape[1] >= LEAST_SCENARIOS]
    pairs, tables = [pairs[k] for k in enough], [tables[k] for k in enough]
    compared = zip(pairs, all_paired(tables), mean_differences(tables), strict=True)
    return [PairwiseTest(*pair, metric, replace(middle, p_holm=middle.p), mean) for pair, middle, mean in compared]


def _answer(test: PairwiseTest, comparison: Comparison) -> str:
    challenger, classical, split = test.challenger, test.classical, comparison.main_split
    of_kind = [outcome for outcome in comparison.on(split) if outcome.method.kind == challenger.method.kind]
    first = "best " if min(of_kind, key=lambda outcome: outcome.cost) is challenger else ""
    best = "best " if comparison.best_classical(split) is classical else ""
    named = f"the {first}{_KINDS[challenger.method.kind]}, {challenger.name},"
    return _costs(test, split, named, f"the {best}classical controller, {classical.name}")


def _costs(test: PairwiseTest, split: str, challenger: str = "", classical: str = "") -> str:
    """Sentence about the cost on one split."""
    challenger, classical = challenger or test.challenger.name, classical or test.classical.name
    pair = test.challenger, test.classical
    middle = " against ".join(f"{outcome.cost:.0f}" for outcome in pair)
    mean = " against ".join(f"{outcome.metrics['cost'].mean():.0f}" for outcome in pair)
    numbers = f"averages: {middle}; mean of all runs {mean}"
    if test.result == "open":
        return f"On {split}, no difference in cost is shown between {challenger} and {classical} ({numbers})."
    size, less = abs(test.relative), "less than" if test.result == "better" else "more than"
    shown = f"{size:.0%} {less}" if size < 1 else f"{1 + size:.1f} times as much as"
    tie = ": a practical tie" if size < _PRACTICALLY_EQUAL else ""
    return f"On {split}, scenario by scenario, {challenger} costs {shown} {classical} ({numbers}){tie}."


def _by_result(tests: Mapping[str, PairwiseTest]) -> dict[Result, list[str]]:
    """Splits by result; only results that there are."""
    results: list[Result] = [result for result in _RESULTS if any(test.result == result for test in tests.values())]
    return {result: [split for split, test in tests.items() if test.result == result] for result in results}


def _of_tip(
    tests: Mapping[str, Mapping[str, PairwiseTest]], home: str, pair: tuple[MethodOutcome, MethodOutcome]
) -> list[str]:
    """Sentences about the error of the arm's end: its vibration after the move, and over the whole episode."""
    sentences = []
    for metric, words in _TIP.items():
        if home not in tests[metric]:
            names = " and ".join(outcome.name for outcome in pair)
            sentences.append(f"The vibration after the move is not compared: {names} arrive both in too few scenarios.")
            continue
        test = tests[metric][home]
        values = (f"{outcome.estimates[metric].iqm:.2f} {METRICS[metric].unit}".rstrip() for outcome in pair)
        shown = " and ".join(f"{value} with {outcome.name}" for value, outcome in zip(values, pair, strict=True))
        left_out = [split for split in tests["cost"] if split not in tests[metric]]
        others = f", not compared on {', '.join(left_out)}" if left_out else ""
        elsewhere = _elsewhere(tests[metric], test.result)
        sentences.append(f"{words.format(shown)}: {_RESULTS[test.result]}{elsewhere}{others}.")
    return sentences


def _elsewhere(tests: Mapping[str, PairwiseTest], result: Result) -> str:
    """Number of splits with the same result, and names of those with another."""
    if len(tests) == 1:
        return ""
    by_result = _by_result(tests)
    same = by_result.pop(result)
    count = f"all {len(tests)}" if len(same) == len(tests) else f"{len(same)} of {len(tests)}"
    others = "".join(f", {_RESULTS[other]} on {', '.join(splits)}" for other, splits in by_result.items())
    return f", as on {count} splits{others}"


def _without_pair(comparison: Comparison) -> list[str]:
    leaders = {split: best for split in comparison.splits() if (best := comparison.best_classical(split))}
    if not leaders:
        return [
            "No classical controller took part, so nothing can be said of learned against classical ones.",
            "Name one with --methods to compare with it.",
        ]
    failed = any(failure.method not in CONTROLLERS for failure in comparison.failures)
    missing = "a learned method could not be run" if failed else "no learned method took part"
    names = "; ".join(f"{split}: {best.name} ({best.cost:.0f})" for split, best in leaders.items())
    return [
        f"Learned against classical is not decided here: {missing}.",
        f"The lowest cost among the classical controllers, by split: {names}.",
    ]
