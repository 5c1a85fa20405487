"""Steps per second of the environments and of whole episodes, start-up and memory, beside Gymnasium's CartPole-v1."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any
from unittest.mock import patch

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

_PEER = "CartPole-v1"
_DRIVE = ", all effects of the drive"
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
numba.njit(lambda x: x)(1.0)
print(time.perf_counter() - began)
"""
_MEMORY = """
import pathlib, re, sys, gymnasium, beltarm_env
most = []
for arms in (100, int(sys.argv[2])):
    env = gymnasium.make_vec(sys.argv[1], num_envs=arms, vectorization_mode="vector_entry_point")
    env.action_space.seed(0)
    env.reset(seed=0)
    for _ in range(3):
        env.step(env.action_space.sample())
    most.append(int(re.search(r"VmHWM:\\s*(\\d+)", pathlib.Path("/proc/self/status").read_text())[1]) / 1000)
print(most[1] - most[0])
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
        f"vector step{_DRIVE}": make(randomization="train"),
        "vector step of the full arm": make(randomization="ideal", model="lagrangian"),
    }
    episodes = {
        "episodes of the paper's controller": _episodes(arms, "ideal"),
        f"episodes of the paper's controller{_DRIVE}": _episodes(arms, "train"),
    }
    cart, rows = batch_steps(_PEER, arms, steps), []
    for runs, each, count in ((stepped, steps, repetitions), (episodes, EPISODE_STEPS, max(repetitions // 5, 1))):
        *times, carts = times_in_turns([*runs.values(), cart], count).T
        for name, times_of_run in zip(runs, times, strict=True):
            rows.append(speed(f"{name}, N = {arms}", arms * each, times_of_run, _PEER, arms * steps, carts))
    return rows


def threads_row(arms: int, steps: int, repetitions: int, randomization: Randomization) -> Row:
    """Speed of the vector environment with as many threads as cores, beside one thread."""
    cores = cpu_count()
    make = partial(batch_steps, "BeltArm-v0", arms, steps, randomization=randomization)
    alone, together = times_in_turns([make(num_threads=1), make(num_threads=cores)], repetitions).T
    what = f"vector step{'' if randomization == 'ideal' else _DRIVE}, {cores} threads, N = {arms}"
    return speed(what, arms * steps, together, "1 thread", arms * steps, alone)


def single_row(steps: int, repetitions: int) -> Row:
    """Speed of a single environment through `make`; episodes are restarted as they end."""
    count = _PER_SINGLE_ARM * steps

    def run(env: gym.Env, actions: list[Any]) -> None:
        for step in range(count):
            _, _, terminated, truncated, _ = env.step(actions[step % len(actions)])
            if terminated or truncated:
                env.reset()

    runs = []
    for name in ("BeltArm-v0", _PEER):
        env = gym.make(name)
        runs.append(partial(run, env, _actions(env)))
    arm, cart = times_in_turns(runs, repetitions).T
    return speed("single step through make", count, arm, _PEER, count, cart)


def rollout_rows(repetitions: int) -> list[Row]:
    """Speed of whole episodes by `rollout`, controllers included: beside the paper's controller, and on one core."""
    student = load_controller(POLICIES / "student" / "seed0")
    controllers = {"adaptive": AdaptiveController(), "student, seed 0": student, "paper": PaperController()}
    settings: dict[str, Any] = {"seed": 0, "randomization": "train"}
    runs = [partial(rollout, controller, _ROLLED_OUT, **settings) for controller in controllers.values()]
    in_one_thread = patch.dict(os.environ, OMP_NUM_THREADS="1")(lambda: runs[0]())
    *times, paper, alone = times_in_turns([*runs, in_one_thread], max(repetitions // 5, 1)).T
    steps, end = _ROLLED_OUT * EPISODE_STEPS, f", N = {_ROLLED_OUT}"
    rows = [
        speed(f"rollout, {name}{end}", steps, times_of_run, "paper", steps, paper)
        for name, times_of_run in zip(controllers, times, strict=False)
    ]
    what = f"rollout, adaptive, {usual_threads()} threads{end}"
    return [*rows, speed(what, steps, times[0], "1 thread", steps, alone)]


def batch_steps(name: str, arms: int, steps: int, **settings: Any) -> Callable[[], None]:
    """Steps of a vector environment under random actions."""
    env = gym.make_vec(name, num_envs=arms, vectorization_mode="vector_entry_point", **settings)
    actions = _actions(env)
    return partial(_step, env, [actions[step % len(actions)] for step in range(steps)])


def _step(env: Any, actions: Iterable[Any]) -> None:
    for action in actions:
        env.step(action)


def _actions(env: Any) -> list[Any]:
    """Reset an environment, and draw 16 actions."""
    env.action_space.seed(0)
    env.reset(seed=0)
    return [env.action_space.sample() for _ in range(16)]


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
        _step(env, torques)

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
    arms, carts = (max(numbers(_MEMORY, name, str(_MANY))) for name in ("BeltArm-v0", _PEER))
    return [Row(f"memory of a batch, N = {_MANY}", arms, "MB", _PEER, carts, (carts / arms,))]
