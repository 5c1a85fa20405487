"""The comparison on the terminal: the main split and the verdict; `eval.report.markdown` has all metrics."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import Any

import pandas as pd
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from beltarm_env.metrics import ARRIVAL_BOUND, METRICS, heading
from eval.comparison.pairs import LEFT
from eval.comparison.results import PAIRED_METRICS, Comparison, MethodOutcome
from eval.comparison.splits import EPISODES, SPLITS
from eval.comparison.statistics import LEAST_OF_TAIL, Paired, tail_mean
from eval.report.frame import best_first, frame_of, lines, part
from eval.report.text import cell, numbers, rounded, with_unit

TIE = "not shown to differ from the best, by the paired test with Holm's correction"
_TERMINAL = ("cost", "residual_pp_mm")
_STYLES = {"best": "bold", "tie": "underline"}
_METHOD_WIDTH, _SPLIT_WIDTH = 16, 13
_RANKED_WIDTH = 24  # so that in 80 columns a long name is cut, and no number


def print_results(comparison: Comparison, said: Sequence[str], console: Console, *, verbose: bool = False) -> None:
    """Print the main split, best method first, and the verdict; `verbose` adds all splits with their intervals."""
    if verbose:
        _print_tables(comparison, console)
    console.print(_ranking(comparison))
    for sentence in said:
        console.print(escape(sentence), style="bold", highlight=False)
    console.print(escape(comparison.note), highlight=False)
    episodes = comparison.outcomes[0].metrics["cost"].shape[1]
    few = f" {episodes} of {EPISODES} scenarios show less than all." if episodes < EPISODES else ""
    least = f" (of {LEAST_OF_TAIL} scenarios or more)" if episodes < LEAST_OF_TAIL else ""
    console.print(
        "Cost: minus the return (errors of the arm's end, and changes of the torque), averaged over the middle half of "
        f"all runs; tie: {TIE}; mean: over all runs; worst 5 %: over the worst of them{least}; vibration: of arms that "
        f"arrive, within {1000 * ARRIVAL_BOUND:g} mm in the mean.{few}",
        style="dim",
        highlight=False,
    )


def _ranking(comparison: Comparison) -> Table:
    """Table of the main split: a row per method, of the lowest cost first; those that are not ranked at the end."""
    split = comparison.main_split
    outcomes = best_first(comparison).on(split)
    episodes = outcomes[0].metrics["cost"].shape[1]
    title = f"{split}: {SPLITS[split].description}; {episodes} scenarios"
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("method", no_wrap=True, max_width=_RANKED_WIDTH)
    for heading_ in ("cost", "mean", "worst\n5 %", "error\nRMS, mm", "vibration\nafter, mm", "left", "not\narrived"):
        table.add_column(heading_, justify="right", no_wrap=True)
    marks = comparison.marks[split]["cost"]
    for outcome in outcomes:
        name = outcome.method.name
        mark = {"best": " (lowest cost)", "tie": " (tie)"}.get(marks.get(name, ""), "")
        style = "dim italic" if not outcome.ranked else "bold" if marks.get(name) == "best" else ""
        table.add_row(f"{name}{mark}", *_scores(outcome), style=style)
    return table


def _scores(outcome: MethodOutcome) -> list[str]:
    costs = outcome.metrics["cost"]
    averages = (outcome.estimates["cost"].iqm, float(costs.mean()), tail_mean(costs))
    shown = [rounded(name, outcome.estimates[name].iqm) for name in ("tip_rms_mm", "residual_pp_mm")]
    failed = (str(outcome.failures[LEFT]), f"{outcome.not_arrived:.0%}")
    return [*(rounded("cost", value) for value in averages), *shown, *failed]


def _print_tables(comparison: Comparison, console: Console) -> None:
    """Print two metrics over all splits, and every method's differences from the best classical one."""
    splits = comparison.splits()
    fitting = max(1, (console.width - _METHOD_WIDTH) // _SPLIT_WIDTH)
    found = frame_of(comparison)
    for name in _TERMINAL:
        for first in range(0, len(splits), fitting):
            console.print(_overview(part(found, split=splits[first : first + fitting], metric=[name]), name))
    console.print("Interquartile means with bootstrap 95 % intervals.")
    console.print(f"[bold]Bold[/bold]: best; [underline]underlined[/underline]: {TIE}.", soft_wrap=True)
    for line in differences(comparison):
        console.print(escape(line), soft_wrap=True)


def _overview(found: pd.DataFrame, name: str) -> Table:
    """Table of one metric: a row per method, a column per split; methods that are not ranked below a rule."""
    table = Table(title=f"{heading(name)}, lower is better", title_justify="left")
    table.add_column("method", no_wrap=True)
    for split in found.split.unique():
        table.add_column(split, justify="right", no_wrap=True)
    shown_ranked = True
    for line in lines(found, "split", _cell, "failed"):
        if shown_ranked and not line.ranked:
            table.add_section()
        shown_ranked = line.ranked
        table.add_row(line.method, *line.cells, style="" if line.ranked else "dim italic")
    return table


def _cell(row: Any) -> str:
    point, low, high = numbers(row.metric, row)
    if not isfinite(row.iqm):
        return point
    style = _STYLES.get(row.mark)
    return f"{f'[{style}]{point}[/{style}]' if style else point}\n{low}–{high}"


def result(pair: Paired) -> str:
    """Result of a paired comparison, with a star if the difference does not outlive Holm's correction."""
    return pair.verdict + ("*" if pair.verdict in ("better", "worse") and not pair.survives else "")


def differences(comparison: Comparison) -> list[str]:
    """Sentence per split and method that is not classical: its differences from the best classical one."""
    lines = []
    for split in comparison.splits():
        best = comparison.best_classical(split)
        for outcome in comparison.on(split):
            pairs = comparison.against_best[split].get(outcome.method.name)
            if best is None or pairs is None or outcome.method.kind == "classical":
                continue
            parts = []
            for name in PAIRED_METRICS:
                shown = with_unit(name, cell(name, pairs[name].difference))
                wins = f" ({shown}, wins {pairs[name].win_rate.iqm:.0%})" if pairs[name].scenarios else ""
                parts.append(f"{METRICS[name].title} {result(pairs[name])}{wins}")
            lines.append(f"{split}: {outcome.method.name} against {best.method.name}: " + "; ".join(parts) + ".")
    return lines
