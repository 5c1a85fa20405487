"""Tasks that can run in another process: what they get, and how they end."""

from __future__ import annotations

import os
import pickle
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeVar

Result = TypeVar("Result")
_POLL = 0.1  # [s]


class StopRequest:
    """Request to end early, made by a signal or by a test."""

    def __init__(self) -> None:
        self.made = False


class PolledStop(StopRequest):
    """Request to stop as seen by a worker, which asks for it now and then.

    Args:
        ask: Whether it was made.
    """

    def __init__(self, ask: Callable[[], bool]) -> None:
        self._ask = ask
        self._looked = -_POLL
        self._made = False

    @property
    def made(self) -> bool:
        """Whether it was made."""
        if not self._made and time.monotonic() - self._looked >= _POLL:
            self._looked = time.monotonic()
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
        words = " ".join(str(self.error).split())
        if isinstance(self.error, (OSError, ValueError, Interrupted, BrokenOff)):
            return words
        return " ".join([f"{type(self.error).__name__}: {words}", *getattr(self.error, "__notes__", [])[:1]])

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
