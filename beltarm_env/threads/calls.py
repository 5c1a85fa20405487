"""Calls of functions in several threads, for work of a millisecond and more.

Each of the other threads needs Python's lock to begin and to end. What is too short for that is offered to threads that
stand by, see `standby`.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from functools import cache
from queue import SimpleQueue
from threading import Lock, Thread
from typing import TypeVar

from beltarm_env.threads.blocks import usual_threads
from beltarm_env.threads.words import Integers

Item = TypeVar("Item")


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
    threads = len(taken) // 3
    _in_threads(work, threads, lambda: bool(taken[threads : 2 * threads].any()))


def _in_threads(work: Callable[[int], object], threads: int, at_work: Callable[[], bool]) -> None:
    if threads == 1:
        work(0)
        return
    shares = [_Share(work, thread) for thread in range(1, threads)]
    for share in shares:
        inbox = _inbox(os.getpid(), share.thread)
        if inbox is None:
            break  # the threads that there are do its work
        inbox.put(share)
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
def _inbox(_process: int, thread: int) -> SimpleQueue[_Share] | None:
    """Where a thread of this process finds its work; one that was forked from it has none of its threads.

    Returns:
        None if the system allows no new thread.
    """
    inbox: SimpleQueue[_Share] = SimpleQueue()
    started = start(Thread(target=_work_off, args=(inbox,), name=f"beltarm-{thread}", daemon=True))
    return inbox if started else None


def start(thread: Thread) -> bool:
    """Start a thread, and return whether the system allows one more."""
    try:
        thread.start()
    except RuntimeError:
        return False
    return True


def _work_off(inbox: SimpleQueue[_Share]) -> None:
    while True:
        inbox.get().do()
