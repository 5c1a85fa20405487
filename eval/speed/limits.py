"""What a core can do at most: multiplications and additions that wait for nothing, and copies of memory."""

from __future__ import annotations

import numpy as np

from beltarm_env.arrays import Floats
from beltarm_env.jit import compiled
from beltarm_env.kernels.layout import aligned_zeros
from eval.speed.timing import times_in_turns

_LANES = 256  # few enough that they stay in the fastest cache
_ROUNDS = 2000
_DEPTH = 32
_CHAINS = 4  # that wait for nothing of each other
_COPIED = 1 << 19  # bytes, as much as blocks and observations of a few thousand arms
_REPETITIONS = 20


@compiled
def _multiply_and_add(values: Floats, rounds: int) -> None:
    """Take 2 `_DEPTH` operations on each of the values, which a processor can work on side by side."""
    for _ in range(rounds):
        for j in range(_LANES):
            a, b = values[j], values[_LANES + j]
            c, d = values[2 * _LANES + j], values[3 * _LANES + j]
            for _ in range(_DEPTH):
                a, b, c, d = a * 0.9 + 0.1, b * 0.9 + 0.1, c * 0.9 + 0.1, d * 0.9 + 0.1
            values[j], values[_LANES + j] = a, b
            values[2 * _LANES + j], values[3 * _LANES + j] = c, d


def arithmetic() -> float:
    """Measure float64 multiplications and additions of one core, as many of one as of the other [1/ns]."""
    values = aligned_zeros(_CHAINS * _LANES)
    took = times_in_turns([lambda: _multiply_and_add(values, _ROUNDS)], _REPETITIONS).min()
    return 1e-9 * 2 * _DEPTH * _CHAINS * _LANES * _ROUNDS / took


def copying() -> float:
    """Measure the bytes that one core reads and writes when it copies [1/ns]."""
    source = np.zeros(_COPIED, np.uint8)
    target = np.empty_like(source)
    took = times_in_turns([lambda: np.copyto(target, source)], _REPETITIONS).min()
    return 1e-9 * 2 * _COPIED / took
