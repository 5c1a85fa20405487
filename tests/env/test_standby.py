"""Threads that stand by for kernels: they take each part once, are waited for, and go to sleep."""

import multiprocessing
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier, Thread

import numpy as np
import pytest
from numpy.typing import NDArray

from beltarm_env.jit import PLAIN, compiled
from beltarm_env.threads import standby
from beltarm_env.threads.blocks import none_taken, take_block
from beltarm_env.threads.standby import share, standing_by

pytestmark = pytest.mark.skipif(PLAIN, reason="kernels that are not compiled have one thread")

PARTS = 50
ROUNDS = 1000  # of a part, which take some microseconds
Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@compiled
def work(thread: int, taken: Integers, parts: tuple[Floats, Integers], rounds: int) -> None:
    """Compute something in each part that is taken, and note by whom."""
    values, by_whom = parts
    while True:
        k = take_block(taken, thread, len(values))
        if k < 0:
            break
        for number in range(rounds):
            values[k] = 0.5 * values[k] + number
        by_whom[k] = thread


@compiled
def shared_work(taken: Integers, boxes: Integers, values: Floats, by_whom: Integers, rounds: int) -> None:
    share(work, (taken, (values, by_whom), rounds), taken, boxes)


def computed(rounds: int) -> float:
    value = 0.0
    for number in range(rounds):
        value = 0.5 * value + number
    return value


def done(threads: int, rounds: int = ROUNDS) -> Integers:
    """Share work, and return which thread took each part."""
    values, by_whom = np.zeros(PARTS), np.full(PARTS, -1)
    shared_work(none_taken(threads), standing_by(threads), values, by_whom, rounds)
    assert (values == computed(rounds)).all(), "each part once, and all of them"
    assert ((by_whom >= 0) & (by_whom < threads)).all()
    return by_whom


def eventually(happens: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 60
    while not happens():
        assert time.monotonic() < deadline
        time.sleep(1e-4)


def is_shared(threads: int) -> bool:
    """Whether the others took any part of some work."""
    return bool(done(threads).any())


@pytest.mark.parametrize("threads", [1, 2, 3, 16])
def test_each_part_is_done_once(threads: int):
    for rounds in range(200):
        done(threads, rounds)
    if threads > 1:
        eventually(lambda: is_shared(threads))
    others = standby._boxes(os.getpid())[1:threads]
    eventually(lambda: bool((others[:, standby._OFFER] == standby._NONE).all()))


def test_several_callers_at_a_time():
    barrier = Barrier(4)

    def call(_: int) -> None:
        barrier.wait(60)
        for _ in range(100):
            done(3)

    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(call, range(4))) == [None] * 4


@pytest.mark.parametrize("offer", [standby._NONE, standby._TAKEN])
def test_a_thread_that_sleeps_or_works_for_another_caller_is_not_waited_for(offer: int):
    box = np.zeros((1, standby._WORDS), np.int64)
    box[0, standby._OFFER] = offer
    values, by_whom = np.zeros(PARTS), np.full(PARTS, -1)
    shared_work(none_taken(2), box, values, by_whom, ROUNDS)
    assert (values == computed(ROUNDS)).all() and not by_whom.any()
    assert box[0, standby._OFFER] == offer, "what was offered is withdrawn"


def test_they_sleep_when_no_call_comes_and_are_woken_again():
    eventually(lambda: is_shared(2))
    box = standby._boxes(os.getpid())[1]
    eventually(lambda: box[standby._AWAKE] == 0)
    eventually(lambda: is_shared(2))


def test_none_is_within_a_kernel_once_python_ends():
    """Where it would run on while its code is taken away."""
    boxes = np.zeros((2, standby._WORDS), np.int64)
    standby._serve(boxes[0], 0, 1)  # compiled before the clock runs
    boxes[1, standby._AWAKE] = 1
    thread = Thread(target=standby._serve, args=(boxes[1], 1, 1 << 60), daemon=True)
    thread.start()
    thread.join(0.05)
    assert thread.is_alive()
    standby._dismiss(os.getpid(), boxes)
    thread.join(60)
    assert not thread.is_alive() and boxes[1, standby._AWAKE] == 0


def test_a_forked_process_has_threads_of_its_own():
    eventually(lambda: is_shared(2))
    with multiprocessing.get_context("fork").Pool(1) as pool:
        pool.apply_async(eventually_shared, (2,)).get(timeout=120)


def eventually_shared(threads: int) -> None:
    eventually(lambda: is_shared(threads))
