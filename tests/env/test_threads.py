"""Threads that step a batch: they change no result, and get in nobody's way."""

import copy
import multiprocessing
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Event

import numpy as np
import pytest
from numpy.typing import NDArray

from agents.policy.bundle import load_controller
from baselines import CONTROLLERS
from beltarm_env import BeltArmVectorEnv
from beltarm_env.jit import compiled
from beltarm_env.rollout import rollout
from beltarm_env.threads import blocks, calls

ARMS = 700  # six blocks
STEPS = 40
POLICIES = Path(__file__).resolve().parents[2] / "agents" / "policies"


@pytest.fixture(autouse=True)
def eager(monkeypatch: pytest.MonkeyPatch):
    """However few the blocks, all threads are used."""
    monkeypatch.setattr(blocks, "LEAST_BLOCKS", 1)
    monkeypatch.setattr(blocks, "LEAST_SELDOM_BLOCKS", 1)
    monkeypatch.setattr(blocks, "LEAST_BUILT_BLOCKS", 1)


def played(env: BeltArmVectorEnv, steps: int = STEPS) -> bytes:
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


@pytest.mark.parametrize("randomization", ["ideal", "train"])
def test_their_number_changes_no_result(randomization: str):
    alone = played(BeltArmVectorEnv(ARMS, randomization=randomization), 300)  # pyright: ignore[reportArgumentType]
    for number in (2, 3, 16):  # more than there are cores, and than blocks
        env = BeltArmVectorEnv(ARMS, randomization=randomization, num_threads=number)  # pyright: ignore[reportArgumentType]
        assert played(env, 300) == alone


def test_environments_step_at_the_same_time_in_threads_of_the_caller():
    alone = played(BeltArmVectorEnv(ARMS))
    with ThreadPoolExecutor(4) as pool:
        envs = [BeltArmVectorEnv(ARMS, num_threads=3) for _ in range(4)]
        assert list(pool.map(played, envs)) == [alone] * 4


def test_a_copy_and_a_forked_process_go_on():
    env = BeltArmVectorEnv(ARMS, num_threads=2)
    alone = played(env)
    assert played(copy.deepcopy(env)) == alone
    with multiprocessing.get_context("fork").Pool(1) as pool:
        assert pool.apply_async(played, (env,)).get(timeout=60) == alone


def test_what_another_thread_raises_is_raised_here_once_all_are_done():
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
    calls.in_threads(lambda thread: done.append(thread), 1)
    assert done == [1, 1, 0]


def test_a_thread_that_is_late_finds_nothing_left():
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


@pytest.mark.parametrize("at_work", [True, False])
def test_a_thread_is_waited_for_while_it_has_a_block(at_work: bool):
    begun, over, done, taken = Event(), Event(), list[int](), blocks.none_taken(2)

    def work(thread: int) -> None:
        if thread == 0:
            assert begun.wait(60)
            return
        taken[2 + thread] = at_work
        begun.set()
        over.wait(0.1 if at_work else 60)
        taken[2 + thread] = 0
        done.append(thread)

    calls.share_blocks(work, taken)
    assert done == ([1] if at_work else []), "once its blocks are done it may be anywhere"
    over.set()
    calls.in_threads(lambda thread: None if thread else begun.wait(60), 2)


def test_a_kernel_waits_a_little_and_not_for_ever():
    taken = blocks.none_taken(2)
    taken[3] = 1  # a thread that another program keeps from its core
    found = [take(taken, 0, 5) for _ in range(6)]
    assert sorted(found) == [-1, 0, 1, 2, 3, 4] and found[-1] == -1
    assert taken[2:].tolist() == [0, 1, 0, 0]
    assert take(taken, 1, 5) == -1 and taken[2:].tolist() == [0, 0, 0, 0]


@compiled
def take(taken: NDArray[np.int64], thread: int, count: int) -> int:
    return blocks.take_block(taken, thread, count)


def test_small_batches_use_fewer(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.undo()
    assert [blocks.threads_for(count, False, False, 4) for count in (1, 15, 16, 24, 1000)] == [1, 1, 2, 3, 4]
    assert [blocks.threads_for(count, False, True, 4) for count in (1, 59, 60, 90, 1000)] == [1, 1, 2, 3, 4]
    assert [blocks.threads_for(count, True, True, 2) for count in (1, 3, 4, 30)] == [1, 1, 2, 2]


@pytest.mark.parametrize("number", [0, 257, 1.5, True, "2"])
def test_what_is_no_number_of_threads_is_refused(number: object):
    with pytest.raises(ValueError, match=r"num_threads must be a whole number from 1 to 256, got "):
        BeltArmVectorEnv(4, num_threads=number)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("name", ["adaptive", "student"])
def test_controllers_drive_arms_the_same_whatever_their_number(name: str, monkeypatch: pytest.MonkeyPatch):
    driven: list[bytes] = []
    for number in (1, 3):
        monkeypatch.setenv("OMP_NUM_THREADS", str(number))
        assert blocks.usual_threads() == number
        controller = CONTROLLERS[name]() if name in CONTROLLERS else load_controller(POLICIES / name / "seed0")
        driven.append(rollout(controller, 100, seed=3, randomization="train").state.tobytes())
    assert driven[0] == driven[1]


def test_each_item_is_worked_on_once(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "4")
    for count in (0, 1, 500):
        done: list[int] = []
        calls.each_in_threads(done.append, range(count))
        assert sorted(done) == list(range(count))
    with pytest.raises(ZeroDivisionError):
        calls.each_in_threads(lambda item: 1 // item, [3, 2, 1, 0])


@pytest.mark.parametrize("told", ["", "0", "-2", "many"])
def test_what_tells_no_number_is_a_thread_for_each_core(told: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("OMP_NUM_THREADS", told)
    assert 1 <= blocks.usual_threads() <= min(os.cpu_count() or 1, blocks.MAX_THREADS)
    monkeypatch.setenv("OMP_NUM_THREADS", "9999")
    assert blocks.usual_threads() == blocks.MAX_THREADS
    assert [blocks.usual_threads(most) for most in (0, 1, 3, 9999)] == [1, 1, 3, blocks.MAX_THREADS]


NO_THREADS = """
import sys, threading
import numpy as np
from baselines import CONTROLLERS
from beltarm_env import BeltArmVectorEnv
from beltarm_env.rollout import rollout

def refuse(self):
    raise RuntimeError("can't start new thread")  # what Python says where the system allows none

if "refused" in sys.argv:
    threading.Thread.start = refuse
env = BeltArmVectorEnv(4096, num_threads=3)
env.reset(seed=1)
for _ in range(5):
    rewards = env.step(np.full((4096, 1), 0.3))[1]
costs = rollout(CONTROLLERS["adaptive"](), 40, seed=3).metrics()["cost"]
print(rewards.sum().hex(), np.sum(costs).hex())
"""


def test_where_the_system_allows_no_thread_the_numbers_are_the_same():
    said = [
        subprocess.run(
            [sys.executable, "-c", NO_THREADS, word],
            env={**os.environ, "OMP_NUM_THREADS": "3"},
            capture_output=True,
            text=True,
            check=True,
            timeout=300,
        ).stdout
        for word in ("allowed", "refused")
    ]
    assert said[0] == said[1]
