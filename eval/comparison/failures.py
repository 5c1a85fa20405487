"""Failures of controllers: each is reported, and affects nothing else."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

import agents
import baselines
import beltarm_env
import eval
from baselines.engines import parallel
from baselines.engines.isolated import run_isolated
from eval.comparison.methods import Method

_LONGEST_MESSAGE = 300
_INSTALLED = {"site-packages", "lib", "<string>"}  # folders of code that is not a user's own
_Result = TypeVar("_Result")


@dataclass(frozen=True, slots=True)
class Failure:
    """A method that could not be run to the end on a split."""

    method: str
    split: str
    message: str
    trace: str = ""  # the whole traceback


def run_controller(method: Method, split: str, run: Callable[[], _Result], where: str = "") -> _Result | Failure:
    """Run the controllers of a method on a split; an added one's in a process of its own, whose end is a `Failure` too.

    `run` must be picklable; `where` begins a failure's message.
    """
    if method.kind != "added":
        return attempt(method.name, split, run, where)
    try:
        return run_isolated(partial(attempt, method.name, split, run, where), method.sources[0], method.time_limit)
    except parallel.BrokenOff as end:
        return Failure(method.name, split, f"{where}: {end}" if where else str(end))


def attempt(method: str, split: str, run: Callable[[], _Result], where: str = "") -> _Result | Failure:
    """Run something of a method; an exception becomes a `Failure`, and so does a request to exit."""
    try:
        return run()
    except (Exception, SystemExit) as error:
        message = " ".join(f"{where}{': ' if where else ''}{type(error).__name__}: {error}".split())
        return Failure(method, split, message[:_LONGEST_MESSAGE] + place(error), trace(error))


def trace(error: BaseException) -> str:
    """The whole traceback of an exception."""
    return "".join(traceback.format_exception(error))


def place(error: BaseException) -> str:
    """File and line of a user's own code in which an exception was raised, in brackets; empty if it was in none."""
    ours = tuple(str(Path(package.__path__[0])) for package in (beltarm_env, baselines, agents, eval))
    frames = traceback.extract_tb(error.__traceback__)
    own = [f for f in frames if not f.filename.startswith(ours) and not {*Path(f.filename).parts} & _INSTALLED]
    return f" ({Path(own[-1].filename).name}:{own[-1].lineno})" if own else ""


def explained(failure: parallel.Failure, jobs: int | None) -> Exception:
    """Return the error of a task, with a remedy where its process died."""
    if isinstance(failure.error, parallel.BrokenOff):
        fewer = max(1, (jobs or parallel.default_jobs()) // 2)
        return OSError(f"{failure.message}: try again with --jobs {fewer}")
    return failure.error
