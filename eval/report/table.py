"""Tables of methods: one structure, rendered as Markdown, on the terminal, and by `parts.html` as HTML."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass

from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table as TerminalTable

from eval.report.text import markdown_table

_MARKDOWN = {"best": "**{}**", "tie": "<ins>{}</ins>"}
_TERMINAL = {"best": ("*", "bold"), "tie": ("=", "underline")}
_NAME_WIDTH, _HEAD_WIDTH = 24, 7  # columns of a terminal: a long name is cut, and no number


@dataclass(frozen=True, slots=True)
class Cell:
    """Cell of a table."""

    text: str
    interval: str = ""
    details: tuple[str, ...] = ()  # more lines of small print
    value: float | None = None  # by which a page sorts; None is last
    mark: str = ""  # "best" or "tie", or "late" beyond the control period


@dataclass(frozen=True, slots=True)
class Row:
    """Row of a table: a method and its cells."""

    method: str
    kind: str
    seeds: int
    cells: list[Cell]

    @property
    def ranked(self) -> bool:
        """Whether it is compared with others."""
        return self.kind != "privileged"


@dataclass(frozen=True, slots=True)
class Table:
    """Table of methods; those that are not ranked are at the bottom."""

    title: str
    columns: list[str]
    rows: list[Row]

    @property
    def ranked(self) -> list[Row]:
        """Methods that are compared with others."""
        return [row for row in self.rows if row.ranked]

    @property
    def unranked(self) -> list[Row]:
        """Methods that see what no other does."""
        return [row for row in self.rows if not row.ranked]


def to_markdown(table: Table, *, intervals: bool = True, seeds: bool = False) -> str:
    """Render a table as Markdown.

    Args:
        table: What to show; details of its cells are left out.
        intervals: Whether each cell has its interval.
        seeds: Whether the number of training seeds stands beside a learned method's name.
    """
    rows = []
    for row in table.rows:
        count = f" ({row.seeds} seed{'s' * (row.seeds > 1)})" if seeds and row.kind == "learned" else ""
        texts = [_MARKDOWN.get(cell.mark, "{}").format(cell.text) for cell in row.cells]
        if intervals:
            texts = [f"{text} {cell.interval}".rstrip() for text, cell in zip(texts, row.cells, strict=True)]
        rows.append([text if row.ranked else f"*{text}*" for text in (row.method + count, *texts)])
    return markdown_table(["method", *table.columns], rows)


def to_terminal(table: Table, *, intervals: bool = False) -> TerminalTable:
    """Render a table for the terminal: a star marks the best of a column, an equals sign a tie."""
    shown = TerminalTable(
        title=table.title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0)
    )
    shown.add_column("method", no_wrap=True, max_width=_NAME_WIDTH)
    for column in table.columns:
        head = "\n".join(textwrap.wrap(column, _HEAD_WIDTH, break_long_words=False))
        shown.add_column(head, justify="right", no_wrap=True)
    for row in table.rows:
        cells = [_terminal_cell(cell, intervals) for cell in row.cells]
        shown.add_row(escape(row.method), *cells, style="" if row.ranked else "dim italic")
    return shown


def _terminal_cell(cell: Cell, intervals: bool) -> str:
    sign, style = _TERMINAL.get(cell.mark, (" ", ""))
    text = f"{escape(cell.text)}{sign}"
    text = f"[{style}]{text}[/{style}]" if style else text
    return f"{text}\n{escape(cell.interval)} " if intervals and cell.interval else text


def parts_of(table: Table, columns: int) -> list[Table]:
    """Cut a table into tables of at most so many columns."""

    def part(first: int) -> Table:
        chosen = slice(first, first + columns)
        rows = [Row(row.method, row.kind, row.seeds, row.cells[chosen]) for row in table.rows]
        return Table(table.title, table.columns[chosen], rows)

    return [part(first) for first in range(0, len(table.columns), columns)]
