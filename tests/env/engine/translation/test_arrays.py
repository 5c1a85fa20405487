"""Kernels with arrays, translated to C, read and write what they do in Python, to the last bit, within their memory."""

import itertools
import math
import os
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from translating import Cases, compiler

from beltarm_env.engine.entries import entry_of
from eval.exports.compilers import SANITISED

CASES = Cases()
case = CASES.case
TABLE = np.array([[1.0, 2.0, 3.0], [-4.0, 0.1, 6.0]])
KNOWN = np.array([3, -1, 2])
LAST = slice(2, 4)
STEPS = (1, 2, 5)
ENDS = (-12, -3, 0, 2, 7, 8, 20)


class Inner(NamedTuple):
    row: Any
    times: int


class Memory(NamedTuple):
    state: Any
    inner: Any
    spare: Any = None


class Workspace(NamedTuple):
    left: Any
    right: Any


def wholes(*numbers: int) -> Any:
    return np.array(numbers, np.int64)


def row(n: int = 5) -> Any:
    return np.linspace(-1.0, 2.5, n) ** 3


def square() -> Any:
    return np.arange(12.0).reshape(3, 4) - 5.5


def mean(values: Any) -> float:
    total = 0.0
    for k in range(len(values)):
        total += values[k]
    return total / len(values)


@case((row(8), -1), (row(8), 3), (row(8), -8))
def elements(a: Any, k: int) -> float:
    a[0], a[1] = a[1], a[0]
    a[-1] = a[2] * a[-2]
    a[2] += 1.5
    a[3] *= -a[3]
    a[k] += 1.0
    for j in range(-3, 3):
        a[j] += j
    return a[0] + a[4] + a[k]


@case((square(), 1), (square(), 2))
def parts(a: Any, k: int) -> float:
    a[k] = 7.0
    a[0, 1:3] += a[k - 1, 2:4]
    column = a[k]
    column[LAST] = a[0, LAST]
    a[:2, 0] = -1.0
    a[2, : len(column) - 1] = TABLE[1]
    total = 0.0
    for j in range(a.shape[1]):
        total = 0.5 * total + a[k, j] * column[j]
    return total + a.shape[0] * len(a)


@case(*((row(8), start, stop) for start, stop in itertools.product(ENDS, ENDS)))
def slices_cut(a: Any, start: int, stop: int) -> tuple[int, ...]:
    part = a[start:stop]
    part += 1.0
    a[start:] *= 2.0
    a[:stop] -= 3.0
    return len(part), len(a[start:]), len(part[:-1]), len(part[-2:]), len(a[-10:]), len(a[:-10]), len(a[5:99])


def cut_and_kept(x: float, of: Any) -> Any:
    k, kept = 0, np.empty(3)
    if x < 0.0:
        x, of = 0.0, of._replace(times=5)
    for i in range(3):
        kept[i] = x + of.row[k] + of.times
        k -= 1
    return kept


def times_of(of: Any, x: float) -> float:
    if x < 0.0:
        of = of._replace(times=5)
    return of.times * of.row[0]


@case((row(4), -1.0), (row(4), 2.0))
def parameters_assigned_again(a: Any, x: float) -> Any:
    return cut_and_kept(x, Inner(a, 3)), times_of(Inner(a, 3), x)


def next_place(counter: Any) -> int:
    counter[0] += 1
    return counter[0] - 1


@case((row(8), wholes(1, -1, 0), wholes(0), wholes(3, 2)))
def indices_in_memory(a: Any, i: Any, counter: Any, n: Any) -> float:
    a[i[1]] = a[i[0]]
    a[i[1] - 1] += 2.0
    i[0] = 5
    a[i[0]] *= 3.0
    a[next_place(counter)] += 10.0
    a[next_place(counter)] *= a[next_place(counter)]
    n[: n[1]] = 0
    a[: n[0]] = 1.0
    return a[i[2]]


@case((1, 0.5), (0, -1.0))
def known_arrays(k: int, x: float) -> tuple[Any, ...]:
    sizes = 0
    for step in STEPS:
        sizes += step
    known = TABLE.shape[1], len(STEPS), sizes, mean(TABLE[k])
    places = STEPS[k], STEPS[k - 1], STEPS[-k], STEPS[k - 3], KNOWN[k]
    return TABLE[k, 2] * x, TABLE[1, 1], TABLE[k][k], *places, *known


@case((row(3),), (np.array([math.nan, 1.0, -0.0]),))
def guarded_reads(a: Any) -> tuple[Any, ...]:
    k = 0
    while k < len(a) and a[k] != 1.0:
        k += 1
    found = a[k] if k < len(a) else -1.0
    return k, found, k < 3 and a[k] > 0.0


def ends(k: int) -> Any:
    return slice(k, k + 2)


@case((row(), square(), 1), (row(), square(), 3))
def loops_over_entries(a: Any, b: Any, k: int) -> tuple[Any, ...]:
    total, last = 0.0, 0.0
    for value in a[ends(k)]:
        if value > 2.0:
            continue
        total = 0.5 * total + value
        value += 1.0
    for line in b[:, ends(k)]:
        line[0] = total
        for value in line:
            last = value
            if value < 0.0:
                break
            total += value
    for step in TABLE[1]:
        total -= step
    return total, last, len(a[slice(2)]), mean(a.reshape(1, -1)[0])


@case((4,), (0,))
def loop_variables(n: int) -> tuple[int, ...]:
    total, k, j = 0, 7, 5
    for k in range(n):  # noqa: B007
        pass
    for j in range(10, 0, -3):  # noqa: B007
        pass
    after = k, j
    for i in range(n):
        for j in range(i, n, 2):
            if j == 3:
                break
            total += j
        i += 10
        total += i
    return *after, total


@case((row(), 4), (row(), 1))
def views_by_what_a_loop_counts(a: Any, n: int) -> tuple[int, ...]:
    total, some = 0, a[:0]
    for i in range(n):
        if i == 1:
            some = a[:i]
        total += len(some)
        every = a[: i + 1]
    for i in range(n):  # noqa: B007
        total += len(every)  # pyright: ignore[reportPossiblyUnboundVariable]
    return total, len(every)  # pyright: ignore[reportPossiblyUnboundVariable]


@case((row(8),))
def whole_arrays(a: Any) -> float:
    b = a.copy()
    b *= 2.0
    b[:] += a * b - 1.0
    b -= abs(a) + np.square(a)
    a[:] = -b / 3.0
    a[1:3] = (0.5, b[0])
    a[:] = a * a[0]
    a += a[0]
    a /= a[7]
    return mean(b) + mean(np.ones(3))


def shift(x: Any, y: Any) -> None:
    x[1:] = y[:-1]


@case((np.array([1.0, 2.0, 3.0, 4.0]), square(), 1))
def taken_where_python_does(a: Any, b: Any, k: int) -> tuple[float, ...]:
    total, few = 0.0, np.zeros(4)
    few[: (k + 5) & 3] += len(few[k : (k + 5) & 3])
    for value in a[k:]:
        total = 2.0 * total + value
        k += 1
    few[:3] = TABLE[int(few[0])]
    a[:] = b[int(a[0])] - 1.0
    a[:], few[:] = 0.6 * a - few, a + 0.8 * few
    a[:] = few[:] = (a + few) * bumped(a)
    a[0] = 0.5
    a[:] = b[int(a[0])] + b[int(a[0])] * bumped(a)
    return total, mean(few)


@case((row(8),), (row(9),))
def overlapping(a: Any) -> None:
    a[1:] = a[:-1]
    a[:3] = a[1:4]
    a[2:] = a[2:] + a[1:-1] * 2.0
    a[:2] = a[3:5]
    part = a[1:]
    part[:] = a[:-1]
    shift(a, a)
    shift(a[:5], a[2:7])
    shift(a[2:7], a[:5])


@case((row(8), 2), (row(8), 5))
def names_swapped(a: Any, k: int) -> tuple[Any, ...]:
    left, right = a[:k], a[k:]
    k += 2
    left, right = right, left
    left[0] = 1.0
    b = np.ones(8)
    old = a
    a = b
    b = old
    a[0] = 5.0
    b[1] = 6.0
    return a[0], b[0], a[1], b[1], len(left), len(right), right[0], k


@case((row(8), 1))
def views_of_views(a: Any, k: int) -> tuple[Any, ...]:
    a = b = a[k:]
    a[0] = 9.0
    inner = b[1:][1:][k:]
    inner += 1.0
    return b[0], a[1], len(b), inner[0], inner[-1], len(inner)


@case((row(8), 3), (row(8), 7))
def one_function_of_many_shapes(a: Any, n: int) -> tuple[float, ...]:
    few = np.empty(3)
    few[:] = a[1:4]
    return mean(a), mean(few), mean(a[:n]), mean(a[2:7]), mean(TABLE[0])


@case((row(8), 3, 6, -1.0), (row(8), 3, 6, 2.0))
def chosen_in_a_branch(a: Any, n: int, m: int, x: float) -> tuple[float, ...]:
    part, known, inner, table = a[:n], a[:3], Inner(a, 2), Inner(TABLE[0], 2)
    if x > 0.0:
        part, known, inner, table = a[:m], a[2:7], Inner(a[1:], 3), Inner(TABLE[0], 4)
    part = part[1:]
    few, others = np.zeros(2), np.ones(2)
    view = few if x > 0.0 else others
    view[:] = a[2:4]
    return mean(part), len(part), mean(known), len(known), view[0], inner.times, inner.row[0], table.times


@case((3,), (0,))
def zeros_in_loops(n: int) -> float:
    total = 0.0
    for k in range(n):
        sums = np.zeros(3)
        counts = np.zeros(2, np.int64)
        for j in range(3):
            sums[j] += j + k
            counts[j % 2] += 1
        total = total * 2.0 + sums[2] + counts[0] - counts[1]
    return total


@case((square(), 1.0, 0.0), (square(), 1.0, 1.0))
def names_from_turn_to_turn(a: Any, x: float, y: float) -> tuple[Any, ...]:
    total, first, pair, best = 0.0, a[0], Inner(a[0], 1), -1
    for i in range(len(a)):
        line = a[i, i:]
        if i == 1:
            first, pair = line, Inner(line, 1)
        total += line[0] - first[0] - pair.row[1] + len(first)
    for k, value in enumerate((x, y)):
        if value > 0.0:
            best = k
    return total, best


def bumped(a: Any) -> float:
    a[0] += 1.0
    return a[0]


def grown(a: Any) -> Any:
    a[0] += 1.0
    return a.copy()


@case((row(),))
def read_before_calls(a: Any) -> tuple[float, ...]:
    first = a[0] + bumped(a) + (a[0] + grown(a)[0])
    a[0] += grown(a)[0] + Inner(a[0], 1)._replace(row=a[0], times=int(bumped(a))).row
    a[0] += bumped(a)
    both = (a[0], bumped(a), a[0])
    return first, *both, a[0] * 2.0 - bumped(a) * a[0], max(a[0], bumped(a)), 1.0 if a[0] < bumped(a) else 2.0


def updated(memory: Memory, x: float) -> float:
    memory.state[:] = x
    memory.inner.row[1] += memory.inner.times
    if memory.spare is not None:
        memory.spare[0] = 9.0
    return memory.inner.row[1]


@case((Memory(row(3), Inner(row(2), 4)), 1.5))
def tuples_of_arrays(memory: Memory, x: float) -> tuple[float, ...]:
    first = updated(memory, x)
    other = memory._replace(inner=Inner(memory.state[1:], 2))
    x += 1.0
    second = updated(other, x)
    third = updated(Memory(memory.state, memory.inner, memory.inner.row), 2.0)
    return first, second, third, other.inner.row[1], len(other.inner.row)


@case((row(3), 1.0, 5.0))
def numbers_beside_arrays(a: Any, x: float, y: float) -> tuple[float, ...]:
    before = Memory(a, Inner(a[1:], 3), x)
    after = Memory(a, Inner(a, int(y)), y)
    x, y = y, x
    before, after = after, before
    a[0] = x
    return before.spare, after.spare, before.inner.row[0], after.inner.row[0], after.inner.times, x, y


def workspace(n: int) -> Workspace:
    return Workspace(np.zeros(n), np.empty((n, 2)))


def halves(x: float, a: Any) -> Any:
    a[2], made = a[2] + 0.25, np.full(3, 0.5)
    made[1:] *= x
    return made


@case((row(3), 2.0), (row(3), -0.5))
def returned_arrays(a: Any, x: float) -> tuple[Any, ...]:
    first, second, work = halves(x, a), halves(a[2], a), workspace(3)
    a[:] = halves(3.0, a) + first
    work.right[:] = x
    work.right[2, 0] = 1.0
    work.left[:] = work.right[:, 0] * 3.0
    kinds = np.full(2, 3), np.full((2, 2), True)
    return mean(first), mean(second), kinds[0][1] // 2, kinds[1][1, 0], mean(work.left) + work.right[2, 1]


@pytest.mark.parametrize("name", CASES)
def test_the_kernel_in_c_is_the_kernel_in_python(name: str):
    CASES.check(name)


def zeroed(x: Any, n: int) -> None:
    for i in range(n):
        x[i + 2] = 0.0


def test_an_index_that_is_a_sum_is_taken_as_it_is():
    assert "x[int_add(i, 2)] =" in entry_of(zeroed, (row(), 3)).text, "else loops over arms are not vectorised"


@pytest.mark.slow
def test_within_memory(tmp_path: Path):
    """A kernel that reads or writes beyond an array, or computes what C leaves undefined, ends the process."""
    asked = [*compiler().compiler, "-print-file-name=libasan.so"]
    sanitiser = subprocess.run(asked, capture_output=True, text=True, check=False).stdout.strip()
    if not os.path.isabs(sanitiser):
        pytest.skip("the compiler has no sanitiser of addresses")
    quiet = ("-q", "-p", "no:cacheprovider", "-k", "kernel_in_c")
    command = [sys.executable, "-m", "pytest", *quiet, str(Path(__file__).parent)]
    environment = {**os.environ, "LD_PRELOAD": sanitiser, "ASAN_OPTIONS": "detect_leaks=0"}
    environment["BELTARM_CC"] = shlex.join([*compiler().compiler, *SANITISED])
    environment["BELTARM_CACHE_DIR"] = str(tmp_path)
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]
