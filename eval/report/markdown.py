"""`summary.md` of a comparison: all metrics, all paired differences, effort of each method."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import pandas as pd

from beltarm_env.metrics import ARRIVAL_BOUND, METRICS, REVERSAL_SWING, TORQUES, heading
from eval.comparison.pairs import CHANGE, LEFT, NUDGE
from eval.comparison.results import MOSTLY, PAIRED_METRICS, Comparison, MethodOutcome
from eval.comparison.splits import EDITION, SPLITS
from eval.comparison.statistics import LEAST_OF_TAIL, LEAST_P, LEAST_SCENARIOS, RESAMPLES, tail_mean
from eval.report.budgets import BUDGETS_NOTE, budget_of, budgets_table
from eval.report.frame import frame_of, lines, part
from eval.report.terminal import TIE, result
from eval.report.text import cell, markdown_table, number, numbers
from eval.report.traces import seed_note, shown_methods
from eval.report.verdict import Verdict

_MARKED = {"best": "**{}**", "tie": "<ins>{}</ins>"}


def markdown(comparison: Comparison, said: Verdict, pictures: Sequence[str], results: str) -> str:
    """Content of `summary.md`: the verdict, pictures beside it, and the SHA-256 of the results.json it belongs to."""
    episodes = comparison.outcomes[0].metrics["cost"].shape[1]
    parts = [
        "# Comparison on the belt-driven arm",
        f"**{comparison.note}**",
        " ".join(said.sentences),
        "Interquartile means over scenarios (and training seeds) with bootstrap 95 % intervals; shares are means. "
        f"{_of_arrival()} "
        f"Lower is better everywhere. In {_listed(PAIRED_METRICS)}, which are compared scenario by scenario, **bold** "
        f"is the best of a column and <ins>underlined</ins> what is {TIE}. All methods run the same scenarios on the "
        "same observations (motor encoder only), but for those in italics, which see what no controller can and are "
        "not ranked.",
    ]
    parts += _failed(comparison)
    parts += ["## The primary comparison", *_primary(said)] if said.duels else []
    found = frame_of(comparison)
    parts += ["## Cost on every split", method_table(part(found, metric=["cost"]), "split")]
    parts += ["## Mean and tail of the cost", _of_tails(), tail_table(comparison)]
    main = part(found, split=[comparison.main_split], metric=TORQUES)
    parts += ["## Torques", _of_torques(comparison.main_split), method_table(main, "metric")]
    for split in comparison.splits():
        parts += [f"## {split}", f"{SPLITS[split].description.capitalize()}; {episodes} scenarios."]
        parts += [method_table(part(found, split=[split]), "metric")]
    parts += ["## Paired differences", _how_to_read()]
    for split in comparison.splits():
        parts += [f"### {split}", paired_table(comparison, split)]
    parts += ["## Repeatability", _of_sensitivity(comparison.main_split), sensitivity_table(comparison)]
    parts += ["## What it takes", compute_table(comparison), "The controller's period is 1500 µs."]
    found_budgets = [budget for outcome in comparison.methods() if (budget := budget_of(outcome.method))]
    parts += ["## All samples", BUDGETS_NOTE, budgets_table(found_budgets)]
    parts += ["## Where this comes from", _origin(comparison, results), "## Pictures"]
    parts += [seed_note(comparison, shown_methods(comparison)), *(f"![{Path(name).stem}]({name})" for name in pictures)]
    return "\n\n".join(part for part in parts if part) + "\n"


def _of_arrival() -> str:
    return (
        f"An arm has arrived if the mean error of its end after the move is {1000 * ARRIVAL_BOUND:g} mm or less. "
        "Vibration, settling and torques are of the scenarios in which all runs of a method arrive, and compared where "
        f"those of both do; a dash: in none. Only a method of which {MOSTLY:.0%} of the runs arrive is marked in them."
    )


def _listed(metrics: Sequence[str]) -> str:
    *first, last = (METRICS[name].title for name in metrics)
    return f"{', '.join(first)} and {last}"


def _primary(said: Verdict) -> list[str]:
    duel = next(iter(said.duels["cost"].values()))
    one, other = duel.challenger.method.name, duel.classical.method.name
    least = min(1.0, len(said.duels["cost"]) * LEAST_P)
    how = (
        f"Scenario by scenario, {one} minus {other}: difference of the interquartile means, also as a share of "
        f"{other}'s value; p value after Holm's correction over all splits; mean difference. *Better* and *worse* take "
        "both: a corrected p value below 0.05, and a mean difference whose 95 % interval is clear of zero on the same "
        f"side. With {RESAMPLES} bootstrap samples no corrected p value is below {least:.3f}. A split with fewer than "
        f"{LEAST_SCENARIOS} scenarios to compare is not there. The marks of all other tables test interquartile means "
        "alone, and may say of a split what this table does not."
    )
    return [how, primary_table(said)]


def primary_table(said: Verdict) -> str:
    """Duels of the primary comparison, metric by metric and split by split."""
    rows = [
        [
            METRICS[metric].title,
            split,
            f"**{duel.result}**" if duel.result != "open" else "no difference shown",
            cell(metric, duel.middle.difference),
            f"{100 * duel.relative:+.0f} %",
            f"{duel.middle.p_holm:.3f}",
            cell(metric, duel.mean),
        ]
        for metric, of_metric in said.duels.items()
        for split, duel in of_metric.items()
    ]
    return markdown_table(["metric", "split", "result", "difference", "share", "p", "mean difference"], rows, "lllrrrr")


def _failed(comparison: Comparison) -> list[str]:
    if not comparison.failures:
        return []
    lines = [f"- {failure.method} on {failure.split}: {failure.message}" for failure in comparison.failures]
    return ["**Could not be run to the end:**\n\n" + "\n".join(lines)]


def _of_tails() -> str:
    return (
        "An interquartile mean leaves out the best and the worst quarter of the runs. Of all of them: the mean / the "
        f"mean of the worst 5 %, from {LEAST_OF_TAIL} scenarios on; how many arms left their workspace, and what share "
        "of the runs did not arrive, if any."
    )


def tail_table(comparison: Comparison) -> str:
    """Mean cost and that of the worst 5 % of the runs, of each method on each split."""
    splits = comparison.splits()
    cells = {(outcome.method.name, outcome.split): _tail(outcome) for outcome in comparison.outcomes}
    rows = [
        [
            _italic(outcome.method.name, outcome.ranked),
            *(_italic(cells.get((outcome.method.name, split), "failed"), outcome.ranked) for split in splits),
        ]
        for outcome in comparison.methods()
    ]
    return markdown_table(["method", *splits], rows)


def _tail(outcome: MethodOutcome) -> str:
    costs, left = outcome.metrics["cost"], outcome.failures[LEFT]
    failed = [f"; {left} left"] if left else []
    failed += [f"; {outcome.not_arrived:.0%} not arrived"] if outcome.not_arrived else []
    return f"{costs.mean():.0f} / {number(tail_mean(costs), 0)}{''.join(failed)}"


def _of_torques(split: str) -> str:
    return (
        f"What the motor has to follow on {split}; the other splits have these columns too. Reversals: successive "
        "extremes of the torque on opposite sides of zero that differ by more than "
        f"{REVERSAL_SWING:.0%} of its limit, per second."
    )


def _how_to_read() -> str:
    return (
        "Method minus the other one on the same scenarios: interquartile mean of the differences, and the probability "
        "of improvement (share of scenarios and seeds in which the method is lower, ties counting half), both with "
        "bootstrap 95 % intervals. A star marks a difference that is shown by itself, but not after Holm's correction "
        "for all methods compared in that metric on that split. A p value is the larger of that of "
        f"{RESAMPLES} bootstrap samples and that of a t test. The best classical method is the one of the lowest cost "
        "on these very scenarios, which favours it a little."
    )


def method_table(
    found: pd.DataFrame, across: Literal["split", "metric"], with_seeds: bool = False, intervals: bool = True
) -> str:
    """Estimates: a row per method, a column per split or metric.

    Args:
        found: Part of the comparison's table, see `eval.report.frame`.
        across: What the columns are.
        with_seeds: Whether the number of training seeds stands beside a learned method's name.
        intervals: Whether each estimate has its interval.
    """
    rows = []
    for line in lines(found, across, _cell if intervals else _point, "failed"):
        plural = "s" if line.seeds > 1 else ""
        seeds = f" ({line.seeds} seed{plural})" if with_seeds and line.kind == "learned" else ""
        rows.append([_italic(line.method + seeds, line.ranked), *line.cells])
    columns = found[across].unique()
    return markdown_table(["method", *(columns if across == "split" else map(heading, columns))], rows)


def _cell(row: Any) -> str:
    point, *interval = cell(row.metric, row).split(" ", 1)
    return _italic(" ".join([_MARKED.get(row.mark, "{}").format(point), *interval]), row.kind != "privileged")


def _point(row: Any) -> str:
    return _italic(numbers(row.metric, row)[0], row.kind != "privileged")


def _italic(text: str, ranked: bool) -> str:
    return text if ranked else f"*{text}*"


def paired_table(comparison: Comparison, split: str) -> str:
    """Paired differences on one split: from the best classical method, and of learned methods from their base."""
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
            compared = pairs[name].scenarios > 0
            cells.append(f"{result(pairs[name])}: {cell(name, pairs[name].difference)}" if compared else "not compared")
            cells.append(f"{wins.iqm:.0%} [{wins.low:.0%}, {wins.high:.0%}]" if compared else "–")
        rows.append([method, other, *cells])
    titles = ["method", "against", *(part for name in PAIRED_METRICS for part in (heading(name), "improves"))]
    return markdown_table(titles, rows, "ll" + "lr" * len(PAIRED_METRICS))


def _of_sensitivity(split: str) -> str:
    return (
        f"Each scenario of {split} is run once more with a first torque that differs by {NUDGE:g} N m. *Another "
        f"episode* is one whose cost changes by more than {CHANGE:.0%}: on a real arm the same move would not be made "
        "twice."
    )


def sensitivity_table(comparison: Comparison) -> str:
    """Share of episodes of each method that are other ones after a nudge."""
    shares = [(o, o.sensitivity) for o in comparison.on(comparison.main_split) if o.sensitivity is not None]
    rows = [[_italic(outcome.method.name, outcome.ranked), f"{100 * share:.1f}"] for outcome, share in shares]
    return markdown_table(["method", "another episode (%)"], rows)


def compute_table(comparison: Comparison) -> str:
    """Effort of each method: tuning or training, and time per action."""
    titles = [
        *("method", "kind", "training seeds", "simulator steps, tuning or training, per seed", "the same in seconds"),
        "per action, one arm (µs, median / 99 %)",
    ]
    titles += ["latency that it was given (µs)"] if comparison.timed else []
    rows = []
    for outcome in comparison.methods():
        method = outcome.method
        steps = f"{max(method.training['simulator_steps']):.3g}" if method.training else "-"
        seconds = f"{max(method.training['wall_clock_s']):.0f}" if method.training else "-"
        seeds = str(outcome.seeds) if method.kind == "learned" else "-"
        median, slow = outcome.action_times
        name = _italic(method.name, outcome.ranked)
        given = [f"{1e6 * outcome.latency:.0f}"] if comparison.timed else []
        rows.append([name, method.kind, seeds, steps, seconds, f"{median:.0f} / {slow:.0f}", *given])
    return markdown_table(titles, rows, "ll" + "r" * (len(titles) - 2))


def _origin(comparison: Comparison, results: str) -> str:
    origin, label = comparison.provenance, comparison.scenario_set
    digests = ", ".join(f"{name} {digest[:12]}" for name, digest in origin["split_sha256"].items())
    return (
        f"`{origin['command']}`, beltarm {origin['beltarm']} ({origin['commit']}), Python {origin['python']} on "
        f"{origin['machine']}, {origin['seconds']} s. Scenarios of the {label.title} "
        f"({label.sha256[:12]}), edition {EDITION}, version {origin['splits_version']}, by SHA-256: {digests}. The "
        f"results.json of this run has the SHA-256 {results}."
    )
