"""Times of runs that take turns, and rows of measured speeds."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from beltarm_env.arrays import Floats

ROOT = Path(__file__).resolve().parents[2]


class Row(NamedTuple):
    """A measured quantity, beside that of a peer."""

    what: str
    measured: float
    unit: str  # "steps/s", "s" or "MB"
    peer: str | None = None
    of_peer: float | None = None
    ratios: tuple[float, ...] = ()  # how many times as good: lower quartile, median and upper quartile, or one


def times_in_turns(runs: Sequence[Callable[[], object]], repetitions: int) -> Floats:
    """Wall-clock of calls that take turns [s], shape (repetitions, calls); a busy machine slows all of them."""
    times = np.empty((repetitions + 1, len(runs)))
    for repetition in range(repetitions + 1):
        for k, run in enumerate(runs):
            began = time.perf_counter()
            run()
            times[repetition, k] = time.perf_counter() - began
    return times[1:]  # the first warms up


def speed(what: str, steps: int, times: Floats, peer: str, steps_of_peer: int, times_of_peer: Floats) -> Row:
    """Row of a speed, from the times that so many steps took in each repetition [s]."""
    rates, of_peer = steps / times, steps_of_peer / times_of_peer
    ratios = np.quantile(rates / of_peer, [0.25, 0.5, 0.75]).tolist()
    return Row(what, float(np.median(rates)), "steps/s", peer, float(np.median(of_peer)), tuple(ratios))


def numbers(code: str, *words: str, **environment: str) -> list[float]:
    """Numbers that a Python process of its own prints."""
    known = {**os.environ, "PYTHONPATH": str(ROOT), **environment}
    command = [sys.executable, "-c", code, *words]
    return [float(word) for word in subprocess.check_output(command, env=known, text=True).split()]
