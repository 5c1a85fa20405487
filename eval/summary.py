"""The comparison in words and tables: for the terminal, and as `summary.md`."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from eval.estimates import Estimate
from eval.results import PAIRED_METRICS, Comparison, Outcome
from eval.splits import SPLITS

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
_TERMINAL = ("tip_rms_mm", "tip_max_mm", "residual_pp_mm", "failure_share", "cost")
_DIGITS = {"tip_acc_rms": 2, "settling_s": 2, "torque_rms": 3, "torque_rate_rms": 1, "cost": 0}
_PERCENT = ("failure_share", "saturated_share")


def _numbers(name: str, value: Estimate) -> tuple[str, str, str]:
    """Estimate, lower and upper end, rounded as suits the metric."""
    factor = 100 if name in _PERCENT else 1
    digits = _DIGITS.get(name, 0 if name in _PERCENT else 1)
    point, low, high = (f"{factor * number:.{digits}f}" for number in (value.iqm, value.low, value.high))
    return point, low, high


def cell(name: str, value: Estimate) -> str:
    """An estimate with its interval, such as `4.8 [4.5, 5.2]`."""
    point, low, high = _numbers(name, value)
    return f"{point} [{low}, {high}]"


def _best(outcomes: list[Outcome], name: str) -> float:
    return min(outcome.estimates[name].iqm for outcome in outcomes)


def print_tables(comparison: Comparison, console: Console) -> None:
    """One table per split on the terminal."""
    for split in comparison.splits():
        outcomes = comparison.on(split)
        episodes = outcomes[0].metrics["cost"].shape[1]
        table = Table(title=f"{split}: {SPLITS[split].description}, {episodes} scenarios", title_justify="left")
        table.add_column("method", no_wrap=True)
        for name in _TERMINAL:
            title, unit = COLUMNS[name]
            table.add_column(f"{title}\n{'' if unit == '-' else unit}", justify="right", no_wrap=True)
        for outcome in outcomes:
            shown = []
            for name in _TERMINAL:
                value = outcome.estimates[name]
                point, low, high = _numbers(name, value)
                if value.iqm == _best(outcomes, name):
                    point = f"[bold]{point}[/bold]"
                shown.append(f"{point}\n{low}–{high}")
            table.add_row(outcome.method.name, *shown)
        console.print(table)
    console.print(
        "Interquartile means (shares: means) with bootstrap 95 % intervals over scenarios and training seeds."
    )
    for line in verdicts(comparison):
        console.print(_escaped(line), soft_wrap=True)


def _escaped(text: str) -> str:
    return text.replace("[", r"\[")


def verdicts(comparison: Comparison) -> list[str]:
    """One sentence per method and split: how it does against the best classical method on the same scenarios."""
    lines = []
    for split in comparison.splits():
        best = comparison.best_classical(split)
        for method, pairs in comparison.against_best[split].items():
            parts = []
            for name in PAIRED_METRICS:
                title, unit = COLUMNS[name]
                pair = pairs[name]
                shown = cell(name, pair.difference) + ("" if unit == "-" else f" {unit}")
                parts.append(f"{title} {pair.verdict} ({shown}, wins {pair.win_rate:.0%})")
            lines.append(f"{split}: {method} against {best.method.name}: " + "; ".join(parts) + ".")
    return lines


def markdown_table(outcomes: list[Outcome]) -> str:
    """All metrics of one split as a Markdown table, best value of each column in bold."""
    titles = [title if unit == "-" else f"{title} ({unit})" for title, unit in COLUMNS.values()]
    lines = ["| method | " + " | ".join(titles) + " |", "|---|" + "---:|" * len(COLUMNS)]
    for outcome in outcomes:
        cells = []
        for name in COLUMNS:
            point, interval = cell(name, outcome.estimates[name]).split(" ", 1)
            best = outcome.estimates[name].iqm == _best(outcomes, name)
            cells.append((f"**{point}**" if best else point) + f" {interval}")
        lines.append(f"| {outcome.method.name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def compute_table(comparison: Comparison) -> str:
    """What each method costs: training, and time per action."""
    lines = [
        "| method | training seeds | simulator steps per seed | training time per seed (s) | per action, one arm "
        "(µs, median / 99 %) |",
        "|---|---:|---:|---:|---:|",
    ]
    for outcome in comparison.on(comparison.splits()[0]):
        training = outcome.method.training
        steps = f"{max(training['simulator_steps']):.3g}" if training else "-"
        seconds = f"{max(training['wall_clock_s']):.0f}" if training else "-"
        seeds = str(outcome.seeds) if training else "-"
        median, slow = outcome.action_times
        lines.append(f"| {outcome.method.name} | {seeds} | {steps} | {seconds} | {median:.0f} / {slow:.0f} |")
    return "\n".join(lines)


def markdown(comparison: Comparison) -> str:
    """The content of `summary.md`."""
    provenance = comparison.provenance
    parts = [
        "# Comparison on the belt-driven arm",
        "Interquartile means over scenarios (and training seeds) with bootstrap 95 % intervals; shares are means. "
        "Lower is better everywhere; the best value of a column is bold. All methods run the same scenarios on the "
        "same observations (motor encoder only).",
    ]
    for split in comparison.splits():
        outcomes = comparison.on(split)
        episodes = outcomes[0].metrics["cost"].shape[1]
        parts += [f"## {split}", f"{SPLITS[split].description.capitalize()}; {episodes} scenarios."]
        parts += [markdown_table(outcomes)]
    parts += ["## Paired differences to the best classical method"]
    parts += ["\n".join(f"- {line}" for line in verdicts(comparison))]
    parts += ["## What it takes", compute_table(comparison)]
    parts += [
        "The controller's period is 1500 µs.",
        "## Where this comes from",
        f"`{provenance['command']}`, beltarm {provenance['beltarm']} ({provenance['commit']}), scenarios version "
        f"{provenance['splits_version']}, seeds {provenance['split_seeds']}, Python {provenance['python']} on "
        f"{provenance['machine']}, {provenance['seconds']} s.",
    ]
    return "\n\n".join(parts) + "\n"
