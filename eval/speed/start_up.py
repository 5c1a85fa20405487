"""Seconds until the first step and memory of a large batch, each in a process of its own."""

from __future__ import annotations

import sys
import tempfile

from eval.speed.timing import Row, numbers

_MOST_STARTS = 3
_MANY = 100_000
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


def start_up_rows(repetitions: int) -> list[Row]:
    """Time of the import, and of the first step with a warm and a cold cache of kernels."""
    starts = min(repetitions, _MOST_STARTS)
    with tempfile.TemporaryDirectory() as folder:
        _, cold = numbers(_FIRST_STEP, NUMBA_CACHE_DIR=folder)
        warm = [numbers(_FIRST_STEP, NUMBA_CACHE_DIR=folder) for _ in range(starts)]
    imported, first = (min(times) for times in zip(*warm, strict=True))
    numba = min(numbers(_EMPTY_FUNCTION)[0] for _ in range(starts))
    peer = f"numba, empty function: {numba:.2f} s"
    return [
        Row("import beltarm_env", f"{imported:.2f} s"),
        Row("make, reset, first step: warm cache", f"{first:.2f} s", peer, f"{numba / first:.2f}x"),
        Row("make, reset, first step: cold cache", f"{cold:.1f} s", peer, f"{numba / cold:.2f}x"),
    ]


def memory_rows() -> list[Row]:
    """Most memory that a batch of arms ever has, made, reset and stepped, beside as many CartPoles; on Linux."""
    if sys.platform != "linux":
        return []
    arms, carts = (max(numbers(_MEMORY, name, str(_MANY))) for name in ("BeltArm-v0", "CartPole-v1"))
    peer = f"CartPole-v1: {carts:.0f} MB"
    return [Row(f"memory of a batch, N = {_MANY}", f"{arms:.0f} MB", peer, f"{carts / arms:.2f}x")]
