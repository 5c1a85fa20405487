"""How threads share the blocks of a batch, and how many of them there are.

Kernels hold no lock of Python's, so that several run at a time. Each takes the blocks of its own share, which its core
has in its cache, and then what is left of the others': a thread that begins late, or whose core is busy with another
program, does less, and nobody waits for it. The number of threads changes no result.
"""

from __future__ import annotations

import os

import numpy as np

from beltarm_env.engine.kernels import inlined
from beltarm_env.engine.words import Integers, add

MAX_THREADS = 256
LEAST_BLOCKS, LEAST_SELDOM_BLOCKS, LEAST_REAL_BLOCKS = 8, 30, 2
"""For which a thread pays: of arms with an ideal drive that are stepped often, or seldom, so that it must be woken each
time; and with real drives."""
SOON = 1e-3
"""Time within which a call must follow another for threads to be awake still [s]."""
_BACK = 1 << 32


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


def threads_for(blocks: int, real_drives: bool, seldom: bool, most: int) -> int:
    """Return how many threads to use.

    Args:
        blocks: Of arms.
        real_drives: Whether real drives are among them.
        seldom: Whether they are stepped so seldom that threads sleep in between.
        most: Threads that there are.
    """
    least = LEAST_REAL_BLOCKS if real_drives else (LEAST_SELDOM_BLOCKS if seldom else LEAST_BLOCKS)
    return min(most, max(1, blocks // least))


def none_taken(threads: int) -> Integers:
    """Return what kernels note of blocks that threads take, see `take_block`."""
    return np.zeros(threads, np.int64)


@inlined
def take_block(taken: Integers, thread: int, blocks: int) -> int:
    """Take a block, of a thread's own share or of what is left of the others'; no other thread is given the same.

    Its thread takes blocks of a share from the front and the others from the back, so that those are the same in most
    steps, and are where they were needed last.

    Args:
        taken: How many blocks of each share were taken from the front, and from the back, times `_BACK`.
        thread: Index of this one.
        blocks: Their number.

    Returns:
        The block, or -1 if none is left.
    """
    threads = len(taken)
    for turn in range(threads):
        share = (thread + turn) % threads
        first, behind = share * blocks // threads, (share + 1) * blocks // threads
        before = add(taken, share, 1 if turn == 0 else _BACK)
        front, back = before % _BACK, before // _BACK
        if front + back < behind - first:
            return first + front if turn == 0 else behind - 1 - back
    return -1
