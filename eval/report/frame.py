"""Table of a comparison, a row per method, split and metric, for terminal and Markdown; and the order of methods."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, Literal, TypeVar

import numpy as np
import pandas as pd

from beltarm_env.metrics import NOT_ARRIVED, SHOWN
from eval.comparison.results import Comparison, Mark, MethodOutcome
from eval.comparison.schema import result_row

Marks = Mapping[str, Mapping[str, Mapping[str, Mark]]]
_Cell = TypeVar("_Cell")


def best_first(comparison: Comparison) -> Comparison:
    """Copy whose methods come in the order of their cost on the main split, the lowest first.

    Methods that failed on that split follow; those that are not ranked are last.
    """
    costs = {o.method.name: o.estimates["cost"].iqm for o in comparison.on(comparison.main_split)}

    def place(outcome: MethodOutcome) -> tuple[bool, float, str]:
        name = outcome.method.name
        return not outcome.ranked, costs.get(name, np.inf), name

    return replace(comparison, outcomes=sorted(comparison.outcomes, key=place))


def frame_of(comparison: Comparison) -> pd.DataFrame:
    """Table of a comparison, with marks; see `frame_of_rows`."""
    return frame_of_rows(map(result_row, comparison.outcomes), comparison.marks)


def frame_of_rows(rows: Iterable[Mapping[str, Any]], marks: Marks | None = None) -> pd.DataFrame:
    """Table of the `rows` of a results.json.

    Columns: method, kind, seeds, split, metric; iqm, low, high, not numbers where no arms arrive; mark, "best", "tie"
    or "".
    """
    marks = marks or {}
    nothing = dict.fromkeys(("iqm", "low", "high"), np.nan)
    entries = [
        {key: row[key] for key in ("method", "kind", "seeds", "split")}
        | {"metric": metric, **row["metrics"].get(metric, nothing)}
        | {"mark": marks.get(row["split"], {}).get(metric, {}).get(row["method"], "")}
        for row in rows
        for metric in SHOWN
        if metric in row["metrics"] or NOT_ARRIVED in row["metrics"]  # older files do not tell who arrives
    ]
    return pd.DataFrame(entries)


def part(found: pd.DataFrame, **wanted: Sequence[str]) -> pd.DataFrame:
    """Rows of the table whose columns have one of the wanted values each."""
    return found.loc[np.logical_and.reduce([found[column].isin(values) for column, values in wanted.items()])]


@dataclass(frozen=True, slots=True)
class MethodLine(Generic[_Cell]):
    """Line of a shown table: a method and its cells."""

    method: str
    kind: str
    seeds: int
    cells: list[_Cell]

    @property
    def ranked(self) -> bool:
        """Whether it is compared with others."""
        return self.kind != "privileged"


def lines(
    found: pd.DataFrame, across: Literal["split", "metric"], show: Callable[[Any], _Cell], failed: _Cell
) -> list[MethodLine[_Cell]]:
    """Lines of a part of the table: one per method, those that are not ranked last; a cell per split or metric.

    Args:
        found: Part of the table, with a single row per method and cell.
        across: What the columns are.
        show: Cell of a row, given as a named tuple.
        failed: Cell of a method that has no row there.
    """
    rows: list[Any] = list(found.itertuples())
    shown = {(row.method, getattr(row, across)): show(row) for row in rows}
    columns = dict.fromkeys(getattr(row, across) for row in rows)
    methods = {row.method: (row.kind, row.seeds) for row in rows}
    made = [
        MethodLine(method, kind, seeds, [shown.get((method, column), failed) for column in columns])
        for method, (kind, seeds) in methods.items()
    ]
    return sorted(made, key=lambda line: not line.ranked)
