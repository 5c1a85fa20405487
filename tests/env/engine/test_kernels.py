"""Kernels run as C what they say in Python, are never run in an old form, and run in plain Python where C cannot be."""

import copy
import importlib
import pickle
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from recording_calls import contents, copied
from refusals import refused

from beltarm_env.engine import PLAIN, bound, building, compiled, in_threads, inlined, kernels

pytestmark = pytest.mark.skipif(PLAIN or building.compiler() is None, reason="kernels run in plain Python")
kernel_of: Any = compiled  # which tests look into


class Gains(NamedTuple):
    a: float
    b: float = 9.0
    limit: Any = None


USUAL = Gains(0.5)


class Found(NamedTuple):
    rows: Any
    gains: Gains
    length: int


@inlined
def doubled(x: float) -> float:
    return x + x


@kernel_of
def weighted(x: float, gain: float = 2.0, gains: Gains = USUAL) -> float:
    return doubled(gain) * x + gains.a * gains.b + (0.0 if gains.limit is None else gains.limit)


@kernel_of
def chosen(up: bool, count: int, word: str = "sum", of: Callable[[float], float] = doubled) -> Any:
    total = 0
    for k in range(count):
        total += k // 2 - 3 * k
    return up, not up, of(0.1) if word == "sum" else total, total


@kernel_of
def total(row: Any) -> float:
    result = 0.0
    for k in range(len(row)):
        result = 0.5 * result + row[k]
    return result


@kernel_of
def smoothed(grid: Any, start: int) -> Found:
    count = len(grid)
    sums, rows = np.zeros(count), np.full((count, 2), 0.25)
    k = 0
    for row in grid:
        for value in row[start : start + 2]:
            sums[k] += value
        rows[k, 1] = sums[k]
        k += 1
    return Found(rows, Gains(total(sums), float(grid.shape[1])), k)


@kernel_of
def added(row: Any, other: Any, count: int) -> Any:
    sums = np.zeros(count)
    sums[:] = row + other
    return sums


@kernel_of
def described(row: Any) -> Any:
    told = {"total": total(row), "first": float(row[0]), "count": len(row), "rising": bool(row[0] < row[1])}
    return len(row), told, None


def read_only(array: np.ndarray) -> np.ndarray:
    array.flags.writeable = False
    return array


ROW, GRID = np.linspace(-1.0, 2.5, 8) ** 3, np.arange(12.0).reshape(3, 4) / 7.0
CALLS: list[tuple[Any, list[tuple[Any, ...]]]] = [
    (weighted, [(1.5,), (3,), (True, 0.1), (np.float64(2.5), np.int64(3)), (1.5, 0.1, Gains(1, 2.0, 3))]),
    (chosen, [(True, 5), (np.True_, np.int32(5), "other"), (False, 0, "sum", abs)]),
    (total, [(ROW,), (ROW[::3],), (ROW[::-1],), (ROW[:0],), (read_only(ROW.copy()),), (GRID[:, 1],), (GRID.T[2],)]),
    (described, [(ROW,), (GRID[:, 1],), (ROW[::-1],)]),
    (smoothed, [(GRID, 1), (GRID.T, 0), (GRID[::2, ::-1], 3), (GRID[:0], 0), (read_only(GRID[:1].copy()), -1)]),
    (added, [(ROW, ROW[::-1], 8), (ROW[:0], ROW[:0], 0), (GRID[0], GRID[:, 0][:3].repeat(4)[:4], 4)]),
]


def told(capsys: pytest.CaptureFixture[str]) -> list[str]:
    """Lines on stderr, but for the one that says that kernels are compiled."""
    return [line for line in capsys.readouterr().err.splitlines() if "compiling kernels" not in line]


@pytest.mark.parametrize(("kernel", "calls"), CALLS, ids=lambda each: getattr(each, "__name__", ""))
def test_a_kernel_gives_what_it_gives_in_python(kernel: Any, calls: list[Any], capsys: pytest.CaptureFixture[str]):
    for arguments in calls:
        for _ in range(2):
            given, python = copied(arguments), copied(arguments)
            with np.errstate(over="ignore"):
                wanted = kernel.py_func(*python)
            assert contents((kernel(*given), given)) == contents((wanted, python)), arguments
    assert told(capsys) == [] and not kernel._refused, "it runs as C"


def test_what_it_returns_is_its_own_and_arguments_come_by_name_and_by_default():
    first, second = smoothed(GRID, 1), smoothed(GRID, 0)
    assert type(first) is Found and type(first.gains) is Gains and first.gains.b == 4.0
    before = second.rows.copy()
    first.rows[:] = 7.0
    assert first.rows.flags.writeable and (second.rows == before).all() and (smoothed(GRID, 0).rows == before).all()
    assert weighted(gain=3.0, x=2.0) == weighted(2.0, 3.0) == weighted.py_func(2.0, 3.0)
    assert weighted(2.0, gains=Gains(1.0)) == weighted.py_func(2.0, gains=Gains(1.0))
    for arguments, named in (((), {}), ((1.0, 2.0, Gains(1.0), 4.0), {}), ((1.0,), {"x": 2.0}), ((1.0,), {"y": 2.0})):
        with pytest.raises(TypeError):
            weighted(*arguments, **named)


def test_names_that_are_given_alone_and_that_c_has_for_other_things(capsys: pytest.CaptureFixture[str]):
    @kernel_of
    def law(p: Any, r: float, n: int, out: Any, *, real: float, heap: int = 2) -> Any:
        return np.zeros(n), p[0] + r * n + out[0] - real * heap

    one = np.ones(1)
    assert law(one, 2.0, 3, one, real=0.5)[1] == law(one, 2.0, 3, out=one, heap=1, real=1.0)[1] == 7.0
    assert told(capsys) == []


def test_lengths_that_do_not_fit_are_an_error_and_leave_nothing():
    for given in ((ROW, ROW[:3], 8), (ROW, ROW, 7), (ROW[:3], ROW[:3], 0)):
        refused(ValueError, ("added, ", "test_kernels.py"), lambda given=given: added(*given))
    assert (added(ROW, ROW, 8) == 2 * ROW).all()


def test_first_arguments_are_bound_and_others_have_their_types():
    run = bound(smoothed, (GRID,), 0)
    assert contents(run(1)) == contents(smoothed(GRID, 1))
    whole = bound(total, (), ROW)
    assert whole(ROW[:3]) == total(ROW[:3]) and bound(max, (3,), 2)(4) == 4
    for other in (ROW[::2], ROW.astype(np.float32), GRID, 1.0, read_only(ROW.copy())):
        refused(TypeError, ("argument 0",), lambda other=other: whole(other))
    for others, words in (((1.0,), "argument 1"), ((), "2 arguments are expected, not 1"), ((1, 2), "not 3")):
        with pytest.raises(TypeError, match=words):
            run(*others)


@kernel_of
def held(limit: float, x: float, row: Any) -> Any:
    if not -limit < x < limit:
        raise ValueError('100% "beyond"')
    row[:] = x
    return row


def test_an_error_that_a_kernel_raises_and_numbers_that_come_as_arrays(capsys: pytest.CaptureFixture[str]):
    for run in (bound(held, (2.0,), 0.0, like=np.zeros(3)), bound(held.py_func, (2.0,), 0.0, like=np.zeros(3))):
        for value in (1.5, -0.1, np.float32(0.1)):
            assert run(np.array([value])).tolist() == [float(value)] * 3
        for value in (2.0, -np.inf, np.nan):
            with pytest.raises(ValueError, match=r'^100% "beyond"$'):
                run(np.array([value]))
        for other in (1.0, [1.0], np.ones(2), np.ones((1, 1)), np.array([1]), np.ones(1, np.float16), np.float64(1.0)):
            with pytest.raises(TypeError):
                run(other)
    assert told(capsys) == [], "it runs as C"


@kernel_of
def filled(thread: int, row: Any, word: str) -> None:
    row[thread] = 1.0 if word == "one" else 2.0


def test_in_threads_equal_words_are_one_and_what_does_not_fit_is_named():
    for word in ("one", "".join(["o", "ne"])):
        row = np.zeros(2)
        in_threads(filled, 2, row, word)
        assert row.tolist() == [1.0, 1.0]
    unaligned = np.zeros(17, np.uint8)[1:].view(np.float64)
    refused(TypeError, ("argument 1: ", "not aligned"), lambda: in_threads(filled, 2, unaligned, "one"))


def made(gain: float, of: Any) -> Any:
    @kernel_of
    def law(x: float) -> float:
        return gain * of(x)

    return law


def test_closures_have_their_own_values_and_a_copy_is_the_same_kernel():
    laws = [made(2.0, doubled), made(3.0, doubled), made(3.0, abs), made(-0.0, abs)]
    assert [law(-1.5) for law in laws] == [-6.0, -9.0, 4.5, 0.0] and np.signbit(laws[3](1.0))
    assert pickle.loads(pickle.dumps((weighted, doubled))) == (weighted, doubled)
    assert copy.copy(weighted) is weighted and copy.deepcopy([weighted])[0] is weighted


def test_threads_that_call_a_new_kernel_at_the_same_time(capsys: pytest.CaptureFixture[str]):
    law = kernel_of(product_less)
    given = [(1, 2.0), (1.5, 2.0), (1.5, 2)] * 3
    with ThreadPoolExecutor(len(given)) as pool:
        found = list(pool.map(lambda pair: law(*pair), given))
    assert contents(tuple(found)) == contents(tuple(product_less(*pair) for pair in given))
    assert told(capsys) == []


def product_less(x: float, y: float) -> float:
    return x * y - x


TYPED: dict[str, Any] = {"__name__": "__main__"}
exec(compile("def typed_in(x):\n    return 3.0 * x", "<typed in>", "exec"), TYPED)


@kernel_of
def comprehended(row: Any) -> Any:
    return sum([2.0 * value for value in row])


@pytest.mark.parametrize(
    ("kernel", "given", "wanted", "words"),
    [
        (comprehended, ROW, 2.0 * sum(ROW), ("comprehended", "a list comprehension", "test_kernels.py, line ")),
        (compiled(TYPED["typed_in"]), 2.0, 6.0, ("typed_in", "source")),
        (compiled(product_less), (1.0, 2j), 2j - 1.0, ("product_less", "complex")),
    ],
)
def test_what_cannot_be_translated_runs_in_python_and_a_line_says_so(
    kernel: Any, given: Any, wanted: Any, words: tuple[str, ...], capsys: pytest.CaptureFixture[str]
):
    arguments = given if isinstance(given, tuple) else (given,)
    assert [kernel(*arguments) for _ in range(3)] == [wanted] * 3
    assert bound(kernel, arguments[:1], *arguments[1:])(*arguments[1:]) == wanted
    (line,) = told(capsys)
    assert all(word in line for word in words), line


def test_each_kind_of_arguments_that_a_kernel_does_not_take_is_named(capsys: pytest.CaptureFixture[str]):
    law = kernel_of(product_less)
    assert [law(1.0, 2j), law(2, np.float32(3)), law(1.0, 2j)] == [2j - 1.0, 4, 2j - 1.0]
    assert len(told(capsys)) == 2


LAWS = {"one": "2.0 * x", "two": "x**3"}


def test_another_text_than_that_of_what_is_loaded_does_not_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    """Three lines on top of the file put one function where the other one was."""
    text = "from beltarm_env.engine import compiled\n"
    text += "".join(f"@compiled\ndef {name}(x):\n    return {law}\n" for name, law in LAWS.items())
    (tmp_path / "moved.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    moved: Any = importlib.import_module("moved")
    for edited, x in ((f"\n\n\n{text}", 3.0), (text.replace("x**3", "4.0 * x"), 3)):
        (tmp_path / "moved.py").write_text(edited)
        assert moved.two(x) == 27
        assert ["edited" in line for line in told(capsys)] == [True]
    assert importlib.reload(moved).two(3.0) == 12.0 and told(capsys) == []


@pytest.mark.parametrize("obstacle", ["compiler", "folder", "compiler folder glue"])
def test_where_nothing_can_be_compiled_kernels_run_in_python_and_a_line_says_so(
    obstacle: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    missing, word = {*obstacle.split()}, "BELTARM_CACHE_DIR" if obstacle == "folder" else "ziglang"
    building.level()
    monkeypatch.setattr(kernels, "_say_once", cache(kernels._say_once.__wrapped__))
    if "compiler" in missing:
        monkeypatch.delenv("BELTARM_CC", raising=False)
        monkeypatch.setattr(building, "_packaged_compiler", lambda: None)
    if "folder" in missing:
        monkeypatch.setattr(building, "_folders", list)
    if "glue" in missing:
        monkeypatch.setattr(kernels, "_glue", cache(kernels._glue.__wrapped__))
    law, other = kernel_of(total.py_func), kernel_of(product_less)
    assert [law(ROW) for _ in range(3)] == [total(ROW)] * 3 and bound(law, (ROW,))() == total(ROW)
    assert other(2.0, 3.0) == product_less(2.0, 3.0)
    lines = told(capsys)
    assert all(word in line for line in lines) and len(lines) == 1
