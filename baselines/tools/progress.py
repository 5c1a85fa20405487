"""Progress of tasks side by side, a row each, as all commands that run some show it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn


class ProgressRows:
    """Rows of a progress display; a row's clock starts with its first news."""

    def __init__(self, display: Progress, names: Iterable[str], total: float) -> None:
        self._display = display
        self._rows = {name: display.add_task(name, total=total, start=False, state="") for name in names}

    def show(self, name: str, completed: float | None = None, state: str = "") -> None:
        """Show how far a task has come, and its state in words."""
        self._display.start_task(self._rows[name])
        self._display.update(self._rows[name], completed=completed, state=state)


@contextmanager
def progress_rows(names: Iterable[str], total: float, console: Console | None = None) -> Iterator[ProgressRows]:
    """Show a row for each name, which is full at `total`."""
    columns = (TextColumn("{task.description}"), TextColumn("{task.percentage:3.0f} %"), BarColumn(bar_width=16))
    with Progress(*columns, TimeRemainingColumn(), TextColumn("{task.fields[state]}"), console=console) as display:
        yield ProgressRows(display, names, total)
