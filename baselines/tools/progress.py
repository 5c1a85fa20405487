"""Progress of commands, as all of them show it. A display appears with its first news: a refusal comes without one."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

_Thing = TypeVar("_Thing")
_LINE_EVERY = 15.0  # [s], where there is no terminal


@contextmanager
def progress_rows(names: Iterable[str], total: float, console: Console | None = None) -> Iterator[Callable[..., None]]:
    """Show a row for each name, which is full at `total`; its clock starts with its first news.

    Call with the name, how much is completed, and the state in words.
    """
    columns = (TextColumn("{task.description}"), TextColumn("{task.percentage:3.0f} %"), BarColumn(bar_width=16))
    display = Progress(*columns, TimeRemainingColumn(), TextColumn("{task.fields[state]}"), console=console)
    rows = {name: display.add_task(name, total=total, start=False, state="") for name in names}

    def show(name: str, completed: float | None = None, state: str = "") -> None:
        display.start_task(rows[name])
        display.update(rows[name], completed=completed, state=state)
        display.start()

    try:
        yield show
    finally:
        _stop(display)


@contextmanager
def progress_count(name: str, console: Console) -> Iterator[Callable[[int, int], None]]:
    """Show how many of some things are done, until all are: call with their number and the total.

    Where `console` is no terminal, errors get a line now and then.
    """
    display = Progress(console=console, transient=True, disable=not console.is_terminal)
    row = display.add_task(name, total=None)
    said = time.monotonic()

    def show(done: int, total: int) -> None:
        nonlocal said
        if display.disable and time.monotonic() - said > _LINE_EVERY:
            said = time.monotonic()
            print(f"{name}: {done} of {total}", file=sys.stderr, flush=True)
        display.update(row, completed=done, total=total)
        display.start()

    try:
        yield show
    finally:
        _stop(display)


def progress_over(name: str, things: Iterable[_Thing], console: Console | None = None) -> Iterator[_Thing]:
    """Go through things, and show how many are done, see `progress_count`; by default among the errors."""
    listed = list(things)
    with progress_count(name, console or Console(stderr=True)) as show:
        for number, thing in enumerate(listed):
            show(number, len(listed))
            yield thing


def _stop(display: Progress) -> None:
    """Stop a display that has begun; one that has not would leave an empty line."""
    if display.live.is_started:
        display.stop()
