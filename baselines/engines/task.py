"""Tasks that can run in another process: what they get, and how they end."""

from __future__ import annotations

import os
import pickle
import threading
import time
import traceback
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeVar

Result = TypeVar("Result")
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Variables that limit the threads of numerical libraries."""
_POLL = 0.1  # [s]


class StopRequest:
    """Request to end early, made by a signal, by a test, or by another process.

    Args:
        ask: Asks the other process whether it was made there, ten times a second at most.
    """

    def __init__(self, ask: Callable[[], bool] = lambda: False) -> None:
        self._ask = ask
        self._made = False
        self._asked = -_POLL

    @property
    def made(self) -> bool:
        """Whether it was made."""
        if not self._made and time.monotonic() - self._asked >= _POLL:
            self._asked = time.monotonic()
            self._made = self._ask()
        return self._made

    @made.setter
    def made(self, value: bool) -> None:
        self._made = value


class Interrupted(Exception):  # noqa: N818
    """Raised by a task that ends early because it was asked to, with its work saved."""


class BrokenOff(Exception):  # noqa: N818
    """A task whose process died: tasks side by side are begun anew first, see `baselines.engines.parallel`."""


@dataclass(frozen=True, slots=True)
class Channel:
    """Connection of a task to whoever began it; by default nobody."""

    report: Callable[[Any], object] = lambda _: None
    """Sends news."""
    stop: StopRequest = field(default_factory=StopRequest)
    """Whether the task should end; it may then raise `Interrupted`."""


Task = Callable[[Channel], Result]


@dataclass(frozen=True, slots=True)
class Failure:
    """The exception with which a task ended."""

    error: Exception

    @property
    def message(self) -> str:
        """The error in one line, with its kind and place unless it is about options or files."""
        text = " ".join(str(self.error).split())
        if isinstance(self.error, (OSError, ValueError, Interrupted, BrokenOff)):
            return text
        return " ".join([f"{type(self.error).__name__}: {text}", *getattr(self.error, "__notes__", [])[:1]])

    @property
    def resumable_message(self) -> str:
        """The message, with a remedy for a task that saves its work and whose process died."""
        return f"{self.message}; to continue, use --resume" if isinstance(self.error, BrokenOff) else self.message


def attempt(task: Task[Result], channel: Channel) -> Result | Failure:
    """Run a task, and return its result or failure."""
    try:
        return task(channel)
    except SystemExit as end:
        return Failure(ValueError(f"exit status {end.code}"))
    except Exception as error:
        frame = traceback.extract_tb(error.__traceback__)[-1]
        error.add_note(f"({os.path.basename(frame.filename)}, line {frame.lineno})")
        return Failure(error)


def pickled(outcome: Any) -> bytes:
    """Pickle an outcome, or where it cannot be or be read again, a failure that says so."""
    try:
        data = pickle.dumps(outcome)
        pickle.loads(data)
    except Exception as error:
        lost = Failure(outcome.error).message if isinstance(outcome, Failure) else f"its result is lost: {error!r}"
        return pickle.dumps(Failure(RuntimeError(lost)))
    return data


LEFT_OUT = b""
"""Outcome of a task that was asked to stop before it began."""


def work(name: str, task: Task[Any], news: Any, stops: Any, folder: str) -> bytes:
    """Run a task in a worker, unless it is asked to stop before, and return its outcome.

    News and outcomes travel as bytes: what is between the processes need not import what they are made of.

    Args:
        name: Of the task.
        task: What to do.
        news: Queue for pairs of the task's name and its news.
        stops: Queue; whatever is in it is a request to stop.
        folder: Where to work, if this machine has it.
    """

    def is_asked() -> bool:
        try:
            return not stops.empty()
        except (EOFError, OSError):  # the process that began the task has ended
            return True

    def report(what: Any) -> None:
        data = pickle.dumps((name, what))
        with suppress(EOFError, OSError):
            news.put(data)

    stop, parent = StopRequest(is_asked), os.getppid()
    if stop.made:
        return LEFT_OUT
    with suppress(OSError):
        os.chdir(folder)
    outcome = pickled(attempt(task, Channel(report, stop)))
    if os.getppid() != parent:  # nobody waits for it, nor has another task
        os._exit(1)
    return outcome


class Workers(NamedTuple):
    """Processes that run calls of `work`."""

    submit: Callable[[Callable[[], bytes]], Future[bytes]]
    is_death: Callable[[BaseException], bool]  # whether a future has this error because its process died
    news: Any  # queues of the calls
    stops: Any
    room: int  # calls that may be with them at a time
    one_ends_all: bool  # whether a process that dies takes the others along


def end_with_parent() -> None:
    """End this process when the one that began it has ended."""
    parent = os.getppid()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
