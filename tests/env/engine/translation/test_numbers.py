"""Kernels translated to C give what they give in Python, to the last bit: numbers, branches, loops and calls."""

import itertools
import math
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples
from translating import Calls, Cases, Kernel, same

from beltarm_env.engine import ENGINE, compiled
from beltarm_env.engine.words import add, look
from beltarm_env.physics.trigonometry import exponential, polar_angle, sine_cosine

NAN, INF = math.nan, math.inf
REALS = [0.0, -0.0, 1.0, -1.0, 0.1, -7.5, 3.0, 1e300, 5e-324, INF, -INF, NAN]
PAIRS: Calls = list(itertools.product(REALS, REALS))
WHOLES: Calls = [(a, b) for a in (-7, -6, -1, 0, 1, 6, 7) for b in (-3, -2, 2, 3)]
FINITE: Calls = [(a, b) for a in (7.5, -7.5, 6.0, -6.0, 0.0, -0.0, 1e-300) for b in (2.5, -2.5, 3.0, -3.0, 0.1)]
SINGLES: Calls = [(np.array([a], np.float32), b) for a in (0.1, -3.3, 1e30) for b in (0.1, 7.0, -1e-3)]
FAR = (2**31 - 2, 2**31 - 1, 2**31, -(2**31), -(2**31) - 1, 5, -7, 0)
KNOWN = np.array([3, -1, 2])
CASES = Cases()
case = CASES.case


@case(*WHOLES)
def whole_numbers(a: int, b: int) -> tuple[Any, ...]:
    divided = a / b, (a + 1) / b, 1 / b, a / 2 * b, 3 // b, a // 2, a % 3, 7 % b
    real = a + 0.5 * b, a * 0.1, float(a) / b, 2.0 - a, max(a, 0.5), min(b, a), max(a, b, 1)
    return *divided, a // b, a % b, -a // b, a % -b, a - -b, a * b - a, abs(a), -a, *real


@case(*FINITE)
def remainders(a: float, b: float) -> tuple[float, ...]:
    return a % b, -a % b, a % 2.0, 7.0 % b, a // b, -a // b, a // 2.0, a // 0.1


@case(*PAIRS)
def compared(a: float, b: float) -> tuple[Any, ...]:
    ends = max(a, b), min(a, b), max(b, a), min(b, a), max(a, b, 0.0), min(0.0, a, b), abs(a), -b, 1.0 if a else 2.0
    return *ends, a < b, a <= b, a == b, a != b, not a < b, -1.0 < a < b, a < b < 1.0, -2.0 < a <= 0.5 * b < 5.0


@case(*[(x,) for x in (0.0, 0.9, 1.0, 1.5, 2.5, 1e6 + 0.5, -0.9, -1.0, -1.5, -2.5)])
def rounded(x: float) -> tuple[Any, ...]:
    return int(x), math.floor(x), math.ceil(x), np.floor(x), np.ceil(x), int(abs(x)) % 2, float(int(x))


def products(x: float) -> tuple[float, ...]:
    """Return powers above the second as the products that they are in C."""
    y = 0.1 * x
    squares = x**2, math.sqrt(x**2), np.square(x), -(x**2), (-x) ** 2, (x + 1.0) ** 2
    return *squares, x * x * x, (x * x) * (x * x), -x * -x * -x, (y * y) * (y * y)


@case(*[(x,) for x in (0.0, 2.0, 0.3, -1.7, 1e80)], reference=products)
def powers(x: float) -> tuple[float, ...]:
    squares = x**2, math.sqrt(x**2), np.square(x), -(x**2), (-x) ** 2, (x + 1.0) ** 2
    return *squares, x**3, x**4, (-x) ** 3, (0.1 * x) ** 4


@case(*[(x,) for x in REALS if x])  # of zero, np.sign in C keeps the sign, and in NumPy not
def signs(x: float) -> Any:
    return np.sign(x), np.sign(-x), math.isfinite(x), math.isnan(x), np.isfinite(x), np.isnan(x)


def promoted(values: Any, b: float) -> tuple[Any, ...]:
    """Return what NumPy gives where a float32 that meets a Python number becomes a float64."""
    a = values[0]
    step, wide, root = np.float32(0.1), np.float64(a), np.sqrt(abs(a))
    known = np.float64(step) * 3.0, step + a, step * np.float32(3.0), float(step) * 3.0, np.float64(step) / 3
    roots = root, root * root, math.sqrt(abs(a)), math.fabs(a) * math.fabs(a)
    functions = *roots, abs(a), -a, min(a, np.float32(b)), max(wide, b), np.floor(a * a), wide > b
    both = wide + b, wide * 2.0, a * a, np.float32(b), np.float32(b) * step, np.float32(wide * b) - a, wide * 3
    return *known, *functions, *both


@case(*SINGLES, reference=promoted)
def single_precision(values: Any, b: float) -> tuple[Any, ...]:
    a = values[0]
    step, root = np.float32(0.1), np.sqrt(abs(a))
    known = step * 3.0, step + a, step * np.float32(3.0), float(step) * 3.0, step / 3
    roots = root, root * root, math.sqrt(abs(a)), math.fabs(a) * math.fabs(a)
    functions = *roots, abs(a), -a, min(a, np.float32(b)), max(a, b), np.floor(a * a), a > b
    both = a + b, a * 2.0, a * a, np.float32(b), np.float32(b) * step, np.float32(a * b) - a, a * 3
    return *known, *functions, *both


@case(*[(k, x) for k in (-2, 0, 3) for x in (-1.0, 0.0, 2.0)])
def choices(k: int, x: float) -> tuple[Any, ...]:
    many, up = (k > 0 and x > 0.0) or k < 0, x > 0.0
    found = 0 if k and (x or k) else 1
    numbers = found, int(up) + up, up * x, up + 1, up - k, max(up, k), k & 1, k | 4, bool(k), int(up), float(up)
    return *numbers, many, not many, (k == 3) | (x == 0.0), (k == 3) & (x > 0.0), 1.0 if many else x, k if x else -k


@case((np.array([1, -2, 3]), np.array([True, False, True]), 2.7))
def other_types(n: Any, flags: Any, x: float) -> tuple[Any, ...]:
    n[1] = int(x)
    flags[1] = n[0] < x
    n[0] //= 2
    n[0] += x
    n[2:] = 0.9 * x
    singles = np.zeros(2, np.float32)
    singles[0] = 0.1
    singles[1] = 2.0 * singles[0]
    return n[1] / 2, singles[1] * 1.0, flags[0] and not flags[1], KNOWN[n[2] - 1] % 2


@case((np.array([3, -128, 127, 5], np.int8), np.zeros(3, np.int8), 300))
def little_numbers(a: Any, b: Any, n: int) -> tuple[Any, ...]:
    b[0], b[1] = n // 3, -7
    b[2] = b[0] + b[1]
    total = 0
    for k in range(len(a)):
        total += int(a[k])
    return total, b[1] * 0.5, a[0] > b[1], int(a[2]) + int(a[2])


@case((np.array([2**64 - 1, 2**63 + 5, 3], np.uint64), 7))
def unsigned_numbers(a: Any, n: int) -> tuple[Any, ...]:
    a[2] ^= a[1] >> np.uint64(n)
    a[1] = (a[1] * np.uint64(5) + a[0]) & np.uint64(0xFFFF)
    a[0] -= np.uint64(n) << np.uint64(3)
    far = float(a[0] >> np.uint64(n + 57)), float(a[0] << np.uint64(n + 57)), int(abs(a[0]) >> np.uint64(1))
    return *far, a[0] > a[1], a[1] == np.uint64(n), int(a[1] & np.uint64(127)), float(a[1] >> np.uint64(11))


@case(*itertools.product(FAR, (1, 2, -1, 3)))
def beyond_32_bits(a: int, b: int) -> tuple[int, ...]:
    total, count = a, 0
    for k in range(20):
        total = total * 2 + b * k
        count += a
    return a + b, a - b, a * b * 5, -a, abs(a), a // b, a % b, a // -b, a % -b, total % 1000003, count, a + 2147483647


@case((np.array([2**62, -(2**63), 2**63 - 1, -1]),))
def wrapped(n: Any) -> tuple[bool, ...]:
    a, b, c = n[0] + n[0], n[1] + n[3], n[2] * n[0]
    return a < 0, b > 0, c == -n[0], -n[1] < 0, n[1] // n[3] < 0, abs(n[1]) < 0, n[1] - n[2] == 1


@case((np.array([0, 0]),))
def shared_words(words: Any) -> tuple[int, ...]:
    before = add(words, 0, 3), add(words, 0, 4), add(words, 1, -2)
    add(words, 1, 10)
    return *before, look(words, 0), look(words, 1)


@case(*[(c, x) for c in (-1.0, 1.0) for x in (-1.0, 0.0, 0.5, 2.0, 3.0)])
def branches(c: float, x: float) -> tuple[Any, ...]:
    gain, kind = 1, 0
    if c > 0.0:
        gain = 2.5
        kind = 1
        other = x
    else:
        other = -1
    return gain, kind, other, early_returns(x)


def early_returns(x: float) -> float:
    if x < 0.0:
        return 0
    if x > 1.0:
        if x == 2.0:
            return 0.25
        return 1
    return x


@case(*[(n,) for n in range(5)])
def counted(n: int) -> tuple[int, ...]:
    up = down = steps = none = turns = 0
    for k in range(n):
        up = up * 3 + k
    for k in range(n, 0, -1):
        down = down * 3 + k
    for k in range(n, -n, -2):
        steps = steps * 3 + k
    for k in range(2, n, 2):
        none += k
    for _ in range(n):
        n -= 1
        for _ in range(2):
            _, left = turns // 2, turns % 2
            turns += 1 + left
    return up, down, steps, none, turns, n


def halved(x: float) -> float:
    return x / 2.0 if x > 1.0 else 0.0


@case(*[(x,) for x in (0.5, 3.0, 100.0)])
def calls_where_asked(x: float) -> tuple[Any, ...]:
    either = x > 50.0 or halved(x) > 1.0
    both = x > 1.0 and halved(x) < 10.0 and halved(halved(x)) < 1.0
    chosen = halved(x) if x > 1.0 else halved(-x) - 1.0
    between, turns = 1.0 < halved(x) < x, 0
    while halved(x) > 0.3 and turns < 10:
        x = halved(x)
        turns += 1
        if turns == 3:
            continue
        if turns == 5:
            break
    while True:
        turns += 2
        if turns > x:
            return x, turns, either, both, chosen, between


class Pair(NamedTuple):
    low: float
    high: float = 4.0


class Range(NamedTuple):
    pair: Pair
    times: int
    note: Any = None


@case(*[(1.0, 2.0), (-3.0, 0.5)])
def swapped(t_1: float, t_2: float) -> tuple[float, ...]:
    t_a, t_b = t_1 + 1.0, t_2
    for _ in range(3):
        t_a, t_b = t_b, t_a
        t_a, t_b, t_1 = t_b + t_1, t_1, t_a
    t_1, t_2 = t_2, t_1
    p, q = Pair(t_1, t_2), Pair(t_2)
    p, q = q, p
    p, q = Pair(q.high, p.low), Pair(p.high, q.low)
    return t_a, t_b, t_1, t_2, *p, *q


def ordered(a: float, b: float) -> Pair:
    if a < b:
        return Pair(a, b)
    return Pair(b, a)


def width(pair: Pair, factor: float = 2.0, *, shift: int = 0) -> float:
    return factor * (pair.high - pair.low) + shift


@case(*[(1.0, 2.0), (3.0, -0.5)])
def named_tuples(a: float, b: float) -> tuple[float, ...]:
    pair = ordered(a, b)
    low, high = pair
    turned = pair._replace(low=high)
    around = Range(pair._replace(high=7.0), 3)
    around = around._replace(pair=Pair(around.pair.low + 1.0, around.pair.high))
    wide = width(around.pair, shift=around.times) + width(pair, 3.0)
    return low, high, *turned, wide, around.pair[1], 1.0 if around.note is None else 2.0


@case(*[(Range(Pair(1.0, 2.0), 3), 0.5), (Range(Pair(3.0, -2.0), 0), 1.5)])
def entries_of_tuples(around: Range, x: float) -> tuple[Any, ...]:
    chosen = around.pair if x > 1.0 else Pair(x, x)
    either = Pair(x, 1) if around.times > 1 else Pair(-1, x)
    k = 7
    pair = Pair(*(number * x for number in around.pair))
    turned = Pair._make(pair[1 - k] + k for k in range(len(Pair._fields)))
    total, weights = 0.0, (1.0, 2.0, 4.0)
    for place, number in enumerate((*pair, *turned[1:])):
        total += weights[place] * number
    for place, (low, high) in enumerate((pair, turned)):
        total = weights[place] * (total - low) + high
    return *turned, *around[:1][0], total, k, len(around[1:]), chosen.low, width(chosen, 1.5), *either, around.times


def scaled_by(factor: float, pair: Pair) -> Kernel:
    def scaled(x: float) -> float:
        return factor * x + pair.high

    return scaled


TWICE, THRICE = scaled_by(2.0, Pair(0.0)), scaled_by(3.0, Pair(0.0, 1.0))


def product(pair: Pair, x: float) -> float:
    return pair.low * x  # which knows the sign of zero


def doubled(x: Any) -> Any:
    return x + x  # of its own type


@case(*[(3, 0.1), (-2, -2.5)])
def functions_by_what_they_are_given(n: int, x: float) -> tuple[Any, ...]:
    types = doubled(n) // 4, doubled(x), doubled(int(x > 0.0)) // 2, doubled(np.float64(n)) / 4
    return *types, TWICE(x), THRICE(TWICE(x)), product(Pair(0.0, 1.0), x), product(Pair(-0.0, 1.0), x)


ELEMENTARY: dict[Kernel, list[tuple[float, float]]] = {
    exponential: [(-800.0, 800.0)],
    sine_cosine: [(-1e6, 1e6)],
    polar_angle: [(-1e100, 1e100), (-1e100, 1e100)],
}
"""Elementary functions, each with the ranges of its arguments."""


@pytest.mark.filterwarnings("ignore:.*overflow:RuntimeWarning")  # NumPy's own, of `wrapped`
@pytest.mark.parametrize("name", CASES)
def test_the_kernel_in_c_is_the_kernel_in_python(name: str):
    if name == "wrapped" and ENGINE == "checked":
        with pytest.raises(ValueError, match="beyond 64 bits"):
            CASES.check(name)
    else:
        CASES.check(name)


@pytest.mark.parametrize("function", ELEMENTARY, ids=lambda function: function.__name__)
def test_an_elementary_function_in_python_and_compiled(function: Any):
    in_python = getattr(function, "py_func", function)
    in_c: Any = compiled(in_python)

    @examples(200)
    @given(st.tuples(*(st.floats(low, high) for low, high in ELEMENTARY[function])))
    def check(arguments: tuple[float, ...]) -> None:
        assert same(in_c(*arguments), in_python(*arguments)), arguments

    check()
    assert not in_c._refused, "it does not run as C"
