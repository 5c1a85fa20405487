"""Verdict of the report: three sentences, made from the numbers alone."""

from __future__ import annotations

from dataclasses import dataclass, replace

from beltarm_env.metrics import METRICS
from eval.comparison.estimates import Estimate, Paired, holm, paired
from eval.comparison.results import Comparison, MethodOutcome
from eval.style.metrics import cell, numbers, with_unit
from eval.views.report.scenes import challengers

_KINDS = {"learned": "learned method", "added": "added controller"}


@dataclass(frozen=True, slots=True)
class Duel:
    """Best challenger of a split against its best classical controller."""

    split: str
    challenger: MethodOutcome
    classical: MethodOutcome
    pairs: dict[str, Paired]

    @property
    def result(self) -> str:
        """`wins`, `loses` or `ties`: a difference counts if it outlives Holm's correction."""
        pair = self.pairs["cost"]
        if not pair.survives:
            return "ties"
        return "loses" if pair.difference.iqm > 0 else "wins"

    @property
    def relative(self) -> float:
        """Difference in cost over the classical controller's cost."""
        return self.pairs["cost"].difference.iqm / self.classical.estimates["cost"].iqm


def duels(comparison: Comparison) -> list[Duel]:
    """Duels of all splits that have both a challenger and a classical controller."""
    found = []
    for split in comparison.splits():
        rivals, best = challengers(comparison, split), comparison.best_classical(split)
        if rivals and best:
            pairs = comparison.against_best[split][rivals[0].method.name]
            found.append(Duel(split, rivals[0], best, pairs))
    return found


def verdict(comparison: Comparison) -> list[str]:
    """Three sentences: who wins where, where the challenger does best, and where it does worst."""
    fought = duels(comparison)
    if not fought:
        return _without_challenger(comparison)
    kind = _KINDS[fought[0].challenger.method.kind]
    home = next((duel for duel in fought if duel.split == comparison.main_split), fought[0])
    best, worst = min(fought, key=lambda duel: duel.relative), max(fought, key=lambda duel: duel.relative)
    first = _count(fought, kind) + _among_all(home, comparison.on(home.split)) + "."
    return [first, _best(best), _other_metrics(best) if best is worst else _worst(worst, kind)]


def _count(fought: list[Duel], kind: str) -> str:
    leads = {"wins": "beats {} on {}", "loses": "loses to {} on {}", "ties": "is not shown to differ from {} on {}"}
    parts = []
    for result, lead in leads.items():
        splits = [duel.split for duel in fought if duel.result == result]
        if splits:
            other = "it" if parts else "the best classical controller"
            parts.append(lead.format(other, _listed(splits, len(fought))))
    *before, last = parts
    return f"In cost, the best {kind} {', '.join(before)}{' and ' if before else ''}{last}"


def _among_all(duel: Duel, outcomes: list[MethodOutcome]) -> str:
    """Words for the number of classical controllers beaten, where the best is not."""
    classical = [outcome for outcome in outcomes if outcome.method.kind == "classical"]
    if duel.result == "wins" or len(classical) < 2:
        return ""
    pairs = [paired(duel.challenger.metrics["cost"], outcome.metrics["cost"]) for outcome in classical]
    adjusted = holm([pair.p for pair in pairs])
    beaten = sum(replace(pair, p_holm=p).better for pair, p in zip(pairs, adjusted, strict=True))
    count = f"{beaten} of the {len(classical)}" if beaten else f"none of the {len(classical)}"
    return f"; on {duel.split} {duel.challenger.method.name} beats {count} classical controllers"


def _listed(splits: list[str], total: int) -> str:
    if len(splits) == total:
        return f"all {total} splits" if total > 1 else f"the only split, {splits[0]}"
    return f"{len(splits)} of {total} splits ({', '.join(splits)})"


def _best(duel: Duel) -> str:
    lead = {"wins": "It wins most", "ties": "It does best, but without a difference shown,"}
    return f"{lead.get(duel.result, 'It loses least')} on {duel.split}{_by(duel)}: {_difference(duel)}."


def _worst(duel: Duel, kind: str) -> str:
    lead = {
        "loses": f"The {kind} loses most",
        "ties": f"The {kind} loses on no split; it does worst, without a difference shown,",
    }.get(duel.result, f"The {kind} loses on no split; it wins least")
    return f"{lead} on {duel.split}{_by(duel)}: {_difference(duel)}."


def _by(duel: Duel) -> str:
    """Words for the difference relative to the classical controller's cost, by which most and least are told."""
    if duel.result == "ties":
        return ""
    size = abs(duel.relative)
    shown = f"{size:.{0 if size > 9.95 else 1}f} times" if size > 1.995 else f"{size:.0%} of"
    return f", by {shown} the other’s cost"


def _difference(duel: Duel) -> str:
    pair = duel.pairs["cost"]
    one, other = duel.challenger, duel.classical
    of_one, of_other = (outcome.estimates["cost"].iqm for outcome in (one, other))
    return (
        f"{one.method.name} has a cost of {of_one:.0f}, {other.method.name} of {of_other:.0f}; run by run the "
        f"difference is {signed('cost', pair.difference)}, and {one.method.name} is the better one in "
        f"{_share(pair.win_rate.iqm)}"
    )


def _share(share: float) -> str:
    if share in (0.0, 1.0):
        return "all runs" if share else "none of the runs"
    if share < 0.005 or share > 0.995:
        return "over 99% of the runs" if share > 0.5 else "under 1% of the runs"
    return f"{share:.0%} of the runs"


def signed(name: str, value: Estimate) -> str:
    """A difference with its interval, such as `−20 [−101, +85]`."""
    point, low, high = (
        number.replace("-", "−") if number.startswith("-") else f"+{number}" for number in numbers(name, value)
    )
    return f"{point} [{low}, {high}]"


def _other_metrics(duel: Duel) -> str:
    parts = []
    for name in ("tip_rms_mm", "residual_pp_mm"):
        pair = duel.pairs[name]
        word = pair.verdict if pair.survives else "no difference shown"
        parts.append(f"{METRICS[name].title} {word} ({with_unit(name, signed(name, pair.difference))})")
    return f"In other metrics {duel.challenger.method.name} against {duel.classical.method.name}: {'; '.join(parts)}."


def _without_challenger(comparison: Comparison) -> list[str]:
    leaders = {split: best for split in comparison.splits() if (best := comparison.best_classical(split))}
    if not leaders:
        return [
            "No classical controller took part, so that nothing can be said of learned against classical ones.",
            "The table below has what was measured.",
            "Run it with `--methods` naming a classical controller as well.",
        ]
    missing = "a learned method could be run on no split" if comparison.failures else "no learned method took part"
    names = "; ".join(
        f"{split}: {best.method.name} ({cell('cost', best.estimates['cost'])})" for split, best in leaders.items()
    )
    against_best = {split: comparison.against_best[split].items() for split in leaders}
    ties = {split: [name for name, p in pairs if not p["cost"].survives] for split, pairs in against_best.items()}
    tied = [f"{split} ({', '.join(found)})" for split, found in ties.items() if found]
    return [
        f"Learned against classical is not decided here: {missing}.",
        f"The lowest cost among the classical controllers, by split: {names}.",
        f"Not shown to differ from the lowest: {'; '.join(tied)}."
        if tied
        else "Every other one is shown to cost more.",
    ]
