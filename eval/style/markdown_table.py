"""Tables in Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

_RULES = {"l": "---", "r": "---:"}


def markdown_table(titles: Sequence[str], rows: Iterable[Sequence[str]], align: str = "") -> str:
    """A table in Markdown.

    Args:
        titles: Of the columns.
        rows: Cells of each row.
        align: "l" or "r" for each column; by default numbers to the right of a column of names.
    """
    rules = [_RULES[side] for side in align or "l" + "r" * (len(titles) - 1)]
    lines = [f"| {' | '.join(titles)} |", f"|{'|'.join(rules)}|"]
    return "\n".join(lines + [f"| {' | '.join(row)} |" for row in rows])
