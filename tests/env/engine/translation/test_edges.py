"""Kernels at the edges of what C has: in C they give what they give in Python, within their memory, or are refused."""

from __future__ import annotations

import itertools
import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from translating import SANITISE, Cases, Translated, compiler

TABLE = np.arange(3.0)
CASES = Cases()
case = CASES.case


class Part(NamedTuple):
    """An array and a number."""

    row: Any
    times: Any


def row(n: int = 8) -> Any:
    return np.linspace(-1.0, 2.5, n) ** 3


def wholes(*numbers: int) -> Any:
    return np.array(numbers, np.int64)


# Slices and indices

ENDS = (-12, -3, 0, 2, 7, 8, 20)


@case(*((row(), start, stop) for start, stop in itertools.product(ENDS, ENDS)))
def slices_cut(a: Any, start: int, stop: int) -> tuple[int, ...]:
    part = a[start:stop]
    part += 1.0
    a[start:] *= 2.0
    a[:stop] -= 3.0
    return len(part), len(a[start:]), len(part[:-1]), len(part[-2:]), len(a[-10:]), len(a[:-10]), len(a[5:99])


@case((row(), -1), (row(), 3), (row(), -8))
def indices_from_the_end(a: Any, k: int) -> float:
    a[k] += 1.0
    for j in range(-3, 3):
        a[j] += j
    return a[k]


@case((row(), wholes(3, 2)))
def lengths_that_are_overwritten(a: Any, n: Any) -> float:
    n[: n[1]] = 0
    a[: n[0]] = 1.0
    return a[0]


@case((row(), wholes(1, -1, 0)))
def indices_in_memory(a: Any, i: Any) -> float:
    a[i[1]] = a[i[0]]
    a[i[1] - 1] += 2.0
    i[0] = 5
    a[i[0]] *= 3.0
    return a[i[2]]


@case((3,), (4,))
def tuples_by_index(k: int) -> tuple[int, ...]:
    steps = (1, 2, 5)
    return steps[k - 3], steps[2 - k], steps[k - 5]


# Whole numbers

FAR = (2**31 - 2, 2**31 - 1, 2**31, -(2**31), -(2**31) - 1, 5, -7, 0)


@case(*itertools.product(FAR, (1, 2, -1, 3)))
def beyond_32_bits(a: int, b: int) -> tuple[int, ...]:
    total, count = a, 0
    for k in range(20):
        total = total * 2 + b * k
        count += a
    return a + b, a - b, a * b * 5, -a, abs(a), a // b, a % b, a // -b, a % -b, total % 1000003, count, a + 2147483647


@case((wholes(2**62, -(2**63), 2**63 - 1, -1),))
def wrapped(n: Any) -> tuple[bool, ...]:
    a, b, c = n[0] + n[0], n[1] + n[3], n[2] * n[0]
    return a < 0, b > 0, c == -n[0], -n[1] < 0, n[1] // n[3] < 0, abs(n[1]) < 0, n[1] - n[2] == 1


@case((wholes(1, 2, 3), 0.7))
def wholes_of_reals(n: Any, x: float) -> tuple[int, ...]:
    n[0] += x
    n[1:] = 3.9 * x
    return n[0], n[1]


# Memory that has two names


def shift(x: Any, y: Any) -> None:
    """Shift by one."""
    x[1:] = y[:-1]


@case((row(),))
def arguments_of_one_array(a: Any) -> float:
    shift(a, a)
    shift(a[:5], a[2:7])
    shift(a[2:7], a[:5])
    return a[3]


@case((row(),))
def numbers_of_the_target(a: Any) -> float:
    a[:] = a * a[0]
    a += a[0]
    a /= a[7]
    return a[1]


@case((row(),))
def pointer_kept(a: Any) -> tuple[float, ...]:
    b = np.ones(8)
    old = a
    a = b
    b = old
    a[0] = 5.0
    b[1] = 6.0
    return a[0], b[0], a[1], b[1]


@case((row(), 1))
def views_of_views(a: Any, k: int) -> tuple[Any, ...]:
    a = b = a[k:]
    a[0] = 9.0
    inner = b[1:][1:][k:]
    inner += 1.0
    return b[0], a[1], len(b), inner[0], inner[-1], len(inner)


@case((row(), 2), (row(), 5))
def views_swapped(a: Any, k: int) -> tuple[Any, ...]:
    left, right = a[:k], a[k:]
    k += 2
    left, right = right, left
    left[0] = 1.0
    return len(left), len(right), right[0], k


# Ways through a kernel


@case((row(3), 1.0), (row(3), -1.0))
def tuple_changed_in_a_branch(a: Any, c: float) -> tuple[Any, ...]:
    part, known = Part(a, 2), Part(TABLE, 2)
    if c > 0.0:
        part, known = Part(a[1:], 3), Part(TABLE, 4)
    return part.times, part.row[0], known.times


@case((3,), (0,))
def loop_variables_after_loops(n: int) -> tuple[int, int]:
    k, j = 7, 5
    for k in range(n):  # noqa: B007
        pass
    for j in range(10, 0, -3):  # noqa: B007
        pass
    return k, j


@case((4,), (0,))
def loop_variables_changed(n: int) -> int:
    total = 0
    for i in range(n):
        for j in range(i, n, 2):
            if j == 3:
                break
            total += j
        i += 10
        total += i
    return total


@case((1.0, math.nan), (math.nan, 1.0), (-0.0, 0.0), (0.0, -0.0))
def zeros_and_what_is_no_number(x: float, y: float) -> tuple[Any, ...]:
    return max(x, y), min(x, y), max(0.0, x, y), x == y, x != x, not x < y, 1.0 if x else 2.0, -x * 0.0, x % 1.0


@pytest.mark.filterwarnings("ignore:.*overflow:RuntimeWarning")  # NumPy's own, of `wrapped`
@pytest.mark.parametrize("name", CASES)
def test_the_kernel_in_c_is_the_kernel_in_python(library: Translated, name: str, tmp_path: Path):
    CASES.check(library, name, tmp_path)


@pytest.mark.skipif(SANITISE in os.environ, reason="this is the process that the test starts")
def test_within_memory():
    """A kernel that reads or writes beyond an array, or computes what C leaves undefined, ends the process."""
    asked = [*compiler().compiler, "-print-file-name=libasan.so"]
    sanitiser = subprocess.run(asked, capture_output=True, text=True, check=False).stdout.strip()
    if not os.path.isabs(sanitiser):
        pytest.skip("the compiler has no sanitiser of addresses")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", __file__, "-k", "kernel_in_c"]
    environment = {**os.environ, SANITISE: "1", "LD_PRELOAD": sanitiser, "ASAN_OPTIONS": "detect_leaks=0"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]
