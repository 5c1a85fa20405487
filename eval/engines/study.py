"""Time and memory of tasks side by side: of empty ones, of equal ones, and of comparisons of growing size."""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path
from typing import NamedTuple

from baselines.engines.parallel import Channel, Engine, Failure, run_side_by_side
from eval.comparison.cache import Part, measure
from eval.comparison.methods import classical_methods
from eval.comparison.sets import development_set
from eval.engines.memory import Use, measured

COMPARE = Path(__file__).resolve().parents[1] / "compare.py"
ENGINES = {"local": Engine("local"), "ray": Engine("ray")}
METHOD = "adaptive"
"""Controller of the equal tasks."""
ARMS = 200
"""Scenarios of each of them."""


class Overhead(NamedTuple):
    """Time that an engine takes for tasks that do nothing."""

    begin: float  # to the result of the first [s]
    each: float  # of many [s]


def overhead(engine: Engine, jobs: int, count: int) -> Overhead:
    """Measure an engine with tasks that do nothing."""
    tasks = {str(number): _nothing for number in range(count)}
    began, times = time.perf_counter(), []
    for _ in run_side_by_side(tasks, jobs, engine=engine):
        times.append(time.perf_counter())
    return Overhead(times[0] - began, (times[-1] - times[0]) / (count - 1))


def _nothing(_: Channel) -> None:
    pass


def equal_tasks(engine: Engine, jobs: int, count: int) -> float:
    """Measure the time that so many equal tasks take from the end of a first round, which warms the workers up [s].

    Raises:
        ValueError: If a task fails.
    """
    method = next(method for method in classical_methods() if method.name == METHOD)
    pair = Part(method, development_set().splits["randomized"], ARMS)
    ends, began = [], 0.0
    tasks = {f"warm {number}": partial(_run, pair) for number in range(jobs)}
    tasks |= {str(number): partial(_run, pair) for number in range(count)}
    for number, (_, end) in enumerate(run_side_by_side(tasks, jobs, engine=engine), 1):
        if isinstance(end, Failure):
            raise ValueError(end.message)
        ends.append(time.perf_counter())
        began = ends[-1] if number == jobs else began
    return ends[-1] - began


def _run(pair: Part, _: Channel) -> None:
    measure(pair)


def comparison(method: str, scenarios: int, engine: str, jobs: int, folder: Path) -> Use:
    """Measure a comparison of one method on fresh scenarios of one split.

    Raises:
        OSError: If it fails.
    """
    what = ("--methods", method, "--splits", "randomized", "--scenario-seed", "1", "--episodes", str(scenarios))
    return measured(COMPARE, *what, "--engine", engine, "--jobs", str(jobs), "--fresh", "--out", folder)
