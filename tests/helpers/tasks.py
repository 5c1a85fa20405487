"""Tasks to run side by side, which workers import from here."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Any

from baselines.engines.parallel import Channel, Interrupted


def square(number: int, channel: Channel) -> int:
    for part in range(3):
        channel.report((number, part))
    return number**2


def fail(error: Exception, _: Channel) -> None:
    raise error


def last(folder: Path, channel: Channel) -> str:
    """Run until asked to stop, leaving a file at begin and end."""
    (folder / "began").write_text(str(os.getpid()))
    while not channel.stop.made:
        time.sleep(0.01)
    (folder / "ended").write_text("")
    raise Interrupted("saved")


def die_at_first(folder: Path, times: int, channel: Channel) -> str:
    """Be killed so many times, and succeed after that."""
    tries = len(list(folder.glob("try*")))
    (folder / f"try{tries}").write_text("")
    if tries < times:
        time.sleep(0.2)
        os.kill(os.getpid(), signal.SIGKILL)
    return f"after {tries}"


def slow_square(number: int, channel: Channel) -> int:
    time.sleep(0.5)
    return number**2


def where(_: Channel) -> tuple[str, str | None]:
    return os.getcwd(), os.environ.get("OMP_NUM_THREADS")


def where_it_works(folder: Path, _: Channel) -> str:
    return str(folder)


class UnpicklableError(Exception):
    def __init__(self, first: int, second: int) -> None:
        super().__init__(f"{first} and {second}")


def raise_unpicklable(_: Channel) -> None:
    raise UnpicklableError(1, 2)


def give_unpicklable(_: Channel) -> Any:
    return lambda: None


def until_begun(folders: list[Path], _: Channel) -> None:
    while not all((folder / "began").exists() for folder in folders):
        time.sleep(0.01)
