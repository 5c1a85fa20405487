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
from dataclasses import dataclass, replace
from typing import Any, Literal

from baselines import CONTROLLERS
from beltarm_env.metrics import ARRIVAL_BOUND, NOT_ARRIVED
from eval.comparison.methods import is_shipped
from eval.comparison.results import PAIRED_METRICS, Comparison, MethodOutcome, tables_of
from eval.comparison.statistics import LEAST_SCENARIOS, Estimate, Paired, all_paired, holm, mean_differences
from eval.report.text import with_unit

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
class Duel:
    """A challenger against a classical controller on one split, in one metric."""

    challenger: MethodOutcome
    classical: MethodOutcome
    metric: str
    middle: Paired  # of interquartile means
    mean: Estimate  # of the difference, with its interval

    @property
    def result(self) -> Result:
        """Whether the challenger is better in both averages, worse in both, or neither."""
        if self.middle.survives and self.middle.difference.iqm < 0 and self.mean.high < 0:
            return "better"
        return "worse" if self.middle.survives and self.middle.difference.iqm > 0 and self.mean.low > 0 else "open"

    @property
    def relative(self) -> float:
        """Difference over the classical controller's value."""
        return self.middle.difference.iqm / max(self.classical.estimates[self.metric].iqm, 1e-12)


@dataclass(frozen=True, slots=True)
class Verdict:
    """What a comparison says of its primary question."""

    sentences: tuple[str, ...]
    duels: Mapping[str, Mapping[str, Duel]]  # by metric and split; empty where the question is not decided

    def rows(self) -> list[dict[str, Any]]:
        """The duels as entries of `results.json`."""
        return [
            {
                "metric": metric,
                "split": split,
                "challenger": duel.challenger.method.name,
                "classical": duel.classical.method.name,
                "result": duel.result,
                "iqm": duel.middle.difference.iqm,
                "low": duel.middle.difference.low,
                "high": duel.middle.difference.high,
                "p_holm": duel.middle.p_holm,
                "relative": duel.relative,
                "mean": duel.mean.iqm,
                "mean_low": duel.mean.low,
                "mean_high": duel.mean.high,
            }
            for metric, of_metric in self.duels.items()
            for split, duel in of_metric.items()
        ]


def verdict(comparison: Comparison) -> Verdict:
    """The answer on the main split and on all splits, what the arm's end does, and how a user's own methods do."""
    pair = comparison.rivals()
    if pair is None:
        return Verdict(_without_rivals(comparison), {})
    home = comparison.main_split
    own = [o for o in comparison.on(home) if o.ranked and not is_shipped(o.method) and o is not pair[0]]
    away = [sentence for o in [*pair, *own] if (sentence := _not_arrived(o))]
    episodes = pair[0].metrics["cost"].shape[1]
    if episodes < LEAST_SCENARIOS:
        few = (
            f"There is no verdict: {episodes} scenarios per split are too few, --episodes {LEAST_SCENARIOS} are enough."
        )
        return Verdict((few, *away), {})
    fought = {metric: duels(comparison, metric) for metric in PAIRED_METRICS}
    sentences = [_answer(fought["cost"][home], comparison)]
    if len(fought["cost"]) > 1:
        sentences.append(_everywhere(fought["cost"]))
    sentences += _of_tip(fought, home, pair)
    best = comparison.best_classical(home)
    sentences += [_costs(duel, home) for duel in _fought([(one, best) for one in own if best], "cost")]
    return Verdict((*sentences, *away), fought)


def _not_arrived(outcome: MethodOutcome) -> str:
    """Sentence about a method that does not always arrive; empty for one that does."""
    runs = outcome.metrics[NOT_ARRIVED]
    if not runs.any():
        return ""
    return (
        f"On {outcome.split}, {_name(outcome)} does not arrive in {int(runs.sum())} of {runs.size} runs: the mean "
        f"error after the move is more than {1000 * ARRIVAL_BOUND:g} mm."
    )


def duels(comparison: Comparison, metric: str = "cost") -> dict[str, Duel]:
    """Duels of the primary comparison by split, corrected for the number of splits; none where nothing is decided."""
    pair = comparison.rivals()
    if pair is None:
        return {}
    pairs = []
    for split in comparison.splits():
        by_name = {outcome.method.name: outcome for outcome in comparison.on(split)}
        one, other = (by_name.get(rival.method.name) for rival in pair)
        if one and other:
            pairs.append((one, other))
    found = _fought(pairs, metric)
    adjusted = holm([duel.middle.p for duel in found])
    return {
        duel.challenger.split: replace(duel, middle=replace(duel.middle, p_holm=p))
        for duel, p in zip(found, adjusted, strict=True)
    }


def _fought(pairs: Sequence[tuple[MethodOutcome, MethodOutcome]], metric: str) -> list[Duel]:
    """Duels of pairs in one metric, not corrected for their number; none of too few scenarios to decide anything."""
    tables = [tables_of(one, other, metric) for one, other in pairs]
    enough = [k for k, (values, _) in enumerate(tables) if values.shape[1] >= LEAST_SCENARIOS]
    pairs, tables = [pairs[k] for k in enough], [tables[k] for k in enough]
    compared = zip(pairs, all_paired(tables), mean_differences(tables), strict=True)
    return [Duel(one, other, metric, replace(found, p_holm=found.p), mean) for (one, other), found, mean in compared]


def _answer(duel: Duel, comparison: Comparison) -> str:
    one, other, split = duel.challenger, duel.classical, comparison.main_split
    of_kind = [o for o in comparison.on(split) if o.method.kind == one.method.kind]
    first = min(of_kind, key=_of_cost) is one
    classical = "best " if comparison.best_classical(split) is other else ""
    learned = f"the {'best ' if first else ''}{_KINDS[one.method.kind]}, {one.method.name},"
    return _costs(duel, split, learned, f"the {classical}classical controller, {other.method.name}")


def _costs(duel: Duel, split: str, one: str = "", other: str = "") -> str:
    """Sentence about the cost on one split."""
    one, other = one or duel.challenger.method.name, other or duel.classical.method.name
    pair = duel.challenger, duel.classical
    middle, mean = (" against ".join(f"{average(o):.0f}" for o in pair) for average in (_of_cost, _mean))
    numbers = f"averages: {middle}; mean of all runs {mean}"
    if duel.result == "open":
        return f"On {split}, no difference in cost is shown between {one} and {other} ({numbers})."
    size, less = abs(duel.relative), "less than" if duel.result == "better" else "more than"
    shown = f"{size:.0%} {less}" if size < 1 else f"{1 + size:.1f} times as much as"
    tie = ": a practical tie" if size < _PRACTICALLY_EQUAL else ""
    return f"On {split}, scenario by scenario, {one} costs {shown} {other} ({numbers}){tie}."


def _everywhere(fought: Mapping[str, Duel]) -> str:
    name = next(iter(fought.values())).challenger.method.name
    words = {"better": "{0} costs less", "worse": "{0} costs more", "open": "no difference is shown"}
    parts = [
        f"On {_listed(splits, len(fought))} {words[result].format(name)}."
        for result, splits in _by_result(fought).items()
    ]
    return " ".join(parts)


def _by_result(fought: Mapping[str, Duel]) -> dict[Result, list[str]]:
    """Splits by result; only results that there are."""
    found: dict[Result, list[str]] = {
        result: [split for split, duel in fought.items() if duel.result == result] for result in _RESULTS
    }
    return {result: splits for result, splits in found.items() if splits}


def _listed(splits: list[str], total: int) -> str:
    return f"all {total} splits" if len(splits) == total else f"{len(splits)} of {total} splits ({', '.join(splits)})"


def _of_tip(
    fought: Mapping[str, Mapping[str, Duel]], home: str, pair: tuple[MethodOutcome, MethodOutcome]
) -> list[str]:
    """What the arm's end does: vibration after the move, and error on the way; a sentence each."""
    sentences = []
    for metric, words in _TIP.items():
        if home not in fought[metric]:
            names = " and ".join(_name(outcome) for outcome in pair)
            sentences.append(f"The vibration after the move is not compared: {names} arrive both in too few scenarios.")
            continue
        duel = fought[metric][home]
        shown = " and ".join(f"{_shown(metric, outcome)} with {_name(outcome)}" for outcome in pair)
        left_out = [split for split in fought["cost"] if split not in fought[metric]]
        others = f", not compared on {', '.join(left_out)}" if left_out else ""
        elsewhere = _elsewhere(fought[metric], duel.result)
        sentences.append(f"{words.format(shown)}: {_RESULTS[duel.result]}{elsewhere}{others}.")
    return sentences


def _elsewhere(fought: Mapping[str, Duel], result: Result) -> str:
    """How many splits have this result too, and which have another."""
    if len(fought) == 1:
        return ""
    by_result = _by_result(fought)
    same = by_result.pop(result)
    everywhere = len(same) == len(fought)
    others = "".join(f", {_RESULTS[other]} on {', '.join(splits)}" for other, splits in by_result.items())
    return f", as on {f'all {len(fought)}' if everywhere else f'{len(same)} of {len(fought)}'} splits{others}"


def _shown(metric: str, outcome: MethodOutcome) -> str:
    return with_unit(metric, f"{outcome.estimates[metric].iqm:.2f}")


def _name(outcome: MethodOutcome) -> str:
    return outcome.method.name


def _of_cost(outcome: MethodOutcome) -> float:
    return outcome.estimates["cost"].iqm


def _mean(outcome: MethodOutcome) -> float:
    return float(outcome.metrics["cost"].mean())


def _without_rivals(comparison: Comparison) -> tuple[str, ...]:
    leaders = {split: best for split in comparison.splits() if (best := comparison.best_classical(split))}
    if not leaders:
        return (
            "No classical controller took part, so nothing can be said of learned against classical ones.",
            "Name one with --methods to compare with it.",
        )
    failed = any(failure.method not in CONTROLLERS for failure in comparison.failures)
    missing = "a learned method could not be run" if failed else "no learned method took part"
    names = "; ".join(f"{split}: {best.method.name} ({_of_cost(best):.0f})" for split, best in leaders.items())
    return (
        f"Learned against classical is not decided here: {missing}.",
        f"The lowest cost among the classical controllers, by split: {names}.",
    )
