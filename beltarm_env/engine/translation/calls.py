"""Calls in a kernel: of other kernels, of named tuples, of the functions of Python and NumPy that are translated."""

from __future__ import annotations

import ast
import inspect
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from beltarm_env.engine import words
from beltarm_env.engine.translation import arrays
from beltarm_env.engine.translation.expressions import Expressions
from beltarm_env.engine.translation.numbers import bare, cast, constant, scalar
from beltarm_env.engine.translation.scope import Local
from beltarm_env.engine.translation.types import (
    BOOL,
    INT,
    REAL,
    SINGLE,
    SMALL,
    UNSIGNED,
    Array,
    Const,
    Group,
    Lazy,
    Scalar,
    TranslationError,
    Value,
    dtype_of,
    joined,
    make_of,
    parts_of,
    reads_memory,
    shown,
)
from beltarm_env.engine.translation.whole import LEAST, MOST, WHOLE, span, whole

LARGEST = 512
"""Most numbers of an array that a function allocates: on the stack of a small processor."""


class Calls(Expressions):
    """Evaluation of calls."""

    def _call(self, node: ast.Call) -> Value:
        if isinstance(node.func, ast.Attribute):
            method = self._method(node)
            if method is not None:
                return method
        called = self.value(node.func)
        function: Any = getattr(called.value, "py_func", called.value) if isinstance(called, Const) else None
        if function is None:
            raise TranslationError(f"only known functions are called: {ast.unparse(node)}")
        values = self.entries([*node.args, *(keyword.value for keyword in node.keywords)])
        first = len(values) - len(node.keywords)
        given = values[:first]
        named = dict(zip([str(keyword.arg) for keyword in node.keywords], values[first:], strict=True))
        if hasattr(function, "_field_defaults"):
            return self.tuple_of(_ordered(function._fields, function._field_defaults, given, named), function)
        if function in TRANSLATED:
            return TRANSLATED[function](self, *given, **named)
        if inspect.isfunction(function) and function.__module__.split(".")[0] not in ("numpy", "math"):
            return self.call(function, given, named)
        raise TranslationError(f"{ast.unparse(node.func)} is not translated: {ast.unparse(node)}")

    def _method(self, node: ast.Call) -> Value | None:
        """Evaluate `.copy()` of an array, and `_replace()` and `_make()` of named tuples; None of anything else."""
        assert isinstance(node.func, ast.Attribute)
        if node.func.attr == "copy" and not node.args:
            owner = self.value(node.func.value)
            source = arrays.lazy(owner, self.table)
            if source is not None:
                return self.copy_of(source)
        if node.func.attr == "reshape":
            owner = self.value(node.func.value)
            if isinstance(owner, Array) and len(owner.shape) == 1 and list(map(ast.unparse, node.args)) == ["1", "-1"]:
                (size,), (stride,) = owner.shape, owner.strides
                return replace(owner, shape=(1, size), strides=(arrays.times(size, stride), stride))
        if node.func.attr == "_make":
            owner, (entries,) = self.value(node.func.value), node.args
            make: Any = owner.value if isinstance(owner, Const) else None
            if hasattr(make, "_fields"):
                return self.tuple_of(_ordered(make._fields, {}, parts_of(self.value(entries)), {}), make)
        if node.func.attr == "_replace":
            owner, *values = self.in_order([node.func.value, *(keyword.value for keyword in node.keywords)])
            changed = dict(zip([str(keyword.arg) for keyword in node.keywords], values, strict=True))
            make = make_of(owner)
            if make is not None:
                _require_known(changed, make._fields)
                old = dict(zip(make._fields, parts_of(owner), strict=True))
                return self.tuple_of([changed.get(name, old[name]) for name in make._fields], make)
        return None

    def call(self, function: Callable[..., Any], given: list[Value], named: dict[str, Value]) -> Value:
        """Call another kernel."""
        parameters = inspect.signature(function).parameters
        defaults = {name: p.default for name, p in parameters.items() if p.default is not inspect.Parameter.empty}
        values = _ordered(tuple(parameters), defaults, given, named)
        return self.program.call(self, function, values)

    def allocate(self, shape: Sequence[Value], dtype: str) -> Array:
        """Declare an array on the stack; a large one, or one of a length that the program computes, on the heap."""
        if not self.program.runs_here:
            shape = [Const(constant(size)) for size in shape]
        sizes = tuple(int(size.value) if isinstance(size, Const) else self.kept(size).code for size in shape)
        count = arrays.count_of(sizes)
        self.counter += 1
        name = self.c_name(f"a_{self.counter}")
        array = Array(dtype, sizes, arrays.contiguous(sizes), name, memory=name, checked=self.program.checked)
        within = self.within if self.loops else None
        if isinstance(count, int) and count <= LARGEST:
            self.locals[name] = Local(None, f"{dtype} {name}[{max(count, 1)}];", within)
            return replace(array, in_loop=self.loops > 0)
        if not self.program.runs_here:
            raise TranslationError(f"an array of {count} numbers is too large for the stack: take it as an argument")
        self.locals[name] = Local(None, f"{dtype} *{name} = NULL;", within)
        self.write(f"{name} = heap_array(sizeof({dtype}), {bare(str(count))});")
        self.uses_heap = True
        return array

    def copy_of(self, source: Lazy) -> Array:
        """Compute an array expression now, into an array of its own."""
        copy = self.allocate([arrays.sized(size) for size in source.shape], source.dtype)
        self._each(copy, source)
        return copy

    def fill(self, target: Array, value: Value) -> None:
        """Write a number into all elements of an array, or an array expression of its shape."""
        if target.constant:
            raise TranslationError("what is constant is not assigned to")
        if isinstance(value, Array) and reads_memory(value):  # its place is that before the first element is written
            value = self.held(value)
        source = arrays.lazy(value, self.table)
        if source is not None:
            self.common_shape(target.shape, source.shape, "an array of shape {} cannot take one of {}")
        if source is None and isinstance(value, Scalar):
            value = self.kept(value)
        if source is not None and arrays.overwrites(target, source):  # NumPy reads all first
            source = arrays.lazy(self.copy_of(source), self.table)
        self._each(target, value if source is None else source)

    def _each(self, target: Array, value: Value) -> None:
        """Write the elements of an array one by one."""
        self.counter += 1
        names = [self.c_name(f"e{axis}_{self.counter}") for axis in range(len(target.shape))]
        for depth, (name, size) in enumerate(zip(names, target.shape, strict=True)):
            indent = "    " * depth
            kind = INT if isinstance(size, str) else SMALL
            self.write(f"{indent}for ({kind} {name} = 0; {name} < {size}; ++{name}) {{")
        number = value.at(names) if isinstance(value, Lazy) else value
        place = arrays.element(target, names)
        self.write(f"{'    ' * len(names)}{place.code} = {bare(cast(number, target.dtype).code)};")
        for depth in range(len(names) - 1, -1, -1):
            self.write(f"{'    ' * depth}}}")


def _require_known(named: dict[str, Value], names: tuple[str, ...]) -> None:
    """Refuse keywords that Python would refuse."""
    if unknown := set(named) - set(names):
        raise TranslationError(f"there is no parameter {min(unknown)} to be set by name")


def _ordered(
    names: tuple[str, ...], defaults: dict[str, Any], given: list[Value], named: dict[str, Value]
) -> list[Any]:
    """Arguments in the order of the parameters."""
    if len(given) > len(names):
        raise TranslationError(f"{len(given)} arguments for {len(names)} parameters")
    _require_known(named, names[len(given) :])
    values = list(given)
    for name in names[len(given) :]:
        if name in named:
            values.append(named[name])
        elif name in defaults:
            values.append(Const(defaults[name]))
        else:
            raise TranslationError(f"argument {name!r} is missing")
    return values


def _largest(_: Calls, *values: Value) -> Value:
    return _chosen(max, values)


def _least(_: Calls, *values: Value) -> Value:
    return _chosen(min, values)


def _chosen(function: Callable[..., Any], values: tuple[Value, ...]) -> Value:
    """The largest or least of some numbers, as Python chooses it: the later one only if it is beyond."""
    name = function.__name__
    if len(values) < 2:
        raise TranslationError(f"{name} takes two numbers or more")
    if all(isinstance(value, Const) for value in values):
        return Const(function(constant(value) for value in values))
    found: Value = values[0]
    for value in values[1:]:
        a, b = scalar(found), scalar(value)
        dtype = joined(a.dtype, b.dtype)
        if dtype in (BOOL, UNSIGNED):
            raise TranslationError(f"{name} of two numbers of type {dtype} is not translated: write a condition")
        a, b = cast(a, dtype), cast(b, dtype)
        kind = {REAL: "real", SINGLE: "float"}.get(dtype, "int")
        code = f"{kind}_{name}({bare(a.code)}, {bare(b.code)})"
        found = whole(code, *map(function, span(a), span(b))) if dtype in WHOLE else Scalar(dtype, code)
    return found


def _absolute(self: Calls, value: Value) -> Value:
    if isinstance(value, Const):
        return Const(abs(value.value))
    over = arrays.over_elements(lambda one: _absolute(self, one), [value], self)
    if over is not None:
        return over
    number = scalar(value)
    if number.dtype == BOOL:
        raise TranslationError("a bool has no sign: write int(a)")
    if number.dtype == UNSIGNED:
        return number
    if number.dtype in WHOLE:
        low, high = span(number)
        spanned = (LEAST, MOST) if low == LEAST else (0, max(-low, high))
        return number if low >= 0 else whole(f"int_abs({bare(number.code)})", *spanned)
    name = "real_abs" if number.dtype == REAL else "fabsf"
    return Scalar(number.dtype, f"{name}({bare(number.code)})")


def _length(self: Calls, value: Value) -> Value:
    if isinstance(value, Const):
        return Const(len(value.value))
    if isinstance(value, Array):
        return arrays.sized(value.shape[0])
    return Const(len(parts_of(value)))


def _range(self: Calls, *bounds: Value) -> Value:
    return Const(tuple(range(*map(constant, bounds))))


def _numbered(self: Calls, value: Value) -> Value:
    return self.tuple_of([self.tuple_of([Const(k), part]) for k, part in enumerate(parts_of(self.held(value)))])


def _converts(kind: Any, dtype: str) -> Callable[..., Value]:
    def convert(self: Calls, value: Value) -> Value:
        if isinstance(value, Const):
            return Const(kind(value.value))
        if dtype == BOOL:
            return Scalar(BOOL, f"({scalar(value).code} != 0)")
        return cast(value, SMALL if dtype == INT and scalar(value).dtype == BOOL else dtype)

    return convert


def _in_double(function: Callable[..., Value]) -> Callable[..., Value]:
    """Translate a function of Python, which computes in float64, by that of NumPy."""

    def of_double(self: Calls, value: Value) -> Value:
        return function(self, Const(float(value.value)) if isinstance(value, Const) else cast(value, REAL))

    return of_double


def _of_real(name: str, function: Callable[..., Any], dtype: str = REAL) -> Callable[..., Value]:
    def of_real(self: Calls, value: Value) -> Value:
        if isinstance(value, Const):
            return Const(function(value.value))
        if dtype == INT and isinstance(value, Scalar) and value.dtype in WHOLE:
            return cast(value, SMALL) if value.dtype == BOOL else value
        over = arrays.over_elements(lambda one: of_real(self, one), [value], self)
        if over is not None:
            return over
        single = dtype == REAL and scalar(value).dtype == SINGLE  # all are exact, or rounded once
        found = Scalar(BOOL if dtype == BOOL else REAL, f"{name}({bare(cast(value, REAL).code)})")
        return cast(found, SINGLE if single else dtype)

    return of_real


_FLOAT64 = Const(np.float64)


def _empty(self: Calls, shape: Value, dtype: Value = _FLOAT64) -> Value:
    several = isinstance(shape, Group) or (isinstance(shape, Const) and isinstance(shape.value, tuple))
    sizes = parts_of(shape) if several else [shape]
    return self.allocate(sizes, dtype_of(constant(dtype)))


def _zeros(self: Calls, shape: Value, dtype: Value = _FLOAT64) -> Value:
    return _full(self, shape, Const(0), dtype)


def _ones(self: Calls, shape: Value, dtype: Value = _FLOAT64) -> Value:
    return _full(self, shape, Const(1), dtype)


def _full(self: Calls, shape: Value, value: Value, dtype: Value = _FLOAT64) -> Value:
    made = _empty(self, shape, dtype)
    assert isinstance(made, Array)
    self.fill(made, value)
    return made


def _filled(self: Calls, shape: Value, value: Value, dtype: Value | None = None) -> Value:
    kind = {REAL: np.float64, SINGLE: np.float32, BOOL: np.bool_, UNSIGNED: np.uint64}.get(
        scalar(value).dtype, np.int64
    )
    return _full(self, shape, value, dtype or Const(kind))


def _slice(self: Calls, *ends: Value) -> Value:
    if len(ends) > 2:
        raise TranslationError("slices with a step are not translated")
    start, stop = ends if len(ends) == 2 else (Const(None), *ends)
    return Group(slice, (("start", start), ("stop", stop)))


def _add(self: Calls, words: Value, index: Value, more: Value) -> Value:
    name, word = self.fresh(INT, "before"), _word(words, index)
    self.write(f"{name} = __atomic_fetch_add(&{word}, {bare(cast(more, INT).code)}, __ATOMIC_SEQ_CST);")
    return Scalar(INT, name)


def _look(self: Calls, words: Value, index: Value) -> Value:
    name, word = self.fresh(INT, "seen"), _word(words, index)
    self.write(f"{name} = __atomic_load_n(&{word}, __ATOMIC_ACQUIRE);")
    return Scalar(INT, name)


def _word(words: Value, index: Value) -> str:
    """Element of an array, by its expression of C."""
    if not isinstance(words, Array):
        raise TranslationError(f"an array is expected, not {shown(words)}")
    return arrays.view(words, [index]).code


def _square(self: Calls, value: Value) -> Value:
    return self.combined(ast.Pow, value, Const(2))


TRANSLATED: dict[Any, Callable[..., Value]] = {
    **{max: _largest, min: _least, abs: _absolute, np.abs: _absolute, math.fabs: _in_double(_absolute)},
    **{len: _length, range: _range, enumerate: _numbered},
    **{int: _converts(int, INT), float: _converts(float, REAL), bool: _converts(bool, BOOL)},
    **{np.float64: _converts(float, REAL), np.float32: _converts(np.float32, SINGLE), np.int64: _converts(int, INT)},
    **{np.uint64: _converts(np.uint64, UNSIGNED), slice: _slice, words.add: _add, words.look: _look},
    **{np.sqrt: _of_real("real_sqrt", math.sqrt), math.sqrt: _in_double(_of_real("real_sqrt", math.sqrt))},
    **{np.floor: _of_real("real_floor", math.floor), np.ceil: _of_real("real_ceil", math.ceil)},
    **{math.floor: _of_real("real_floor", math.floor, INT), math.ceil: _of_real("real_ceil", math.ceil, INT)},
    **{np.sign: _of_real("real_sign", np.sign)},
    **{of: _of_real("isfinite", math.isfinite, BOOL) for of in (math.isfinite, np.isfinite)},
    **{of: _of_real("isnan", math.isnan, BOOL) for of in (math.isnan, np.isnan)},
    **{np.empty: _empty, np.zeros: _zeros, np.ones: _ones, np.full: _filled, np.square: _square},
}
"""Functions of Python, math and NumPy, and how each is translated."""
