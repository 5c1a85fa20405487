"""Tables of the report."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import isfinite

from beltarm_env.metrics import TORQUES, heading
from eval.comparison.pairs import LEFT
from eval.comparison.results import PAIRED_METRICS, Comparison, MethodOutcome
from eval.comparison.statistics import tail_mean
from eval.comparison.timing import PERIOD_US
from eval.report.budgets import budget_of
from eval.report.frame import MethodLine
from eval.report.text import numbers, rounded


@dataclass(frozen=True, slots=True)
class Cell:
    """Cell of a table."""

    text: str
    details: tuple[str, ...] = ()  # lines of smaller print: the interval, mean and tail, or what else
    value: float | None = None  # by which it is sorted; None is last
    mark: str = ""  # "best" or "tie", or "late" beyond the control period


FAILED = Cell("failed")
Show = Callable[[MethodOutcome], Cell]
"""Makes the cell of a method's outcome on one split."""


@dataclass(frozen=True, slots=True)
class Table:
    """Table of the report; methods that are not ranked stay at the bottom, however it is sorted."""

    title: str
    columns: list[str]
    lines: list[MethodLine[Cell]]

    @property
    def ranked(self) -> list[MethodLine[Cell]]:
        """Methods that are compared with others."""
        return [line for line in self.lines if line.ranked]

    @property
    def unranked(self) -> list[MethodLine[Cell]]:
        """Methods that see what no other does."""
        return [line for line in self.lines if not line.ranked]


def main_table(comparison: Comparison) -> Table:
    """Cost on the main split by every average, failures beside it, and what the arm's end does: a line per method."""
    home = comparison.main_split
    of_costs: dict[str, Show] = {
        "cost": _estimate(comparison, "cost"),
        "mean": lambda outcome: _cost_cell(float(outcome.metrics["cost"].mean())),
        "worst 5 %": lambda outcome: _cost_cell(tail_mean(outcome.metrics["cost"])),
        "fail": lambda outcome: Cell(f"{_failed(outcome):.0%}", value=_failed(outcome)),
        "left": lambda outcome: Cell(str(outcome.failures[LEFT]), value=outcome.failures[LEFT]),
        "not arrived": lambda outcome: Cell(f"{outcome.not_arrived:.0%}", value=outcome.not_arrived),
    }
    at_the_end = {heading(name): _estimate(comparison, name) for name in PAIRED_METRICS if name != "cost"}
    columns = {title: (home, show) for title, show in (of_costs | at_the_end).items()}
    return _measured(comparison, f"The main split, {home}", columns)


def metric_tables(comparison: Comparison) -> list[Table]:
    """Methods by splits, in the metrics that are compared scenario by scenario; beside the cost its mean and tail."""
    shows = {name: _estimate(comparison, name) for name in PAIRED_METRICS}
    shows["cost"] = lambda outcome, show=shows["cost"]: _with_tail(show(outcome), outcome)
    return [
        _measured(
            comparison, f"{heading(name)} on every split", {split: (split, show) for split in comparison.splits()}
        )
        for name, show in shows.items()
    ]


def torque_table(comparison: Comparison) -> Table:
    """What the motor has to follow, on the main split."""
    home = comparison.main_split
    columns = {heading(name): (home, _estimate(comparison, name)) for name in TORQUES}
    return _measured(comparison, f"Torques on {home}", columns)


def _measured(comparison: Comparison, title: str, columns: Mapping[str, tuple[str, Show]]) -> Table:
    """Table of what was measured: each column shows something of the outcomes on one split."""
    found = {(outcome.method.name, outcome.split): outcome for outcome in comparison.outcomes}

    def cells(of_method: MethodOutcome) -> list[Cell]:
        shown = [(show, found.get((of_method.method.name, split))) for split, show in columns.values()]
        return [show(outcome) if outcome else FAILED for show, outcome in shown]

    return _table(comparison, title, list(columns), cells)


def _estimate(comparison: Comparison, name: str) -> Show:
    """Cells of a metric: its estimate with the interval, and a mark where it is the best or a tie."""

    def show(outcome: MethodOutcome) -> Cell:
        value = outcome.estimates[name]
        point, low, high = numbers(name, value)
        mark = comparison.marks[outcome.split].get(name, {}).get(outcome.method.name, "")
        return Cell(point, (f"[{low}, {high}]",), value.iqm, mark) if isfinite(value.iqm) else Cell("does not arrive")

    return show


def _cost_cell(cost: float) -> Cell:
    return Cell(rounded("cost", cost), value=cost if isfinite(cost) else None)


def _with_tail(cell: Cell, outcome: MethodOutcome) -> Cell:
    """Add mean and worst 5 % of the cost to its cell, and failures, where there are any."""
    costs, left = outcome.metrics["cost"], outcome.failures[LEFT]
    averages = " / ".join(rounded("cost", value) for value in (float(costs.mean()), tail_mean(costs)))
    counts = [f"{_failed(outcome):.0%} fail"] if _failed(outcome) else []
    counts += [f"{left} left"] if left else []
    counts += [f"{outcome.not_arrived:.0%} not arrived"] if outcome.not_arrived else []
    return replace(cell, details=(*cell.details, averages, *([", ".join(counts)] if counts else [])))


def _failed(outcome: MethodOutcome) -> float:
    """Share of the runs that never settle."""
    return outcome.failures["not_settled"] / outcome.failures["runs"]


def effort_table(comparison: Comparison) -> Table:
    """Effort of each method: samples and time of tuning or training, and time per action; and how repeatable it is."""
    home = {outcome.method.name: outcome for outcome in comparison.on(comparison.main_split)}
    columns = ["training seeds", "samples per seed (million)", "all samples (million)", "wall-clock per seed (s)"]
    columns += ["per action, median (µs)", "per action, 99 % (µs)"]
    columns += ["latency that it was given (µs)"] if comparison.timed else []

    def cells(outcome: MethodOutcome) -> list[Cell]:
        times = [*outcome.action_times, *([1e6 * outcome.latency] if comparison.timed else [])]
        return [*_samples(outcome), *map(_time_cell, times), _sensitivity(home.get(outcome.method.name))]

    return _table(comparison, "What each method takes", [*columns, "other episodes after a nudge (%)"], cells)


def _table(
    comparison: Comparison, title: str, columns: list[str], cells: Callable[[MethodOutcome], list[Cell]]
) -> Table:
    made = [MethodLine(o.method.name, o.method.kind, o.seeds, cells(o)) for o in comparison.methods()]
    return Table(title, columns, made)


def _samples(outcome: MethodOutcome) -> list[Cell]:
    """Seeds, samples and seconds of tuning or training, with a dash for none."""
    training, budget = outcome.method.training, budget_of(outcome.method)
    steps, seconds = (
        max(training[name], default=0.0) if training else 0.0 for name in ("simulator_steps", "wall_clock_s")
    )
    seeds = outcome.seeds if outcome.method.kind == "learned" else 0
    numbers = [(seeds, "d"), (steps / 1e6, ".1f"), ((budget.total if budget else 0.0) / 1e6, ".1f"), (seconds, ".0f")]
    return [Cell(format(value, form) if value else "–", value=value) for value, form in numbers]


def _sensitivity(outcome: MethodOutcome | None) -> Cell:
    share = outcome.sensitivity if outcome else None
    return Cell("–") if share is None else Cell(f"{100 * share:.1f}", value=share)


def _time_cell(time: float) -> Cell:
    late = time > PERIOD_US
    share = f"{'late: ' if late else ''}{time / PERIOD_US:.0%} of the period"
    return Cell(f"{time:.0f}", (share,), time, "late" if late else "")
