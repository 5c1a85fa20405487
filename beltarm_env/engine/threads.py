"""Calls of Python functions in several threads, for work of a millisecond and more; kernels have `in_threads`."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from functools import cache
from typing import TypeVar

from beltarm_env.engine.blocks import MAX_THREADS, usual_threads

Item = TypeVar("Item")


def in_python_threads(work: Callable[[int], object], threads: int) -> None:
    """Call a function in several threads, this one among them.

    Nobody waits for a thread that has not begun when this one is done.

    Args:
        work: Called with the index of a thread; it ends when nothing is left to do, also for the others.
        threads: Their number; fewer, where the system allows no more.
    """
    futures: list[Future[object]] = []
    with suppress(RuntimeError):  # of a thread that cannot be started
        futures += [_executor(os.getpid()).submit(work, thread) for thread in range(1, threads)]
    try:
        work(0)
    finally:
        begun = [future for future in futures if not future.cancel()]
        errors = [future.exception() for future in begun]
    for error in errors:
        if error is not None:
            raise error


def each_in_threads(work: Callable[[Item], object], items: Sequence[Item]) -> None:
    """Call a function for each of some items, in several threads if there are several items."""
    left = iter(items)  # of which no two threads are given the same

    def work_off(_thread: int) -> None:
        for item in left:
            work(item)

    in_python_threads(work_off, usual_threads(len(items)))


@cache
def _executor(_process: int) -> ThreadPoolExecutor:
    """Threads of this process; one that was forked from it has none of them."""
    return ThreadPoolExecutor(MAX_THREADS, "beltarm")
