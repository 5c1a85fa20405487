"""The comparison as one table, a row per method, split and metric; terminal, Markdown and report render parts of it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Generic, Literal, TypeVar

import pandas as pd

from eval.comparison.results import Comparison, Mark
from eval.comparison.schema import result_row

Marks = Mapping[str, Mapping[str, Mapping[str, Mark]]]
_Cell = TypeVar("_Cell")


def frame_of(comparison: Comparison) -> pd.DataFrame:
    """Table of a comparison, with marks; see `frame_of_rows`."""
    return frame_of_rows(map(result_row, comparison.outcomes), comparison.marks)


def frame_of_rows(rows: Iterable[Mapping[str, Any]], marks: Marks | None = None) -> pd.DataFrame:
    """Table of the `rows` of a results.json.

    Columns: method, kind, seeds, split, metric; iqm, low, high; mark, "best", "tie" or "".
    """
    marks = marks or {}
    entries = [
        {key: row[key] for key in ("method", "kind", "seeds", "split")}
        | {"metric": metric, **value, "mark": marks.get(row["split"], {}).get(metric, {}).get(row["method"], "")}
        for row in rows
        for metric, value in row["metrics"].items()
    ]
    return pd.DataFrame(entries)


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
    shown = {(row.method, getattr(row, across)): show(row) for row in found.itertuples()}
    columns = found[across].unique()
    methods = found.drop_duplicates("method")[["method", "kind", "seeds"]].itertuples(index=False, name=None)
    made = [MethodLine(*method, [shown.get((method[0], column), failed) for column in columns]) for method in methods]
    return sorted(made, key=lambda line: not line.ranked)
