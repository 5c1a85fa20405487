"""The tables of the report."""

from __future__ import annotations

from dataclasses import dataclass, field

from eval.comparison.results import PAIRED_METRICS, Comparison, Outcome
from eval.views.terminal import heading, numbers

PERIOD_US = 1500.0  # of the controller


@dataclass(frozen=True, slots=True)
class Cell:
    """One value of a table."""

    text: str
    detail: str = ""  # the interval, or what else is smaller print
    value: float | None = None  # by which it is sorted; None is last
    mark: str = ""  # "best" or "tie", or "late" beyond the control period


@dataclass(frozen=True, slots=True)
class Row:
    """One method."""

    method: str
    kind: str
    cells: list[Cell]


@dataclass(frozen=True, slots=True)
class Table:
    """One table of methods; what is not ranked stays below."""

    title: str
    columns: list[str]
    ranked: list[Row] = field(default_factory=list)
    unranked: list[Row] = field(default_factory=list)


def metric_tables(comparison: Comparison) -> list[Table]:
    """Methods by splits, in the metrics that are compared scenario by scenario."""
    return [_metric_table(comparison, name) for name in PAIRED_METRICS]


def _metric_table(comparison: Comparison, name: str) -> Table:
    splits = comparison.splits()
    by_split = {split: {o.method.name: o for o in comparison.on(split)} for split in splits}

    def cells(method: str) -> list[Cell]:
        marks = [comparison.marks[split][name].get(method, "") for split in splits]
        return [
            _metric_cell(by_split[split].get(method), name, mark) for split, mark in zip(splits, marks, strict=True)
        ]

    return _table(comparison, heading(name), splits, cells)


def _table(comparison: Comparison, title: str, columns: list[str], cells) -> Table:
    table = Table(title, columns)
    for outcome in comparison.methods():
        row = Row(outcome.method.name, outcome.method.kind, cells(outcome.method.name))
        (table.ranked if outcome.ranked else table.unranked).append(row)
    return table


def _metric_cell(outcome: Outcome | None, name: str, mark: str) -> Cell:
    if outcome is None:
        return Cell("failed")
    point, low, high = numbers(name, outcome.estimates[name])
    return Cell(point, f"[{low}, {high}]", outcome.estimates[name].iqm, mark)


def failure_table(comparison: Comparison) -> Table:
    """Share of runs in which the tip never settles, and how often the arm left its workspace."""
    splits = comparison.splits()
    by_split = {split: {o.method.name: o for o in comparison.on(split)} for split in splits}

    def cells(method: str) -> list[Cell]:
        return [_failure_cell(by_split[split].get(method)) for split in splits]

    return _table(comparison, "Runs that never settle within ±1 mm", splits, cells)


def _failure_cell(outcome: Outcome | None) -> Cell:
    if outcome is None:
        return Cell("failed")
    counts = outcome.failures
    share = counts["not_settled"] / counts["runs"]
    left = counts["left_workspace"]
    return Cell(f"{share:.0%}", f"{left} left the workspace" if left else "", share)


def effort_table(comparison: Comparison) -> Table:
    """What each method takes: simulator steps and time of tuning or training, and time per action."""
    by_name = {outcome.method.name: outcome for outcome in comparison.methods()}
    columns = ["training seeds", "simulator steps per seed", "wall-clock per seed (s)"]
    columns += ["per action, median (µs)", "per action, 99 % (µs)"]
    return _table(comparison, "What each method takes", columns, lambda method: _effort(by_name[method]))


def _effort(outcome: Outcome) -> list[Cell]:
    training = outcome.method.training
    steps, seconds = (
        max(training[name], default=0.0) if training else 0.0 for name in ("simulator_steps", "wall_clock_s")
    )
    seeds = outcome.seeds if outcome.method.kind == "learned" else 0
    counts = [
        Cell(str(seeds) if seeds else "–", value=seeds),
        Cell(f"{steps / 1e6:.1f} million" if steps else "–", value=steps),
        Cell(f"{seconds:.0f}" if seconds else "–", value=seconds),
    ]
    return [*counts, *(_time_cell(time) for time in outcome.action_times)]


def _time_cell(time: float) -> Cell:
    return Cell(f"{time:.0f}", f"{time / PERIOD_US:.0%} of the period", time, "late" if time > PERIOD_US else "")
