"""Threads that step a batch: they change no result, take each part once, are waited for, and get in nobody's way."""

import copy
import multiprocessing
import os
import time
from concurrent.futures import ThreadPoolExecutor
from threading import Event, Thread
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from agents.policy.bundle import POLICIES, load_controller
from beltarm_env import BeltArmVectorEnv
from beltarm_env.engine import blocks, compiled, in_threads, threads
from beltarm_env.engine.blocks import none_taken, take_block
from beltarm_env.engine.threads import each_in_threads, in_python_threads
from beltarm_env.engine.words import Integers
from beltarm_env.rollout import rollout

ARMS = 700  # six blocks


@pytest.fixture(autouse=True)
def eager(monkeypatch: pytest.MonkeyPatch):
    """However few the blocks, all threads are used."""
    for least in ("LEAST_BLOCKS", "LEAST_SELDOM_BLOCKS", "LEAST_REAL_BLOCKS"):
        monkeypatch.setattr(blocks, least, 1)


def played(env: BeltArmVectorEnv, steps: int = 40) -> bytes:
    """All that an environment returns under torques that drive some arms out of the workspace."""
    rng = np.random.default_rng(0)
    returned = [env.reset(seed=0)[0].tobytes()]
    ended, torques = 0, np.sign(rng.uniform(-1, 1, (env.num_envs, 1))).astype(np.float32)
    for _ in range(steps):
        torques[rng.integers(env.num_envs // 2, size=99)] *= np.float32(-0.7)  # the others leave the workspace
        observations, rewards, terminated, truncated, info = env.step(torques)
        ended += int(terminated.sum())
        returned += [array.tobytes() for array in (observations, rewards, terminated, truncated, *info.values())]
    assert ended > 0 or steps < 100, "episodes end and begin"
    return b"".join([*returned, env.state.tobytes()])


class TestResults:
    @pytest.mark.parametrize("randomization", ["ideal", "train"])
    def test_their_number_changes_no_result(self, randomization: Any):
        threads = (1, 2, 16)  # more than there are cores, and than blocks
        envs = [BeltArmVectorEnv(ARMS, randomization=randomization, num_threads=number) for number in threads]
        assert len({played(env, 200) for env in envs}) == 1

    def test_environments_step_at_the_same_time_in_threads_of_the_caller(self):
        alone = played(BeltArmVectorEnv(ARMS))
        with ThreadPoolExecutor(4) as pool:
            envs = [BeltArmVectorEnv(ARMS, num_threads=3) for _ in range(4)]
            assert list(pool.map(played, envs)) == [alone] * 4

    def test_a_copy_and_a_forked_process_go_on(self):
        env = BeltArmVectorEnv(ARMS, num_threads=2)
        alone = played(env)
        assert played(copy.deepcopy(env)) == alone
        with multiprocessing.get_context("fork").Pool(1) as pool:
            assert pool.apply_async(played, (env,)).get(timeout=60) == alone

    def test_a_policy_drives_arms_the_same_whatever_their_number(self, monkeypatch: pytest.MonkeyPatch):
        states = []
        for number in ("1", "3"):
            monkeypatch.setenv("OMP_NUM_THREADS", number)
            controller = load_controller(POLICIES / "student" / "seed0")
            states.append(rollout(controller, 140, seed=3, randomization="train").state.tobytes())
        assert states[0] == states[1]


def test_what_tells_no_number_is_a_thread_for_each_core(monkeypatch: pytest.MonkeyPatch):
    for word in ("", "0", "-2", "many"):
        monkeypatch.setenv("OMP_NUM_THREADS", word)
        assert 1 <= blocks.usual_threads() <= min(os.cpu_count() or 1, blocks.MAX_THREADS)
    monkeypatch.setenv("OMP_NUM_THREADS", "9999")
    assert [blocks.usual_threads(most) for most in (0, 1, 3, 9999)] == [1, 1, 3, blocks.MAX_THREADS]


@compiled
def mark_blocks(thread: int, taken: Integers, marks: Integers) -> None:
    """Take blocks until none is left, and note by whom."""
    for _ in range(len(marks) + 1):
        block = take_block(taken, thread, len(marks))
        if block < 0:
            return
        marks[block] += 1 + 1000 * thread


class TestBlocks:
    @pytest.mark.parametrize("threads", [1, 2, 5])
    @pytest.mark.parametrize("count", [0, 1, 7, 4000])
    def test_each_is_taken_once(self, threads: int, count: int):
        marks = np.zeros(count, np.int64)
        in_threads(mark_blocks, threads, none_taken(threads), marks)
        assert (marks % 1000 == 1).all() and (marks // 1000 < threads).all()

    def test_a_thread_takes_its_own_in_their_order_and_then_what_is_left_of_others(self):
        taken = none_taken(2)
        assert [take_block(taken, 1, 6) for _ in range(4)] == [3, 4, 5, 2]
        assert [take_block(taken, 0, 6) for _ in range(3)] == [0, 1, -1] and take_block(taken, 1, 6) == -1


class TestPythonThreads:
    def test_what_another_thread_raises_is_raised_here_once_all_are_done(self):
        begun, done = Event(), list[int]()

        def work(thread: int) -> None:
            if thread == 0:
                assert begun.wait(60)
                raise KeyError("of this thread")
            begun.set()
            time.sleep(0.05)
            done.append(thread)
            raise ValueError(f"of thread {thread}")

        with pytest.raises(KeyError, match="of this thread"):
            in_python_threads(work, 2)
        assert done == [1], "nobody works on while the caller goes on"
        begun.clear()
        with pytest.raises(ValueError, match="of thread 1"):
            in_python_threads(lambda thread: work(thread) if thread else begun.wait(60), 2)

    def test_where_the_system_allows_no_thread_the_caller_does_all(self, monkeypatch: pytest.MonkeyPatch):
        monkeypatch.setattr(threads, "_executor", lambda _: ThreadPoolExecutor(2))
        monkeypatch.setattr(Thread, "start", Mock(side_effect=RuntimeError("can't start new thread")))  # as Python says
        done: list[int] = []
        in_python_threads(done.append, 3)
        assert done == [0]

    def test_each_item_is_worked_on_once(self, monkeypatch: pytest.MonkeyPatch):
        monkeypatch.setenv("OMP_NUM_THREADS", "4")
        for count in (0, 1, 500):
            done: list[int] = []
            each_in_threads(done.append, range(count))
            assert sorted(done) == list(range(count))
        with pytest.raises(ZeroDivisionError):
            each_in_threads(lambda item: 1 // item, [3, 2, 1, 0])
