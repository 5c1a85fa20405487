"""What cannot be translated to C is refused, by function, file, line and construct."""

from __future__ import annotations

import inspect
from typing import Any, NamedTuple

import numpy as np
import pytest
from refusals import refused
from translating import Kernel, translate

from eval.translation.program import Program
from eval.translation.types import NotConstantError, TranslationError

TABLE = np.arange(3.0)
HUGE = 2**63
REFUSED: dict[str, tuple[Kernel, tuple[Any, ...], tuple[str, ...]]] = {}


class Pair(NamedTuple):
    """Two numbers."""

    low: float
    high: float


def refuses(*words: str, given: tuple[Any, ...] = (1.0,)) -> Any:
    """Make a kernel one that is refused, with the words of the message; `HERE` marks the line."""

    def add(kernel: Kernel) -> Kernel:
        REFUSED[kernel.__name__] = kernel, given, words
        return kernel

    return add


@refuses("a dict is not translated", "{'x': x}")
def dictionary(x: float) -> float:
    known = {"x": x}  # HERE
    return known["x"]


@refuses("a list comprehension is not translated", "[x * k for k in range(3)]")
def comprehension(x: float) -> float:
    return sum([x * k for k in range(3)])  # HERE


@refuses("a list is not translated")
def listed(x: float) -> float:
    return [x, x][1]  # HERE


@refuses("a lambda is not translated")
def function_within(x: float) -> float:
    double = lambda y: 2.0 * y  # noqa: E731 # HERE
    return double(x)


@refuses("a formatted string is not translated")
def formatted(x: float) -> float:
    return len(f"{x}")  # HERE


@refuses("a number is expected", "'one'")
def string(x: float) -> Any:
    word = "one"
    return x + word  # type: ignore # HERE


@refuses("a try is not translated")
def tried(x: float) -> float:
    try:  # HERE
        return 1.0 / x
    except ZeroDivisionError:
        return 0.0


@refuses("a raise is not translated")
def raised(x: float) -> float:
    if x > 0.0:
        raise ValueError  # HERE
    return x


@refuses("np.where is not translated", "np.where(x > 0.0, x, 0.0)")
def numpy_where(x: float) -> Any:
    return np.where(x > 0.0, x, 0.0)  # HERE


@refuses("np.sin is not translated")
def maths_library(x: float) -> Any:
    return np.sin(x)  # HERE


@refuses(".sum is not translated", "a.sum", given=(TABLE,))
def method(a: Any) -> float:
    return a.sum()  # HERE


@refuses("MatMult", given=(TABLE,))
def matrix_product(a: Any) -> float:
    return a @ a  # HERE


@refuses("slices with a step", "::2", given=(TABLE,))
def stepped_slice(a: Any) -> float:
    part = a[::2]  # HERE
    return part[0]


@refuses("unknown name 'missing'")
def unknown(x: float) -> float:
    return missing(x)  # type: ignore # noqa: F821 # HERE


@refuses("recursion calls itself")
def recursion(x: float) -> float:
    return recursion(x - 1.0) if x > 0.0 else x  # HERE


def doubles(x: float) -> Any:
    """Return a new array."""
    made = np.zeros(2)
    made[0] = x
    return made


@refuses("doubles returns an array", "write it into an argument")
def returned_array(x: float) -> float:
    made = doubles(x)  # HERE
    return made[0]


@refuses("1024 numbers", "too large for the stack", "argument")
def large(x: float) -> float:
    work = np.zeros((32, 32))  # HERE
    return work[0, 0] + x


@refuses("has to be known", given=(3,))
def unknown_size(n: int) -> float:
    work = np.zeros(n + HUGE // HUGE)
    return work[0]


@refuses("kind changes its type", "real", "an array of 3 real", given=(TABLE, 1.0))
def type_changed(a: Any, x: float) -> float:
    kind = x
    if x > 0.0:
        kind = a  # HERE
    return kind  # type: ignore


@refuses("made keeps an array that a loop allocates", given=(3,))
def kept_array(n: int) -> float:
    made = np.zeros(2)
    for _ in range(n):
        made = np.zeros(2)  # HERE
    return made[0]


@refuses("made must be written into an array", "made[:]", given=(TABLE,))
def array_expression(a: Any) -> float:
    made = 2.0 * a  # HERE
    return made[0]


@refuses("one shape", "(3,)", "(2,)", given=(TABLE,))
def shapes(a: Any) -> None:
    a[:2] = a + a[:2]  # HERE


@refuses("shape (2,)", "(3,)", given=(TABLE,))
def shapes_assigned(a: Any) -> None:
    a[:2] = a  # HERE


@refuses("index 3 is outside an axis of 3", given=(TABLE,))
def outside(a: Any) -> float:
    return a[3]  # HERE


@refuses("index -4 is outside an axis of 3", given=(TABLE,))
def outside_in_front(a: Any) -> None:
    a[-4] = 1.0  # HERE


@refuses("IndexError", "index 5")
def outside_a_table(x: float) -> float:
    return TABLE[5] * x  # HERE


@refuses("2 indices for an array of 1 axes", given=(TABLE,))
def axes(a: Any) -> float:
    return a[0, 1]  # HERE


@refuses("a whole number", given=(TABLE, 1.0))
def real_index(a: Any, x: float) -> float:
    return a[x]  # HERE


@refuses("what is constant is not assigned to: table[0]")
def constant_assigned(x: float) -> None:
    table = TABLE
    table[0] = x  # HERE


@refuses("9223372036854775808 is beyond the whole numbers of 64 bits", given=(3,))
def large_number(n: int) -> int:
    return n + HUGE  # HERE


@refuses("powers 2, 3 and 4", "0.5")
def roots(x: float) -> float:
    return x**0.5  # HERE


@refuses("ZeroDivisionError")
def division(x: float) -> float:
    return x + 1 // 0  # HERE


@refuses("3 arguments for 2 parameters")
def arguments(x: float) -> float:
    return Pair(x, x, x).low  # type: ignore # HERE


@refuses("argument 'high' is missing")
def missing_argument(x: float) -> float:
    return Pair(x).low  # type: ignore # HERE


@refuses("no field 'middle'")
def field(x: float) -> float:
    pair = Pair(x, x)
    return pair.middle  # type: ignore # HERE


@refuses("2 values for 3 targets")
def targets(x: float) -> float:
    a, b, c = Pair(x, x)  # type: ignore # HERE
    return a + b + c


@refuses("neither break nor continue")
def broken_off(x: float) -> float:
    for factor in (1.0, 2.0):  # HERE
        if x > factor:
            break
    return x


@refuses("and, or of numbers", "x or 1.0")
def number_or_number(x: float) -> float:
    return x or 1.0  # HERE


@refuses("for ... else")
def loop_with_else(x: float) -> float:
    for _ in range(3):  # HERE
        x += 1.0
    else:
        x = 0.0
    return x


@refuses("whole numbers", "range(x)")
def real_range(x: float) -> float:
    for _ in range(x):  # type: ignore # HERE
        x += 1.0
    return x


@refuses("before it is set")
def before_it_is_set(x: float) -> float:
    y = z + x  # type: ignore # noqa: F821 # HERE
    z = y
    return z


@refuses("max takes two numbers or more", given=(TABLE,))
def largest_of_an_array(a: Any) -> float:
    return max(a)  # HERE


@refuses("a list comprehension", "(in comprehension, ")
def within_a_call(x: float) -> float:
    return comprehension(x)


@pytest.mark.parametrize("name", REFUSED)
def test_refused(name: str) -> None:
    kernel, given, words = REFUSED[name]
    lines, first = inspect.getsourcelines(kernel)
    marked = [first + k for k, line in enumerate(lines) if line.rstrip().endswith("# HERE")]
    place = [f"(in {name}, test_untranslatable.py, line {marked[0]})"] if marked else []
    kinds = (TranslationError, NotConstantError)
    refused(kinds, (*words, *place), lambda: translate(kernel, given, Program()))


def test_function_without_source() -> None:
    made: dict[str, Any] = {}
    exec(compile("def made(x): return x", "<made>", "exec"), made)  # Python 3.13 knows a text of "<string>": that of -c
    refused(TranslationError, ("made has no source text",), lambda: translate(made["made"], (1.0,), Program()))
