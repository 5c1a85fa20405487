"""Threads that share the work of a batch.

Kernels hold no lock of Python's, so that several run at a time. Each takes the blocks of its own share, which its core
has in its cache, and then what is left of the others': a thread that begins late, or whose core is busy with another
program, does less, and nobody waits for it. The number of threads changes no result.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from functools import cache
from queue import SimpleQueue
from threading import Lock, Thread
from typing import Any, TypeVar

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

Item = TypeVar("Item")


def usual_threads() -> int:
    """Return how many threads to use where no argument says so: OMP_NUM_THREADS, or one for each core that is there.

    Programs that run several processes at a time set this variable in each, as joblib does.
    """
    told = os.environ.get("OMP_NUM_THREADS", "")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(int(told) if told.isdecimal() and int(told) > 0 else cores, MAX_THREADS)


def threads_for(blocks: int, built: bool, most: int) -> int:
    """Return how many threads to use for some blocks, of drives as they are built or not; at most so many."""
    return min(most, max(1, blocks // (LEAST_BUILT_BLOCKS if built else LEAST_BLOCKS)))


def in_threads(work: Callable[[int], object], threads: int) -> None:
    """Call a function in several threads, this one among them.

    Args:
        work: Called with the index of a thread; it ends when nothing is left to do, also for the others.
        threads: Their number.
    """
    shares = [_Share(work, thread) for thread in range(1, threads)]
    for share in shares:
        _inbox(os.getpid(), share.thread).put(share)
    try:
        work(0)
    finally:
        errors = [share.end() for share in shares]
    for error in errors:
        if error is not None:
            raise error


def each_in_threads(work: Callable[[Item], object], items: Sequence[Item]) -> None:
    """Call a function for each of some items, in several threads if there are several items."""
    left = iter(items)  # of which no two threads are given the same

    def work_off(_thread: int) -> None:
        for item in left:
            work(item)

    in_threads(work_off, min(usual_threads(), max(len(items), 1)))


class _Share:
    """What one of the other threads does of a call; to hand it over takes less than a future of Python's library."""

    def __init__(self, work: Callable[[int], object], thread: int) -> None:
        self.thread = thread
        self._work = work
        self._turn = Lock()  # taken by the thread that begins, or by who has nothing left for it to do
        self._ended: SimpleQueue[BaseException | None] = SimpleQueue()

    def do(self) -> None:
        """Do it, in the other thread."""
        if self._turn.acquire(blocking=False):
            try:
                self._work(self.thread)
            except BaseException as error:
                self._ended.put(error)
            else:
                self._ended.put(None)

    def end(self) -> BaseException | None:
        """Wait until the other thread is done, if it has begun; return what it raised."""
        return None if self._turn.acquire(blocking=False) else self._ended.get()


@cache
def _inbox(_process: int, thread: int) -> SimpleQueue[_Share]:
    """Where a thread of this process finds its work; one that was forked from it has none of its threads."""
    inbox: SimpleQueue[_Share] = SimpleQueue()
    Thread(target=_work_off, args=(inbox,), name=f"beltarm-{thread}", daemon=True).start()
    return inbox


def _work_off(inbox: SimpleQueue[_Share]) -> None:
    while True:
        inbox.get().do()


@inlined
def take_block(taken: Integers, thread: int, blocks: int) -> int:
    """Take a block, of a thread's own share or of what is left of the others'; no other thread is given the same.

    Its thread takes blocks of a share from the front and the others from the back, so that those are the same in most
    steps, and are where they were needed last.

    Args:
        taken: How many blocks of each share were taken from the front, and from the back, times `_BACK`; shape
            (threads,), zeros at first.
        thread: Index of this one.
        blocks: Their number.

    Returns:
        The block, or -1 if none is left.
    """
    threads = len(taken)
    for turn in range(threads):
        share = (thread + turn) % threads
        first, behind = share * blocks // threads, (share + 1) * blocks // threads
        before = _add(taken, share, 1 if turn == 0 else _BACK)
        front, back = before % _BACK, before // _BACK
        if front + back < behind - first:
            return first + front if turn == 0 else behind - 1 - back
    return -1


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
