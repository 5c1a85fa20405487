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
LEAST_BLOCKS, LEAST_BUILT_BLOCKS = 15, 4
"""For which it pays to wake a thread: of arms with an ideal drive, and with drives as they are built."""
_BACK = 1 << 32
_PATIENCE = 30_000  # looks at whether others are at work: about as long as it takes to be woken

Item = TypeVar("Item")


def usual_threads(most: int = MAX_THREADS) -> int:
    """Return how many threads to use where no argument says so: OMP_NUM_THREADS, or one for each core that is there.

    Programs that run several processes at a time set this variable in each, as joblib does.

    Args:
        most: Threads that there is work for; for a single one the system is not asked.
    """
    if most <= 1:
        return 1
    told = os.environ.get("OMP_NUM_THREADS", "")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(int(told) if told.isdecimal() and int(told) > 0 else cores, most, MAX_THREADS)


def threads_for(blocks: int, built: bool, most: int) -> int:
    """Return how many threads to use for some blocks, of drives as they are built or not; at most so many."""
    return min(most, max(1, blocks // (LEAST_BUILT_BLOCKS if built else LEAST_BLOCKS)))


def none_taken(threads: int) -> Integers:
    """Return what kernels note of blocks that threads take, see `take_block`."""
    return np.zeros(2 * threads, np.int64)


def in_threads(work: Callable[[int], object], threads: int) -> None:
    """Call a function in several threads, this one among them.

    Args:
        work: Called with the index of a thread; it ends when nothing is left to do, also for the others.
        threads: Their number.
    """
    _in_threads(work, threads, lambda: True)


def share_blocks(work: Callable[[int], object], taken: Integers) -> None:
    """Call a kernel in several threads, this one among them, as `in_threads`.

    Once all blocks are done this thread goes on, and does not wait until others have Python's lock and can tell.

    Args:
        work: Called with the index of a thread; a kernel that takes its blocks by `take_block`.
        taken: Of `none_taken`, for as many threads.
    """
    threads = len(taken) // 2
    _in_threads(work, threads, lambda: bool(taken[threads:].any()))


def _in_threads(work: Callable[[int], object], threads: int, at_work: Callable[[], bool]) -> None:
    if threads == 1:
        work(0)
        return
    shares = [_Share(work, thread) for thread in range(1, threads)]
    for share in shares:
        _inbox(os.getpid(), share.thread).put(share)
    waits = True
    try:
        work(0)
        waits = at_work()
    finally:
        errors = [share.end(waits) for share in shares]
    for error in errors:
        if error is not None:
            raise error


def each_in_threads(work: Callable[[Item], object], items: Sequence[Item]) -> None:
    """Call a function for each of some items, in several threads if there are several items."""
    left = iter(items)  # of which no two threads are given the same

    def work_off(_thread: int) -> None:
        for item in left:
            work(item)

    in_threads(work_off, usual_threads(len(items)))


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

    def end(self, waits: bool) -> BaseException | None:
        """Keep the other thread from beginning; wait until it is done, if it has begun, and return what it raised."""
        return None if self._turn.acquire(blocking=False) or not waits else self._ended.get()


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
    steps, and are where they were needed last. Where none is left, the first thread waits a little for the others.

    Args:
        taken: How many blocks of each share were taken from the front, and from the back, times `_BACK`; and which
            threads are at work. Of `none_taken`.
        thread: Index of this one.
        blocks: Their number.

    Returns:
        The block, or -1 if none is left.
    """
    threads = len(taken) // 2
    if taken[threads + thread] == 0:
        _add(taken, threads + thread, 1)
    for turn in range(threads):
        share = (thread + turn) % threads
        first, behind = share * blocks // threads, (share + 1) * blocks // threads
        before = _add(taken, share, 1 if turn == 0 else _BACK)
        front, back = before % _BACK, before // _BACK
        if front + back < behind - first:
            return first + front if turn == 0 else behind - 1 - back
    _add(taken, threads + thread, -1)
    if thread == 0:
        for _ in range(_PATIENCE):
            working = 0
            for other in range(1, threads):
                working += _look(taken, threads + other)
            if working == 0:
                break
    return -1


def _add(counts: Integers, index: int, more: int) -> int:
    """Add to a count, and return what it was before; in a kernel no other thread comes between."""
    counts[index] += more
    return int(counts[index] - more)


def _look(counts: Integers, index: int) -> int:
    """Return a count that other threads change."""
    return int(counts[index])


@intrinsic
def _add_atomically(_: Any, counts: Any, index: Any, more: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        where = _where(context, builder, signature, values)
        return builder.atomic_rmw("add", where, values[2], "seq_cst")

    return types.int64(counts, types.intp, types.int64), generate


@intrinsic
def _look_anew(_: Any, counts: Any, index: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.load_atomic(_where(context, builder, signature, values), "acquire", align=8)

    return types.int64(counts, types.intp), generate


def _where(context: Any, builder: Any, signature: Any, values: Any) -> Any:
    of = signature.args[0]
    return get_item_pointer(context, builder, of, context.make_array(of)(context, builder, values[0]), [values[1]])


@overload(_add, inline="always")
def _add_compiled(counts: Any, index: Any, more: Any) -> Any:
    def add(counts: Any, index: Any, more: Any) -> Any:
        return _add_atomically(counts, index, more)  # pyright: ignore[reportCallIssue]

    return add


@overload(_look, inline="always")
def _look_compiled(counts: Any, index: Any) -> Any:
    def look(counts: Any, index: Any) -> Any:
        return _look_anew(counts, index)  # pyright: ignore[reportCallIssue]

    return look
