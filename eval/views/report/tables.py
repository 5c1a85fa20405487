"""Tables of the report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from beltarm_env.metrics import TORQUES, heading
from eval.comparison.results import PAIRED_METRICS, Comparison, MethodOutcome
from eval.comparison.timing import PERIOD_US
from eval.style.metrics import numbers
from eval.views.frame import MethodLine, frame_of, lines, part


@dataclass(frozen=True, slots=True)
class Cell:
    """Cell of a table."""

    text: str
    detail: str = ""  # the interval, or what else is smaller print
    value: float | None = None  # by which it is sorted; None is last
    mark: str = ""  # "best" or "tie", or "late" beyond the control period


FAILED = Cell("failed")


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


def metric_tables(comparison: Comparison) -> list[Table]:
    """Methods by splits, in the metrics that are compared scenario by scenario."""
    found = frame_of(comparison)
    return [
        Table(heading(name), comparison.splits(), lines(part(found, metric=[name]), "split", _metric_cell, FAILED))
        for name in PAIRED_METRICS
    ]


def torque_table(comparison: Comparison) -> Table:
    """What the motor has to follow, on the main split."""
    found = part(frame_of(comparison), split=[comparison.main_split], metric=TORQUES)
    title = f"Torques on {comparison.main_split}"
    return Table(title, [heading(name) for name in TORQUES], lines(found, "metric", _metric_cell, FAILED))


def _metric_cell(row: Any) -> Cell:
    point, low, high = numbers(row.metric, row)
    return Cell(point, f"[{low}, {high}]", row.iqm, row.mark)


def failure_table(comparison: Comparison) -> Table:
    """Share of runs in which the tip never settles, and how often the arm left its workspace."""
    splits = comparison.splits()
    cells = {(outcome.method.name, outcome.split): _failure_cell(outcome) for outcome in comparison.outcomes}
    return _table(
        comparison,
        "Runs that never settle within ±1 mm",
        splits,
        lambda outcome: [cells.get((outcome.method.name, split), FAILED) for split in splits],
    )


def _failure_cell(outcome: MethodOutcome) -> Cell:
    counts = outcome.failures
    share = counts["not_settled"] / counts["runs"]
    left = counts["left_workspace"]
    return Cell(f"{share:.0%}", f"{left} left the workspace" if left else "", share)


def effort_table(comparison: Comparison) -> Table:
    """Effort of each method: simulator steps and time of tuning or training, and time per action."""
    columns = ["training seeds", "simulator steps per seed", "wall-clock per seed (s)"]
    columns += ["per action, median (µs)", "per action, 99 % (µs)"]
    if not comparison.timed:
        return _table(comparison, "What each method takes", columns, _effort)
    return _table(comparison, "What each method takes", [*columns, "latency that it was given (µs)"], _timed_effort)


def _table(
    comparison: Comparison, title: str, columns: list[str], cells: Callable[[MethodOutcome], list[Cell]]
) -> Table:
    made = [MethodLine(o.method.name, o.method.kind, o.seeds, cells(o)) for o in comparison.methods()]
    return Table(title, columns, made)


def _effort(outcome: MethodOutcome) -> list[Cell]:
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


def _timed_effort(outcome: MethodOutcome) -> list[Cell]:
    return [*_effort(outcome), _time_cell(1e6 * outcome.latency)]


def _time_cell(time: float) -> Cell:
    return Cell(f"{time:.0f}", f"{time / PERIOD_US:.0%} of the period", time, "late" if time > PERIOD_US else "")
