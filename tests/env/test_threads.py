"""Threads that step a batch: they change no result, take each part once, are waited for, and get in nobody's way."""

import copy
import multiprocessing
import os
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Event, Thread

import numpy as np
import pytest

from agents.policy.bundle import load_controller
from beltarm_env import BeltArmVectorEnv
from beltarm_env.jit import PLAIN
from beltarm_env.rollout import rollout
from beltarm_env.threads import blocks, calls, standby
from beltarm_env.threads.blocks import none_taken, take_block

ARMS = 700  # six blocks
POLICIES = Path(__file__).resolve().parents[2] / "agents" / "policies"


@pytest.fixture(autouse=True)
def eager(monkeypatch: pytest.MonkeyPatch):
    """However few the blocks, all threads are used."""
    for least in ("LEAST_BLOCKS", "LEAST_SELDOM_BLOCKS", "LEAST_BUILT_BLOCKS"):
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
    def test_their_number_changes_no_result(self, randomization: str):
        def env(number: int) -> BeltArmVectorEnv:
            return BeltArmVectorEnv(ARMS, randomization=randomization, num_threads=number)  # pyright: ignore[reportArgumentType]

        alone = played(env(1), 200)
        for number in (2, 16):  # more than there are cores, and than blocks
            assert played(env(number), 200) == alone

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

    def test_where_the_system_allows_no_thread_the_numbers_are_the_same(self, monkeypatch: pytest.MonkeyPatch):
        def states() -> bytes:
            controller = load_controller(POLICIES / "student" / "seed0")
            return rollout(controller, 30, seed=3, randomization="train").state.tobytes()

        def refuse(_: Thread) -> None:
            raise RuntimeError("can't start new thread")  # what Python says

        monkeypatch.setenv("OMP_NUM_THREADS", "1")
        before = played(BeltArmVectorEnv(ARMS, num_threads=3)), states()
        monkeypatch.setenv("OMP_NUM_THREADS", "3")
        assert states() == before[1], "a policy drives arms the same whatever their number"
        monkeypatch.setattr(os, "getpid", lambda: 0)  # a process that has no threads yet
        monkeypatch.setattr(Thread, "start", refuse)
        assert (played(BeltArmVectorEnv(ARMS, num_threads=3)), states()) == before
        assert PLAIN or standby._bell(0, 1) is None, "none was begun"


def test_what_tells_no_number_is_a_thread_for_each_core(monkeypatch: pytest.MonkeyPatch):
    for word in ("", "0", "-2", "many"):
        monkeypatch.setenv("OMP_NUM_THREADS", word)
        assert 1 <= blocks.usual_threads() <= min(os.cpu_count() or 1, blocks.MAX_THREADS)
    monkeypatch.setenv("OMP_NUM_THREADS", "9999")
    assert [blocks.usual_threads(most) for most in (0, 1, 3, 9999)] == [1, 1, 3, blocks.MAX_THREADS]


class TestCalls:
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
            calls.in_threads(work, 2)
        assert done == [1], "nobody works on while the caller goes on"
        begun.clear()
        with pytest.raises(ValueError, match="of thread 1"):
            calls.in_threads(lambda thread: work(thread) if thread else begun.wait(60), 2)

    def test_a_thread_that_is_late_finds_nothing_left(self):
        begun, over, done = Event(), Event(), list[int]()

        def occupy(thread: int) -> None:
            if thread:
                begun.set()
            (over if thread else begun).wait(60)

        with ThreadPoolExecutor(1) as pool:
            occupied = pool.submit(calls.in_threads, occupy, 2)
            assert begun.wait(60)
            calls.in_threads(done.append, 2)
            over.set()
            occupied.result()
        calls.in_threads(lambda thread: over.wait(60), 2)
        assert done == [0], "its share is not waited for, and not begun later"

    def test_a_thread_is_waited_for_while_it_has_a_block(self):
        begun, done, taken = Event(), list[int](), none_taken(2)

        def work(thread: int) -> None:
            if thread == 0:
                assert begun.wait(60)
                return
            taken[2 + thread] = 1
            begun.set()
            time.sleep(0.1)
            taken[2 + thread] = 0
            done.append(thread)

        calls.share_blocks(work, taken)
        assert done == [1]

    def test_each_item_is_worked_on_once(self, monkeypatch: pytest.MonkeyPatch):
        monkeypatch.setenv("OMP_NUM_THREADS", "4")
        for count in (0, 1, 500):
            done: list[int] = []
            calls.each_in_threads(done.append, range(count))
            assert sorted(done) == list(range(count))
        with pytest.raises(ZeroDivisionError):
            calls.each_in_threads(lambda item: 1 // item, [3, 2, 1, 0])


@pytest.mark.skipif(PLAIN, reason="kernels that are not compiled have one thread")
class TestStandby:
    def test_a_kernel_waits_a_little_and_not_for_ever(self):
        taken = none_taken(2)
        taken[3] = 1  # a thread that another program keeps from its core
        places = [take_block(taken, 0, 5) for _ in range(6)]
        assert sorted(places) == [-1, 0, 1, 2, 3, 4] and places[-1] == -1
        assert taken[2:].tolist() == [0, 1, 0, 0]
        assert take_block(taken, 1, 5) == -1 and taken[2:].tolist() == [0, 0, 0, 0]

    def test_they_sleep_when_no_call_comes_and_are_woken_again(self):
        env, box = BeltArmVectorEnv(ARMS, num_threads=2), standby._boxes(os.getpid())[1]
        env.reset(seed=0)
        for _ in range(3):
            played(env, 5)
            deadline = time.monotonic() + 60
            while box[standby._AWAKE] or box[standby._OFFER] != standby._NONE:
                assert time.monotonic() < deadline
                time.sleep(1e-4)
            assert len(standby.standing_by(2)) == 1 and box[standby._AWAKE]

    def test_none_is_within_a_kernel_once_python_ends(self):
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
