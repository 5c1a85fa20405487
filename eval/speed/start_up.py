"""Seconds until the first step, in a process of its own, beside numba's own start-up."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from eval.speed.stepping import Row

ROOT = Path(__file__).resolve().parents[2]
_MOST_STARTS = 3
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


def start_up_rows(repetitions: int) -> list[Row]:
    """Time of the import, and of the first step with a warm and a cold cache of kernels."""
    starts = min(repetitions, _MOST_STARTS)
    with tempfile.TemporaryDirectory() as folder:
        _, cold = _start_up(Path(folder))
        warm = [_start_up(Path(folder)) for _ in range(starts)]
    imported, first = (min(times) for times in zip(*warm, strict=True))
    numba = min(_numbers(_EMPTY_FUNCTION)[0] for _ in range(starts))
    peer = f"numba, empty function: {numba:.2f} s"
    return [
        ("import beltarm_env", f"{imported:.2f} s", "-", "-"),
        ("make, reset, first step: warm cache", f"{first:.2f} s", peer, f"{numba / first:.2f}x"),
        ("make, reset, first step: cold cache", f"{cold:.1f} s", peer, f"{numba / cold:.2f}x"),
    ]


def _start_up(cache: Path) -> tuple[float, float]:
    """Seconds of `import beltarm_env`, and from there to the end of the first step."""
    imported, stepped = _numbers(_FIRST_STEP, NUMBA_CACHE_DIR=str(cache), PYTHONPATH=str(ROOT))
    return imported, stepped


def _numbers(code: str, **environment: str) -> list[float]:
    """Numbers that a Python process of its own prints."""
    result = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, **environment}, capture_output=True, text=True, check=True
    )
    return [float(word) for word in result.stdout.split()]
