"""Steps per second of the environments and of whole episodes, start-up and memory, beside Gymnasium's CartPole-v1."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import gymnasium as gym
from joblib import cpu_count

from agents.policy.bundle import POLICIES, load_controller
from baselines.optimal.adaptive import AdaptiveController
from baselines.servo.paper import PaperController
from beltarm_env import EPISODE_STEPS, BeltArmVectorEnv
from beltarm_env.rollout import rollout
from beltarm_env.task.ranges import Randomization
from beltarm_env.threads.blocks import usual_threads
from eval.speed.timing import Row, numbers, speed, times_in_turns

_PER_SINGLE_ARM = 100  # steps of a single arm for one of a batch
_ROLLED_OUT = 1024  # arms
_MOST_STARTS = 3
_MANY = 100_000  # arms whose memory is measured
_FIRST_STEP = """
import time
began = time.perf_counter()
import beltarm_env
imported = time.perf_counter()
import gymnasium, numpy
env = gymnasium.make("BeltArm-v0")
env.reset(seed=0)
env.step(numpy.zeros(1, numpy.float32))
print(imported - began, time.perf_counter() - imported)
"""
_EMPTY_FUNCTION = """
import time
began = time.perf_counter()
import numba

@numba.njit
def nothing(x):
    return x

nothing(1.0)
print(time.perf_counter() - began)
"""
_MEMORY = """
import sys, gymnasium, beltarm_env

def most():
    with open("/proc/self/status") as status:
        return next(int(line.split()[1]) for line in status if line.startswith("VmHWM")) / 1000

def stepped(arms):
    env = gymnasium.make_vec(sys.argv[1], num_envs=arms, vectorization_mode="vector_entry_point")
    env.action_space.seed(0)
    env.reset(seed=0)
    for _ in range(3):
        env.step(env.action_space.sample())

stepped(100)
before = most()
stepped(int(sys.argv[2]))
print(most() - before)
"""


def batch_rows(arms: int, steps: int, repetitions: int) -> list[Row]:
    """Speed of the vector environment beside CartPole's, on one core and on all.

    Random torques over the whole limit keep the motor slow, where steps are short, which no controller does: so drives
    are also timed over whole episodes of the paper's controller, its torques recorded before.
    """
    cores = cpu_count()
    make = partial(batch_steps, "BeltArm-v0", arms, steps)
    stepped = {
        "vector step": make(randomization="ideal"),
        f"vector step, {cores} threads": make(randomization="ideal", num_threads=cores),
        "vector step, all effects of the drive": make(randomization="train"),
        "vector step of the full arm": make(randomization="ideal", model="lagrangian"),
    }
    episodes = {
        "episodes of the paper's controller": _episodes(arms, "ideal"),
        "episodes of the paper's controller, all effects of the drive": _episodes(arms, "train"),
    }
    cart, rows = batch_steps("CartPole-v1", arms, steps), []
    for runs, each, count in ((stepped, steps, repetitions), (episodes, EPISODE_STEPS, max(repetitions // 5, 1))):
        *times, carts = times_in_turns([*runs.values(), cart], count).T
        for name, times_of_run in zip(runs, times, strict=True):
            what = f"{name}, N = {arms}"
            rows.append(speed(what, arms * each, times_of_run, "CartPole-v1", arms * steps, carts))
    return rows


def threads_row(arms: int, steps: int, repetitions: int, randomization: Randomization) -> Row:
    """Speed of the vector environment with as many threads as cores, beside one thread."""
    cores = cpu_count()
    make = partial(batch_steps, "BeltArm-v0", arms, steps, randomization=randomization)
    alone, together = times_in_turns([make(num_threads=1), make(num_threads=cores)], repetitions).T
    drives = "" if randomization == "ideal" else ", all effects of the drive"
    what = f"vector step{drives}, {cores} threads, N = {arms}"
    return speed(what, arms * steps, together, "1 thread", arms * steps, alone)


def single_row(steps: int, repetitions: int) -> Row:
    """Speed of a single environment through `make`."""
    count = _PER_SINGLE_ARM * steps
    arm, cart = times_in_turns([_single_steps(name, count) for name in ("BeltArm-v0", "CartPole-v1")], repetitions).T
    return speed("single step through make", count, arm, "CartPole-v1", count, cart)


def rollout_rows(repetitions: int) -> list[Row]:
    """Speed of whole episodes by `rollout`, controllers included: beside the paper's controller, and on one core."""
    student = load_controller(POLICIES / "student" / "seed0")
    controllers = {"adaptive": AdaptiveController(), "student, seed 0": student, "paper": PaperController()}
    settings: dict[str, Any] = {"seed": 0, "randomization": "train"}
    runs = [partial(rollout, controller, _ROLLED_OUT, **settings) for controller in controllers.values()]

    def in_one_thread() -> None:
        with _one_thread():
            runs[0]()

    *times, paper, alone = times_in_turns([*runs, in_one_thread], max(repetitions // 5, 1)).T
    steps, end = _ROLLED_OUT * EPISODE_STEPS, f", N = {_ROLLED_OUT}"
    rows = [
        speed(f"rollout, {name}{end}", steps, times_of_run, "paper", steps, paper)
        for name, times_of_run in zip(controllers, times, strict=False)
    ]
    what = f"rollout, adaptive, {usual_threads()} threads{end}"
    return [*rows, speed(what, steps, times[0], "1 thread", steps, alone)]


@contextmanager
def _one_thread() -> Iterator[None]:
    """Let controllers use one thread."""
    before = os.environ.get("OMP_NUM_THREADS")
    os.environ["OMP_NUM_THREADS"] = "1"
    try:
        yield
    finally:
        os.environ.pop("OMP_NUM_THREADS")
        if before is not None:
            os.environ["OMP_NUM_THREADS"] = before


def batch_steps(name: str, arms: int, steps: int, **settings: Any) -> Callable[[], None]:
    """Steps of a vector environment under random actions."""
    env = gym.make_vec(name, num_envs=arms, vectorization_mode="vector_entry_point", **settings)
    env.action_space.seed(0)
    env.reset(seed=0)
    actions = [env.action_space.sample() for _ in range(16)]

    def run() -> None:
        for step in range(steps):
            env.step(actions[step % 16])

    return run


def _episodes(arms: int, randomization: Randomization) -> Callable[[], None]:
    """One episode of each arm under the torques that the paper's controller commanded in it."""
    env = BeltArmVectorEnv(arms, randomization=randomization)
    controller, memory, torques = PaperController(), None, []
    observations, _ = env.reset(seed=0)
    for _ in range(EPISODE_STEPS):
        torque, memory = controller.predict(observations, memory)
        torques.append(torque)
        observations, *_ = env.step(torque)

    def run() -> None:
        env.reset(seed=0)
        for torque in torques:
            env.step(torque)

    return run


def _single_steps(name: str, steps: int) -> Callable[[], None]:
    """Steps of one environment under random actions, episodes restarted as they end."""
    env = gym.make(name)
    env.action_space.seed(0)
    env.reset(seed=0)
    actions = [env.action_space.sample() for _ in range(16)]

    def run() -> None:
        for step in range(steps):
            _, _, terminated, truncated, _ = env.step(actions[step % 16])
            if terminated or truncated:
                env.reset()

    return run


def start_up_rows(repetitions: int) -> list[Row]:
    """Time of the import, and of the first step with a warm and a cold cache of kernels."""
    starts = min(repetitions, _MOST_STARTS)
    with tempfile.TemporaryDirectory() as folder:
        _, cold = numbers(_FIRST_STEP, NUMBA_CACHE_DIR=folder)
        warm = [numbers(_FIRST_STEP, NUMBA_CACHE_DIR=folder) for _ in range(starts)]
    imported, first = (min(times) for times in zip(*warm, strict=True))
    numba, peer = min(numbers(_EMPTY_FUNCTION)[0] for _ in range(starts)), "numba, empty function"
    return [
        Row("import beltarm_env", imported, "s"),
        Row("make, reset, first step: warm cache", first, "s", peer, numba, (numba / first,)),
        Row("make, reset, first step: cold cache", cold, "s", peer, numba, (numba / cold,)),
    ]


def memory_rows() -> list[Row]:
    """Most memory that a batch of arms ever has, made, reset and stepped, beside as many CartPoles; on Linux."""
    if sys.platform != "linux":
        return []
    arms, carts = (max(numbers(_MEMORY, name, str(_MANY))) for name in ("BeltArm-v0", "CartPole-v1"))
    return [Row(f"memory of a batch, N = {_MANY}", arms, "MB", "CartPole-v1", carts, (carts / arms,))]
