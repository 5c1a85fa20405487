"""Threads that stand by for kernels: they take each part once, are waited for, and go to sleep."""

import multiprocessing
import os
import time
from concurrent.futures import ThreadPoolExecutor
from threading import Thread

import numpy as np
import pytest
from numpy.typing import NDArray

from beltarm_env.jit import compiled
from beltarm_env.threads import standby
from beltarm_env.threads.blocks import none_taken, take_block
from beltarm_env.threads.standby import share, standing_by

PARTS = 50
Integers = NDArray[np.int64]


@compiled
def work(thread: int, taken: Integers, parts: tuple[Integers, Integers], rounds: int) -> None:
    """Add up numbers in each part that is taken, and note by whom."""
    sums, by_whom = parts
    while True:
        k = take_block(taken, thread, len(sums))
        if k < 0:
            break
        for number in range(rounds):
            sums[k] += number
        by_whom[k] = thread


@compiled
def shared_work(taken: Integers, boxes: Integers, sums: Integers, by_whom: Integers, rounds: int) -> None:
    share(work, (taken, (sums, by_whom), rounds), taken, boxes)


def done(threads: int, rounds: int = 100, calls: int = 1) -> Integers:
    """Share work some times, and return which thread took each part of the last."""
    by_whom = np.empty(0, np.int64)
    for _ in range(calls):
        sums, by_whom = np.zeros(PARTS, np.int64), np.full(PARTS, -1)
        shared_work(none_taken(threads), standing_by(threads), sums, by_whom, rounds)
        assert (sums == rounds * (rounds - 1) // 2).all(), "each part once, and all of them"
        assert ((by_whom >= 0) & (by_whom < threads)).all()
    return by_whom


@pytest.mark.parametrize("threads", [1, 2, 3, 16])
def test_each_part_is_done_once(threads: int):
    done(threads, calls=300)


def test_other_threads_take_their_share():
    deadline = time.monotonic() + 60
    while not done(2, rounds=100_000).any():
        assert time.monotonic() < deadline
    assert standby._boxes(os.getpid())[1, standby._OFFER] == standby._NONE, "and nothing is left with them"


def test_several_callers_at_a_time():
    with ThreadPoolExecutor(4) as pool:
        for future in [pool.submit(done, 3, 1000, 200) for _ in range(4)]:
            future.result()


def test_a_thread_that_works_for_another_caller_is_not_waited_for():
    busy = np.zeros((1, standby._WORDS), np.int64)
    busy[0, standby._OFFER] = standby._TAKEN
    sums, by_whom = np.zeros(PARTS, np.int64), np.full(PARTS, -1)
    shared_work(none_taken(2), busy, sums, by_whom, 2)
    assert by_whom.tolist() == [0] * PARTS and busy[0, standby._OFFER] == standby._TAKEN


def test_an_offer_that_no_thread_takes_is_withdrawn():
    asleep = np.zeros((1, standby._WORDS), np.int64)
    sums, by_whom = np.zeros(PARTS, np.int64), np.full(PARTS, -1)
    shared_work(none_taken(2), asleep, sums, by_whom, 2)
    assert by_whom.tolist() == [0] * PARTS and asleep[0, standby._OFFER] == standby._NONE


def test_they_sleep_when_no_call_comes():
    done(3)
    deadline = time.monotonic() + 60
    while standby._boxes(os.getpid())[1:3, standby._AWAKE].any():
        assert time.monotonic() < deadline
        time.sleep(0.001)
    done(3)


def test_none_is_within_a_kernel_once_python_ends():
    """Where it would run on while its code is taken away."""
    boxes = np.zeros((2, standby._WORDS), np.int64)
    boxes[1, standby._AWAKE] = 1
    thread = Thread(target=standby._serve, args=(boxes[1], 1, 1 << 60), daemon=True)
    thread.start()
    thread.join(0.05)
    assert thread.is_alive()
    standby._dismiss(os.getpid(), boxes)
    assert boxes[1, standby._AWAKE] == 0
    thread.join(60)
    assert not thread.is_alive()


def test_a_forked_process_has_threads_of_its_own():
    done(2, calls=20)
    with multiprocessing.get_context("fork").Pool(1) as pool:
        assert pool.apply_async(done, (2, 1000, 50)).get(timeout=60).shape == (PARTS,)
