"""What cannot be translated to C is refused, by function, file, line and construct."""

import importlib.util
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused

from beltarm_env.engine.translation.arrays import contiguous
from beltarm_env.engine.translation.program import Program
from beltarm_env.engine.translation.statements import Function
from beltarm_env.engine.translation.types import Array, NotConstantError, Scalar, TranslationError, dtype_of

HEAD = """
from typing import NamedTuple
import numpy as np

TABLE = np.arange(3.0)
HUGE = 2**63

class Pair(NamedTuple):
    low: float
    high: float

class Sum(Pair):
    def __add__(self, other):
        return Pair(self[0] + other[0], self[1] + other[1])

Word = NamedTuple("Word", [("short", float), ("low", float)])

def doubles(x):
    if x > 0.0:
        return np.zeros(2)
    return np.ones(2)

def grown(x): y = np.zeros(2); return y

def bumped(a):
    a[0] += 1.0
    return a[0]

def comprehension(x):
    return sum([x * k for k in range(3)])

def twice(x):
    return 2.0 * x
"""
ROW, WHOLES = np.arange(3.0), np.array([1, 2])
FRESH = "Pair(np.zeros(2), b)"
CASES: list[tuple[Any, tuple[Any, ...], str]] = [
    # words of the message; arguments a, b, c; lines of the kernel, `#` marking the one that is named
    (("a dict", "known['x']"), (1.0,), "known = {'x': a}; return known['x'] #"),
    (("keys of a dict", "{'x': a, 'x': 2.0}"), (1.0,), "return {'x': a, 'x': 2.0} #"),
    (("no type in common",), (1.0,), "if a > 0.0:;     return {'x': a}; return {'y': a}"),
    (("a choice between a Pair and a tuple",), (1.0,), "return (Pair(a, a) if a > 0.0 else (a, a))[0] #"),
    (("Sum has __add__ of its own",), (1.0,), "return (Sum(a, a) + Sum(a, a))[0] #"),
    (("must be written into an array before",), (ROW,), "both = (2.0 * a, 1.0) #; return both[1]"),
    (("a list comprehension", "[a * k for k in range(3)]"), (1.0,), "return sum([a * k for k in range(3)]) #"),
    (("a list comprehension", "(in comprehension, "), (1.0,), "return comprehension(a)"),
    (("a list is not",), (1.0,), "return [a, a][1] #"),
    (("a generator has one name, and no condition",), (1.0,), "return max(*(a * k for k in range(3) if k > 1)) #"),
    (("argument 'high' is missing",), (1.0,), "return Pair._make(a for k in range(1)) #; "),
    (("no parameter lo",), (1.0,), "return Pair(a, a)._replace(lo=a).low #"),
    (("a tuple is expected",), (ROW,), "return max(*(2.0 * value for value in a)) #"),
    (("a lambda",), (1.0,), "double = lambda y: 2.0 * y #; return double(a)"),
    (("a formatted string",), (1.0,), "return len(f'{a}') #"),
    (("a number is expected", "'one'"), (1.0,), "word = 'one'; return a + word #"),
    (("a try",), (1.0,), "try: #;     return 1.0 / a; except ZeroDivisionError:;     return 0.0"),
    (("a raise",), (1.0,), "if a > 0.0:;     raise ValueError #; return a"),
    (("a raise",), (1.0,), "if a > 0.0:;     raise ValueError(f'{a}') #; return a"),
    (("np.where", "np.where(a > 0.0, a, 0.0)"), (1.0,), "return np.where(a > 0.0, a, 0.0) #"),
    (("np.sin",), (1.0,), "return np.sin(a) #"),
    ((".sum is not", "a.sum"), (ROW,), "return a.sum() #"),
    (("MatMult",), (ROW,), "return a @ a #"),
    (("slices with a step", "::2"), (ROW,), "part = a[::2] #; return part[0]"),
    (("which the program computes", "known lengths"), (ROW, 2), "a[:b] = a[1:] #"),
    (("unknown name 'missing'",), (1.0,), "return missing(a) #"),
    (("kernel calls itself",), (1.0,), "return kernel(a - 1.0) if a > 0.0 else a #"),
    (("doubles returns an array", "at its end alone"), (1.0,), "made = doubles(a) #; return made[0]"),
    (("1024 numbers", "stack"), (1.0,), "work = np.zeros((32, 32)) #; return work[0, 0] + a"),
    (("has to be known",), (3,), "work = np.zeros(a + HUGE // HUGE); return work[0]"),
    (("kind changes its type",), (ROW, 1.0), "kind = b; if b > 0.0:;     kind = a #; return kind"),
    (("keeps an array",), (3,), "made = np.zeros(2); for _ in range(a):;     made = np.zeros(2) #; return made[0]"),
    (("loop allocates",), (ROW, 3), f"last = {FRESH}; for k in range(b):;     new = {FRESH};     last = new; return 1"),
    (("made must be written into an array",), (ROW,), "made = 2.0 * a #; return made[0]"),
    (("one shape", "(3,)", "(2,)"), (ROW,), "a[:2] = a + a[:2] #"),
    (("shape (2,)", "(3,)"), (ROW,), "a[:2] = a #"),
    (("shape",), (ROW, 1, 2), "a[:b] = a[:c]; return a[0]"),
    (("an array of shape",), (ROW,), "a[0:3] = (1.0, 2.0); return a[2]"),
    (("index 3 is outside",), (ROW,), "return a[3] #"),
    (("IndexError", "index 5"), (1.0,), "return TABLE[5] * a #"),
    (("2 indices", "1 axes"), (ROW,), "return a[0, 1] #"),
    (("a whole number",), (ROW, 1.0), "return a[b] #"),
    (("constant", "table[0]"), (1.0,), "table = TABLE; table[0] = a #"),
    (("9223372036854775808",), (3,), "return a + HUGE #"),
    (("powers", "0.5"), (1.0,), "return a**0.5 #"),
    (("ZeroDivisionError",), (1.0,), "return a + 1 // 0 #"),
    (("3 arguments for 2 parameters",), (1.0,), "return Pair(a, a, a).low #"),
    (("'high' is missing",), (1.0,), "return Pair(a).low #"),
    (("no field 'middle'",), (1.0,), "pair = Pair(a, a); return pair.middle #"),
    (("2 values for 3 targets",), (1.0,), "x, y, z = Pair(a, a) #; return x + y + z"),
    (("neither break nor continue",), (1.0,), "for x in (1.0, 2.0): #;     if a > x:;         break; return a"),
    (("and, or of numbers", "a or 1.0"), (1.0,), "return a or 1.0 #"),
    (("for ... else",), (1.0,), "for _ in range(3): #;     a += 1.0; else:;     a = 0.0; return a"),
    (("while ... else",), (3,), "k = 0; while k < a:;     k += 1; else:;     k = 100; return k"),
    (("whole numbers", "range(a)"), (1.0,), "for _ in range(a): #;     a += 1.0; return a"),
    (("step",), (3,), "total = 0; for k in range(0, a, 0):;     total += k; return total"),
    (("short", "in C"), (1.0,), "word = Word(a, a); for _ in range(3):;     word = Word(word.low, a); return word.low"),
    (("y is set on one way",), (1.0,), "if a > 0.0:;     y = 1.0; elif a < 0.0:;     y = -1.0; return y #"),
    (("y is set on one way",), (1.0,), "if a > 0.0:;     y = 1.0; made = grown(a); return made[0] + y #"),
    (("y is set on one way",), (3,), "for k in range(a):;     if k > 0:;         continue;     y = k; return y #"),
    (("before it is set",), (1.0,), "y = z + a #; z = y; return z"),
    (("max takes two numbers",), (ROW,), "return max(a) #"),
    (("in place",), (WHOLES, 0.5), "a += b; return a[0]"),
    (("int32",), (WHOLES.astype(np.int32),), "return a[0] + a[1]"),
    (("unsigned", "np.uint64(b"), (WHOLES.astype(np.uint64), 2), "return a[0] + b #"),
    (("Div", "uint64"), (WHOLES.astype(np.uint64),), "return a[0] / a[1] #"),
    (("two bools",), (np.array([True, True]),), "return a[0] + a[1]"),
    (("LShift",), (3,), "return a << 2"),
    (("take two names",), (3,), "x = None; for _ in range(a):;     x = 2.0 if x is None else x * 2.0; return x"),
    (("take two names",), (1.0,), "f = bumped; for _ in range(3):;     if a > 0.0:;         f = twice; return f(a)"),
    (("take two names",), (1.0,), "word = 'one'; if a > 0.0:;     word = 'two'; return 1.0 if word == 'one' else 2.0"),
    (("return on all ways",), (1.0,), "if a > 0.0:;     return 1.0"),
    (("chain",), (ROW,), "return 5.0 < a[0] < bumped(a)"),
]


@pytest.mark.parametrize("number", range(len(CASES)), ids=lambda number: CASES[number][0][0])
def test_refused(number: int, tmp_path: Path):
    words, given, text = CASES[number]
    count, path = len(given), tmp_path / f"refused_{number}.py"
    head = f"{HEAD}\ndef kernel({', '.join('abc'[:count])}):\n"
    lines = [f"    {line.removeprefix(' ')}" for line in text.split(";")]
    path.write_text(head + "\n".join(lines) + "\n")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = sys.modules[path.stem] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    first = head.count("\n") + 1
    marked = [k for k, line in enumerate(lines, first) if line.endswith("#")]
    place = [f"(in kernel, {path.name}, line {line})" for line in marked]

    def translate() -> None:
        program = Program()
        program.call(Function(program), module.kernel, [*map(value_of, "abc", given)])

    refused((TranslationError, NotConstantError), (*words, *place), translate)


def value_of(name: str, argument: Any) -> Scalar | Array:
    if isinstance(argument, np.ndarray):
        return Array(dtype_of(argument.dtype), argument.shape, contiguous(argument.shape), name, memory=name)
    return Scalar(dtype_of(type(argument)), name)
