"""The comparison as `summary.md`: all metrics, all paired differences, what each method takes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from eval.comparison.estimates import RESAMPLES
from eval.comparison.results import PAIRED_METRICS, Comparison, Mark, Outcome
from eval.comparison.splits import SPLITS
from eval.comparison.traces import seed_note, shown_methods
from eval.style.markdown_table import markdown_table
from eval.views.terminal import COLUMNS, TIE, cell, heading, verdict

_MARKED: dict[Mark, str] = {"best": "**{}**", "tie": "<ins>{}</ins>"}


def markdown(comparison: Comparison, pictures: Sequence[str], results: str) -> str:
    """The content of `summary.md`, with pictures beside it, and the SHA-256 of the results.json that it belongs to."""
    episodes = comparison.outcomes[0].metrics["cost"].shape[1]
    parts = [
        "# Comparison on the belt-driven arm",
        "Interquartile means over scenarios (and training seeds) with bootstrap 95 % intervals; shares are means. "
        f"Lower is better everywhere. In {_listed(PAIRED_METRICS)}, which are compared scenario by scenario, **bold** "
        f"is the best of a column and <ins>underlined</ins> what is {TIE}. All methods run the same scenarios on the "
        "same observations (motor encoder only), but for those in italics, which see what no controller can and are "
        "not ranked.",
    ]
    parts += _failed(comparison)
    parts += ["## Cost on every split", overview_table(comparison, "cost")]
    for split in comparison.splits():
        outcomes = comparison.on(split)
        parts += [f"## {split}", f"{SPLITS[split].description.capitalize()}; {episodes} scenarios."]
        parts += [metrics_table(outcomes, comparison.marks[split])]
    parts += ["## Paired differences", _how_to_read()]
    for split in comparison.splits():
        parts += [f"### {split}", paired_table(comparison, split)]
    parts += ["## What it takes", compute_table(comparison), "The controller's period is 1500 µs."]
    parts += ["## Where this comes from", _origin(comparison, results), "## Pictures"]
    parts += [seed_note(comparison, shown_methods(comparison)), *(f"![{Path(name).stem}]({name})" for name in pictures)]
    return "\n\n".join(part for part in parts if part) + "\n"


def _listed(metrics: Sequence[str]) -> str:
    *first, last = (COLUMNS[name][0] for name in metrics)
    return f"{', '.join(first)} and {last}"


def _failed(comparison: Comparison) -> list[str]:
    if not comparison.failures:
        return []
    lines = [f"- {failure.method} on {failure.split}: {failure.message}" for failure in comparison.failures]
    return ["**Could not be run to the end:**\n\n" + "\n".join(lines)]


def _how_to_read() -> str:
    return (
        "Method minus the other one on the same scenarios: interquartile mean of the differences, and the probability "
        "of improvement (share of scenarios and seeds in which the method is lower, ties counting half), both with "
        "bootstrap 95 % intervals. A star marks a difference that is shown by its own interval, but not after Holm's "
        "correction for all methods compared in that metric on that split "
        f"(p values from {RESAMPLES} bootstrap samples). The best classical method is the one of the lowest cost on "
        "these very scenarios, which favours it a little."
    )


def _italic(text: str, outcome: Outcome) -> str:
    return text if outcome.ranked else f"*{text}*"


def overview_table(comparison: Comparison, name: str) -> str:
    """One metric: a row per method, a column per split."""
    splits = comparison.splits()
    rows = []
    by_split = {split: {o.method.name: o for o in comparison.on(split)} for split in splits}
    for method in comparison.methods():
        cells = []
        for split in splits:
            outcome = by_split[split].get(method.method.name)
            mark = comparison.marks[split][name].get(method.method.name)
            cells.append(_cell(outcome, name, mark) if outcome else "failed")
        rows.append([_italic(method.method.name, method), *cells])
    return markdown_table(["method", *splits], rows)


def metrics_table(outcomes: list[Outcome], marks: dict[str, dict[str, Mark]]) -> str:
    """All metrics of one split, with marks by metric and method."""
    rows = []
    for outcome in outcomes:
        cells = [_cell(outcome, name, marks.get(name, {}).get(outcome.method.name)) for name in COLUMNS]
        rows.append([_italic(outcome.method.name, outcome), *cells])
    return markdown_table(["method", *map(heading, COLUMNS)], rows)


def _cell(outcome: Outcome, name: str, mark: Mark | None) -> str:
    shown = cell(name, outcome.estimates[name])
    point, interval = shown.split(" ", 1)
    if mark:
        shown = f"{_MARKED[mark].format(point)} {interval}"
    return _italic(shown, outcome)


def paired_table(comparison: Comparison, split: str) -> str:
    """Every comparison on one split: against the best classical method, and of learned ones against their base."""
    best = comparison.best_classical(split)
    of_best = comparison.against_best[split].items()
    pairings = [(method, best.method.name, pairs) for method, pairs in of_best] if best else []
    bases = {outcome.method.name: outcome.method.base for outcome in comparison.outcomes}
    against_base = comparison.against_base[split].items()
    pairings += [(method, f"{bases[method]}, its base", pairs) for method, pairs in against_base]
    if not pairings:
        return "Nothing to compare with."
    rows = []
    for method, other, pairs in pairings:
        cells = []
        for name in PAIRED_METRICS:
            wins = pairs[name].win_rate
            cells.append(f"{verdict(pairs[name])}: {cell(name, pairs[name].difference)}")
            cells.append(f"{wins.iqm:.0%} [{wins.low:.0%}, {wins.high:.0%}]")
        rows.append([method, other, *cells])
    titles = ["method", "against", *(part for name in PAIRED_METRICS for part in (heading(name), "improves"))]
    return markdown_table(titles, rows, "ll" + "lr" * len(PAIRED_METRICS))


def compute_table(comparison: Comparison) -> str:
    """What each method costs: tuning or training, and time per action."""
    titles = [
        *("method", "kind", "training seeds", "simulator steps, tuning or training, per seed", "the same in seconds"),
        "per action, one arm (µs, median / 99 %)",
    ]
    rows = []
    for outcome in comparison.methods():
        method = outcome.method
        steps = f"{max(method.training['simulator_steps']):.3g}" if method.training else "-"
        seconds = f"{max(method.training['wall_clock_s']):.0f}" if method.training else "-"
        seeds = str(outcome.seeds) if method.kind == "learned" else "-"
        median, slow = outcome.action_times
        name = _italic(method.name, outcome)
        rows.append([name, method.kind, seeds, steps, seconds, f"{median:.0f} / {slow:.0f}"])
    return markdown_table(titles, rows, "llrrrr")


def _origin(comparison: Comparison, results: str) -> str:
    origin = comparison.provenance
    digests = ", ".join(f"{name} {digest[:12]}" for name, digest in origin["split_sha256"].items())
    return (
        f"`{origin['command']}`, beltarm {origin['beltarm']} ({origin['commit']}), Python {origin['python']} on "
        f"{origin['machine']}, {origin['seconds']} s. Scenarios version {origin['splits_version']}, by SHA-256: "
        f"{digests}. The results.json of this run has the SHA-256 {results}."
    )
