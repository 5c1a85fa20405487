"""Threads that share the blocks of a batch.

Kernels hold no lock of Python's, so that several run at a time. Each takes the blocks of its own share, which its core
has in its cache, and then what is left of the others': a thread that begins late, or whose core is busy with another
program, does less, and nobody waits for it. The number of threads changes no result.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any

import numpy as np
from numba import types
from numba.core.cgutils import get_item_pointer
from numba.extending import intrinsic, overload
from numpy.typing import NDArray

from beltarm_env.jit import inlined

Integers = NDArray[np.int64]

MAX_THREADS = 256
LEAST_BLOCKS, LEAST_BUILT_BLOCKS = 40, 8
"""For which it pays to wake a thread: of arms with an ideal drive, and with drives as they are built."""
_BACK = 1 << 32


def threads_for(blocks: int, built: bool, most: int) -> int:
    """Return how many threads to use for some blocks, of drives as they are built or not; at most so many."""
    return min(most, max(1, blocks // (LEAST_BUILT_BLOCKS if built else LEAST_BLOCKS)))


def in_threads(work: Callable[[int], None], threads: int) -> None:
    """Call a function in several threads, this one among them.

    Args:
        work: Called with the index of a thread; it ends when nothing is left to do, also for the others.
        threads: Their number.
    """
    others = [_threads(os.getpid()).submit(work, thread) for thread in range(1, threads)]
    work(0)
    for other in others:
        if not other.cancel():  # one that has not begun has nothing left to do
            other.result()


@cache
def _threads(_process: int) -> ThreadPoolExecutor:
    """Threads of this process; one that was forked from it has none of them."""
    return ThreadPoolExecutor(MAX_THREADS, thread_name_prefix="beltarm")


@inlined
def take_block(taken: Integers, share: int, first: int, behind: int, own: bool) -> int:
    """Take a block of a thread's share; no other thread is given the same.

    Its thread takes blocks from the front and the others from the back, so that those are the same in most steps, and
    are where they were needed last.

    Args:
        taken: How many blocks of each share were taken from the front, and from the back, times `_BACK`.
        share: Index of the share.
        first: Of its blocks.
        behind: The block behind its last.
        own: Whether it is the thread's own.

    Returns:
        The block, or -1 if none is left.
    """
    before = _add(taken, share, 1 if own else _BACK)
    front, back = before % _BACK, before // _BACK
    if front + back >= behind - first:
        return -1
    return first + front if own else behind - 1 - back


def _add(counts: Integers, index: int, more: int) -> int:
    """Add to a count, and return what it was before; in a kernel no other thread comes between."""
    counts[index] += more
    return int(counts[index] - more)


@intrinsic
def _add_atomically(_: Any, counts: Any, index: Any, more: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        array = context.make_array(signature.args[0])(context, builder, values[0])
        where = get_item_pointer(context, builder, signature.args[0], array, [values[1]])
        return builder.atomic_rmw("add", where, values[2], "monotonic")

    return types.int64(counts, types.intp, types.int64), generate


@overload(_add, inline="always")
def _add_compiled(counts: Any, index: Any, more: Any) -> Any:
    def add(counts: Any, index: Any, more: Any) -> Any:
        return _add_atomically(counts, index, more)  # pyright: ignore[reportCallIssue]

    return add
