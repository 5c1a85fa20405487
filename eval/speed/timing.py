"""Times of runs that take turns, and rows of what was measured."""

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
    """What was measured, beside a peer; "-" where there is none."""

    what: str
    measured: str
    peer: str = "-"
    ratio: str = "-"
    half: str = "-"  # of the repetitions, between whose ratios the others lie


def times_in_turns(runs: Sequence[Callable[[], object]], repetitions: int) -> Floats:
    """Wall-clock of calls that take turns [s], shape (repetitions, calls); a busy machine slows all of them."""
    times = np.empty((repetitions + 1, len(runs)))
    for repetition in range(repetitions + 1):
        for k, run in enumerate(runs):
            began = time.perf_counter()
            run()
            times[repetition, k] = time.perf_counter() - began
    return times[1:]  # the first warms up


def ratios(times: Floats, peer: Floats) -> tuple[str, str]:
    """How many times as fast as a peer, in the median over repetitions, and in the middle half of them.

    Args:
        times: Of each repetition, shape (repetitions,).
        peer: Of the peer in it.
    """
    low, median, high = np.quantile(peer / times, [0.25, 0.5, 0.75])
    return f"{median:.2f}x", f"{low:.2f} to {high:.2f}"


def numbers(code: str, *words: str, **environment: str) -> list[float]:
    """Numbers that a Python process of its own prints."""
    result = subprocess.run(
        [sys.executable, "-c", code, *words],
        env={**os.environ, "PYTHONPATH": str(ROOT), **environment},
        capture_output=True,
        text=True,
        check=True,
    )
    return [float(word) for word in result.stdout.split()]
