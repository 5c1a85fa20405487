"""The comparison in words and tables, for the terminal; `eval.views.markdown` has the full account."""

from __future__ import annotations

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from eval.comparison.estimates import Estimate, Paired
from eval.comparison.results import PAIRED_METRICS, SHARES, Comparison, Mark, Outcome

COLUMNS = {
    "tip_rms_mm": ("tip RMS", "mm"),
    "tip_max_mm": ("tip max", "mm"),
    "residual_pp_mm": ("residual p-p", "mm"),
    "tip_acc_rms": ("tip acc. RMS", "m/s²"),
    "settling_s": ("settling", "s"),
    "failure_share": ("not settled", "%"),
    "torque_rms": ("torque RMS", "N m"),
    "torque_rate_rms": ("torque rate", "N m/s"),
    "saturated_share": ("saturated", "%"),
    "cost": ("cost", "-"),
}
TIE = "not shown to differ from the best, by the paired test with Holm's correction"
_TERMINAL = ("cost", "residual_pp_mm")
_DIGITS = {"tip_acc_rms": 2, "settling_s": 2, "torque_rms": 3, "torque_rate_rms": 1, "cost": 0}
_METHOD_WIDTH, _SPLIT_WIDTH = 16, 13


def numbers(name: str, value: Estimate) -> tuple[str, str, str]:
    """Estimate, lower and upper end, rounded as suits the metric."""
    factor = 100 if name in SHARES else 1
    digits = _DIGITS.get(name, 0 if name in SHARES else 1)
    point, low, high = (f"{factor * number:.{digits}f}" for number in (value.iqm, value.low, value.high))
    return point, low, high


def cell(name: str, value: Estimate) -> str:
    """An estimate with its interval, such as `4.8 [4.5, 5.2]`."""
    point, low, high = numbers(name, value)
    return f"{point} [{low}, {high}]"


def heading(name: str) -> str:
    """A metric with its unit."""
    title, unit = COLUMNS[name]
    return title if unit == "-" else f"{title} ({unit})"


def print_tables(comparison: Comparison, console: Console) -> None:
    """Two metrics over all splits, and how the methods that are not classical do against the best that is."""
    splits = comparison.splits()
    fitting = max(1, (console.width - _METHOD_WIDTH) // _SPLIT_WIDTH)
    for name in _TERMINAL:
        for first in range(0, len(splits), fitting):
            console.print(_overview(comparison, splits[first : first + fitting], name))
    episodes = comparison.outcomes[0].metrics["cost"].shape[1]
    console.print(f"{episodes} scenarios per split; interquartile means with bootstrap 95 % intervals.")
    console.print(f"[bold]Bold[/bold]: best; [underline]underlined[/underline]: {TIE}.", soft_wrap=True)
    for line in verdicts(comparison):
        console.print(escape(line), soft_wrap=True)
    for failure in comparison.failures:
        console.print(escape(f"{failure.method} failed on {failure.split}: {failure.message}"), style="red")


def _overview(comparison: Comparison, splits: list[str], name: str) -> Table:
    """One metric: a row per method, a column per split; what is not ranked below a rule."""
    table = Table(title=f"{heading(name)}, lower is better", title_justify="left")
    table.add_column("method", no_wrap=True)
    for split in splits:
        table.add_column(split, justify="right", no_wrap=True)
    by_split = {split: {o.method.name: o for o in comparison.on(split)} for split in splits}
    shown_ranked = True
    for method in comparison.methods():
        if shown_ranked and not method.ranked:
            table.add_section()
        shown_ranked = method.ranked
        cells = []
        for split in splits:
            outcome = by_split[split].get(method.method.name)
            mark = comparison.marks[split][name].get(method.method.name)
            cells.append(_cell(outcome, name, mark) if outcome else "failed")
        table.add_row(method.method.name, *cells, style="" if method.ranked else "dim italic")
    return table


def _cell(outcome: Outcome, name: str, mark: Mark | None) -> str:
    point, low, high = numbers(name, outcome.estimates[name])
    if mark:
        style = {"best": "bold", "tie": "underline"}[mark]
        point = f"[{style}]{point}[/{style}]"
    return f"{point}\n{low}–{high}"


def verdict(pair: Paired) -> str:
    """What a comparison shows; a difference that many comparisons would show by chance is marked by a star."""
    return pair.verdict + ("" if pair.verdict == "no difference shown" or pair.survives else "*")


def verdicts(comparison: Comparison) -> list[str]:
    """One sentence per split and method that is not classical: how it does against the best classical one."""
    lines = []
    for split in comparison.splits():
        best = comparison.best_classical(split)
        for outcome in comparison.on(split):
            pairs = comparison.against_best[split].get(outcome.method.name)
            if best is None or pairs is None or outcome.method.kind == "classical":
                continue
            parts = []
            for name in PAIRED_METRICS:
                title, unit = COLUMNS[name]
                shown = cell(name, pairs[name].difference) + ("" if unit == "-" else f" {unit}")
                parts.append(f"{title} {verdict(pairs[name])} ({shown}, wins {pairs[name].win_rate.iqm:.0%})")
            lines.append(f"{split}: {outcome.method.name} against {best.method.name}: " + "; ".join(parts) + ".")
    return lines
