"""Where in a step motors stop or break away, of many arms side by side: where their margins fall below zero."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltarm_env.engine import compiled, inlined
from beltarm_env.kernels.layout import LANES
from beltarm_env.physics.events import (
    CLOSE,
    EXIT_ITERATIONS,
    Margin,
    dips,
    first_guess,
    lowest_point,
    nearer_exit,
)

Floats = NDArray[np.float64]

# Rows of the working block.
EXIT = len(Margin._fields)  # as a share of the step, in (0, 1]; 1 where there is none
_LOW = EXIT + 1  # bounds of the exit
_HIGH = _LOW + 1
_SEARCHED = _HIGH + 1  # whether it is not yet close
_DIPS = _SEARCHED + 1
EXIT_ROWS = _DIPS + 1


@inlined
def load_margin(work: Floats, row: int, lane: int) -> Margin:
    """Load the margin of one lane, from six rows starting at `row`."""
    at = row * LANES + lane
    return Margin._make(work[at + k * LANES] for k in range(len(Margin._fields)))


@inlined
def store_margin(work: Floats, row: int, lane: int, m: Margin) -> None:
    """Write a margin to six rows starting at `row`."""
    at = row * LANES + lane
    for k, value in enumerate(m):
        work[at + k * LANES] = value


@compiled
def find_exits(work: Floats, count: int) -> None:
    """Find where the margins of the first `count` lanes, in rows 0 to 5, fall below zero; into row EXIT."""
    dipping = 0
    for j in range(count):
        dip = dips(load_margin(work, 0, j))
        work[_DIPS * LANES + j] = 1.0 if dip else 0.0
        work[_HIGH * LANES + j] = 1.0
        dipping += 1 if dip else 0
    if dipping > 0:  # hardly ever
        for j in range(count):
            if work[_DIPS * LANES + j] != 0.0:
                work[_HIGH * LANES + j] = lowest_point(load_margin(work, 0, j))
    for j in range(count):
        guess, exists = first_guess(load_margin(work, 0, j), work[_HIGH * LANES + j])
        work[EXIT * LANES + j] = guess if exists else 1.0
        work[_LOW * LANES + j] = 0.0
        work[_SEARCHED * LANES + j] = 1.0 if exists else 0.0
    for _ in range(EXIT_ITERATIONS):
        if not _search(work, count):
            break


@inlined
def _search(work: Floats, count: int) -> bool:
    left = 0
    for j in range(count):
        searched, before = work[_SEARCHED * LANES + j], work[EXIT * LANES + j]
        low, high = work[_LOW * LANES + j], work[_HIGH * LANES + j]
        u, low, high = nearer_exit(load_margin(work, 0, j), before, low, high)
        goes_on = (searched != 0.0) & (abs(u - before) >= CLOSE)
        work[EXIT * LANES + j] = u if searched != 0.0 else before
        work[_LOW * LANES + j] = low
        work[_HIGH * LANES + j] = high
        work[_SEARCHED * LANES + j] = 1.0 if goes_on else 0.0
        left += 1 if goes_on else 0
    return left > 0
