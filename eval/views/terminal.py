"""Tables and verdicts of the comparison for the terminal; `eval.views.markdown` has all metrics."""

from __future__ import annotations

from typing import Any

import pandas as pd
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from beltarm_env.metrics import METRICS, heading
from eval.comparison.estimates import Paired
from eval.comparison.results import PAIRED_METRICS, Comparison
from eval.style.metrics import cell, numbers, with_unit
from eval.views.frame import frame_of, lines, part

TIE = "not shown to differ from the best, by the paired test with Holm's correction"
_TERMINAL = ("cost", "residual_pp_mm")
_STYLES = {"best": "bold", "tie": "underline"}
_METHOD_WIDTH, _SPLIT_WIDTH = 16, 13


def print_tables(comparison: Comparison, console: Console) -> None:
    """Print two metrics over all splits, and the other methods' verdicts against the best classical one."""
    splits = comparison.splits()
    fitting = max(1, (console.width - _METHOD_WIDTH) // _SPLIT_WIDTH)
    found = frame_of(comparison)
    for name in _TERMINAL:
        for first in range(0, len(splits), fitting):
            console.print(_overview(part(found, split=splits[first : first + fitting], metric=[name]), name))
    episodes = comparison.outcomes[0].metrics["cost"].shape[1]
    console.print(comparison.note, style="bold", soft_wrap=True)
    console.print(f"{episodes} scenarios per split; interquartile means with bootstrap 95 % intervals.")
    console.print(f"[bold]Bold[/bold]: best; [underline]underlined[/underline]: {TIE}.", soft_wrap=True)
    for line in verdicts(comparison):
        console.print(escape(line), soft_wrap=True)
    for failure in comparison.failures:
        console.print(escape(f"{failure.method} failed on {failure.split}: {failure.message}"), style="red")


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
    style = _STYLES.get(row.mark)
    return f"{f'[{style}]{point}[/{style}]' if style else point}\n{low}–{high}"


def verdict(pair: Paired) -> str:
    """Verdict of a comparison, with a star if the difference does not outlive Holm's correction."""
    return pair.verdict + ("" if pair.verdict == "no difference shown" or pair.survives else "*")


def verdicts(comparison: Comparison) -> list[str]:
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
                parts.append(
                    f"{METRICS[name].title} {verdict(pairs[name])} ({shown}, wins {pairs[name].win_rate.iqm:.0%})"
                )
            lines.append(f"{split}: {outcome.method.name} against {best.method.name}: " + "; ".join(parts) + ".")
    return lines
