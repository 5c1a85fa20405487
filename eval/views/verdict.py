"""Verdict of a comparison in a few plain sentences, made from the numbers alone.

One question comes first: does the best learned method beat the best classical controller? Both are those of the lowest
cost on the main split, and they are compared scenario by scenario on every split. "Better" takes both averages: the
difference of interquartile means outlives Holm's correction over all splits, and the 95 % interval of the mean
difference is clear of zero. An interquartile mean alone drops the worst quarter of the arms.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from eval.comparison.estimates import Estimate, Paired, estimate, holm, paired
from eval.comparison.results import Comparison, MethodOutcome
from eval.style.metrics import with_unit

Result = Literal["better", "worse", "open"]

_PRACTICALLY_EQUAL = 0.03
"""Share of the cost below which a difference that is shown is called a practical tie."""
_KINDS = {"learned": "learned method", "added": "added controller"}
_VIBRATION = {"residual_pp_mm": "After the move the arm's end still swings by {}", "tip_rms_mm": "its error is {}"}
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


def duels(comparison: Comparison, metric: str = "cost") -> dict[str, Duel]:
    """Duels of the best challenger and the best classical controller by split, chosen by cost on the main one.

    Empty where there is no challenger, or no classical controller.
    """
    home = comparison.main_split
    rivals, best = comparison.challengers(home), comparison.best_classical(home)
    if not rivals or best is None:
        return {}
    found: dict[str, Duel] = {}
    for split in comparison.splits():
        by_name = {outcome.method.name: outcome for outcome in comparison.on(split)}
        one, other = by_name.get(rivals[0].method.name), by_name.get(best.method.name)
        if one is None or other is None:
            continue
        values, theirs = one.metrics[metric], other.metrics[metric]
        mean = estimate(values - theirs.mean(axis=0, keepdims=True), mean=True)
        found[split] = Duel(one, other, metric, paired(values, theirs), mean)
    adjusted = holm([duel.middle.p for duel in found.values()])
    return {
        split: replace(duel, middle=replace(duel.middle, p_holm=p))
        for (split, duel), p in zip(found.items(), adjusted, strict=True)
    }


def verdict(comparison: Comparison) -> list[str]:
    """Sentences: the answer on the main split, on all splits, and what the arm's end does."""
    fought = duels(comparison)
    home = fought.get(comparison.main_split)
    if home is None:
        return _without_challenger(comparison)
    sentences = [_answer(home, comparison.main_split)]
    if len(fought) > 1:
        sentences.append(_everywhere(fought))
    return [*sentences, _vibration(comparison)]


def _answer(duel: Duel, split: str) -> str:
    one, other = duel.challenger, duel.classical
    learned = f"the best {_KINDS[one.method.kind]}, {one.method.name},"
    classical = f"the best classical controller, {other.method.name}"
    numbers = f"{_cost(one)} against {_cost(other)}; mean of all runs {_mean(one)} against {_mean(other)}"
    if duel.result == "open":
        return f"On {split}, no difference in cost is shown between {learned} and {classical} ({numbers})."
    size, less = abs(duel.relative), "less than" if duel.result == "better" else "more than"
    shown = f"{size:.0%} {less}" if size < 1 else f"{1 + size:.1f} times as much as"
    tie = ": a practical tie" if size < _PRACTICALLY_EQUAL else ""
    return f"On {split}, {learned} costs {shown} {classical} ({numbers}){tie}."


def _everywhere(fought: dict[str, Duel]) -> str:
    name = next(iter(fought.values())).challenger.method.name
    by_result: dict[Result, list[str]] = {
        result: [split for split, duel in fought.items() if duel.result == result]
        for result in ("better", "worse", "open")
    }
    words = {
        "better": "{0} costs less on {1}",
        "worse": "{0} costs more on {1}",
        "open": "no difference is shown on {1}",
    }
    parts = [words[result].format(name, _listed(splits, len(fought))) for result, splits in by_result.items() if splits]
    return f"{'; '.join(parts)}."


def _listed(splits: list[str], total: int) -> str:
    return f"all {total} splits" if len(splits) == total else f"{len(splits)} of {total} splits ({', '.join(splits)})"


def _vibration(comparison: Comparison) -> str:
    """What the arm's end does on the main split: vibration after the move, and error on the way."""
    parts = []
    for metric, words in _VIBRATION.items():
        duel = duels(comparison, metric)[comparison.main_split]
        pair = (duel.challenger, duel.classical)
        shown = " and ".join(f"{_shown(metric, outcome)} with {outcome.method.name}" for outcome in pair)
        parts.append(f"{words.format(shown)} ({_RESULTS[duel.result]})")
    return f"{'; over the whole episode '.join(parts)}."


def _shown(metric: str, outcome: MethodOutcome) -> str:
    return with_unit(metric, f"{outcome.estimates[metric].iqm:.2f}")


def _cost(outcome: MethodOutcome) -> str:
    return f"{outcome.estimates['cost'].iqm:.0f}"


def _mean(outcome: MethodOutcome) -> str:
    return f"{outcome.metrics['cost'].mean():.0f}"


def _without_challenger(comparison: Comparison) -> list[str]:
    leaders = {split: best for split in comparison.splits() if (best := comparison.best_classical(split))}
    if not leaders:
        return [
            "No classical controller took part, so nothing can be said of learned against classical ones.",
            "Name one with --methods to compare with it.",
        ]
    missing = "a learned method could not be run" if comparison.failures else "no learned method took part"
    names = "; ".join(f"{split}: {best.method.name} ({_cost(best)})" for split, best in leaders.items())
    return [
        f"Learned against classical is not decided here: {missing}.",
        f"The lowest cost among the classical controllers, by split: {names}.",
    ]
