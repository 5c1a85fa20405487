"""Arrays of the translation: views, elements, and expressions over all elements."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from beltarm_env.engine.translation.numbers import NUMBERS, bare, scalar
from beltarm_env.engine.translation.types import (
    INT,
    SMALL,
    Array,
    Const,
    Lazy,
    Scalar,
    Size,
    TranslationError,
    dtype_of,
    reads_memory,
)
from beltarm_env.engine.translation.whole import natural, span

Table = Callable[[np.ndarray, str], Array]  # puts a known array into the program


def contiguous(shape: tuple[Size, ...]) -> tuple[Size, ...]:
    """Strides of an array whose elements lie side by side, the last axis first."""
    strides: list[Size] = []
    step: Size = 1
    for size in reversed(shape):
        strides.insert(0, step)
        step = times(step, size)
    return tuple(strides)


def plus(a: Size, b: Size) -> Size:
    """Add two offsets, as far as they are known."""
    if isinstance(a, int) and isinstance(b, int):
        return a + b
    if a == 0:
        return b
    return a if b == 0 else f"({a} + {b})"


def times(a: Size, b: Size) -> Size:
    """Multiply two offsets, as far as they are known."""
    if isinstance(a, int) and isinstance(b, int):
        return a * b
    if 0 in (a, b):
        return 0
    return b if a == 1 else a if b == 1 else f"({a} * {b})"


def _whole(value: Any) -> int | Scalar:
    """Turn an index into a known number, or one that the program computes."""
    if isinstance(value, Const):
        if isinstance(value.value, bool | np.bool_) or not isinstance(value.value, int | np.integer):
            raise TranslationError(f"an index must be a whole number, not {value.value!r}")
        return int(value.value)
    number = scalar(value)
    if number.dtype not in (SMALL, INT):
        raise TranslationError(f"an index must be a whole number, not {number.dtype}")
    return number


def _at(value: Any, size: Size, checked: bool) -> Size:
    """Offset of an index, which counts from the end if it is negative.

    Raises:
        TranslationError: If it is known to lie outside the axis.
    """
    index = _whole(value)
    if isinstance(index, int) and isinstance(size, int):
        if not -size <= index < size:
            raise TranslationError(f"index {index} is outside an axis of {size}")
        return plus(size, index) if index < 0 else index
    if isinstance(index, Scalar):
        at: Size = index.code if natural(index) else f"int_at({bare(index.code)}, {bare(str(size))})"
    else:
        at = plus(size, index) if index < 0 else index
    return f"CHECKED_AT({bare(str(at))}, {bare(str(size))})" if checked else at


def _cut(value: Any, size: Size) -> Size:
    """Start or stop of a slice, cut at the ends of the axis as Python does."""
    index = _whole(value)
    if isinstance(index, int) and (isinstance(size, int) or index == 0):
        return slice(index).indices(size)[1] if isinstance(size, int) else 0
    if isinstance(index, Scalar) and isinstance(size, int) and natural(index) and span(index)[1] <= size:
        return index.code
    return f"int_cut({bare(index.code) if isinstance(index, Scalar) else index}, {bare(str(size))})"


def _between(start: Size, stop: Size) -> Size:
    """Length of a slice whose ends are cut."""
    if isinstance(stop, int) and isinstance(start, int):
        return max(stop - start, 0)
    if start == 0:
        return stop
    prefix = f"({start} + "
    if isinstance(stop, str) and stop.startswith(prefix) and stop[len(prefix) : -1].isdigit():
        return int(stop[len(prefix) : -1])
    return f"int_max({stop} - {start}, 0)"


def count_of(shape: tuple[Size, ...]) -> Size:
    """Multiply the lengths of a shape."""
    count: Size = 1
    for size in shape:
        count = times(count, size)
    return count


def sized(value: Size) -> Any:
    """Turn a length into a value."""
    return Const(value) if isinstance(value, int) else Scalar(SMALL, value, (0, 2**31 - 1))


def view(array: Array, index: list[Any]) -> Array | Scalar:
    """Index an array by whole numbers and (start, stop) pairs; None in a pair is the end."""
    if len(index) > len(array.shape):
        raise TranslationError(f"{len(index)} indices for an array of {len(array.shape)} axes")
    offset: Size = 0
    shape, strides = [], []
    for axis, (size, stride) in enumerate(zip(array.shape, array.strides, strict=True)):
        at = index[axis] if axis < len(index) else (None, None)
        if isinstance(at, tuple):
            start = 0 if at[0] is None else _cut(at[0], size)
            stop = size if at[1] is None else _cut(at[1], size)
            offset = plus(offset, times(start, stride))
            shape.append(_between(start, stop))
            strides.append(stride)
        else:
            offset = plus(offset, times(_at(at, size, array.checked), stride))
    if not shape:
        return Scalar(array.dtype, f"{array.code}[{bare(str(offset))}]")
    code = array.code if offset == 0 else f"({array.code} + {offset})"
    return replace(array, shape=tuple(shape), strides=tuple(strides), code=code)


def element(array: Array, index: list[str]) -> Scalar:
    """Element at indices given as names of C."""
    offset: Size = 0
    for name, stride in zip(index, array.strides, strict=True):
        offset = plus(offset, times(name, stride))
    return Scalar(array.dtype, f"{array.code}[{bare(str(offset))}]")


def overwrites(target: Array, source: Lazy) -> bool:
    """Tell whether writing the elements of a target one by one may change elements of the source still to be read."""
    return any(_meets(target, array) for array in source.reads)


def _meets(target: Array, read: Array) -> bool:
    if target.memory and read.memory and target.memory != read.memory:
        return False
    if (target.code, target.shape, target.strides) == (read.code, read.shape, read.strides):
        return False
    (root, first), (other, start), length = _origin(target), _origin(read), target.shape[0]
    stride = target.strides[0]
    if root != other or first is None or start is None or len(target.shape) > 1:
        return True
    if not isinstance(length, int) or not isinstance(stride, int):
        return True
    return target.strides != read.strides or start < first < start + length * stride


def _origin(array: Array) -> tuple[str, int | None]:
    """Pointer that an array begins at, and how many numbers behind it; None if the program computes that."""
    found = re.fullmatch(r"\(([\w>-]+) \+ (\d+)\)|([\w>-]+)", array.code)
    return (found[1] or found[3], int(found[2] or 0)) if found else (array.code, None)


def lazy(value: Any, table: Table) -> Lazy | None:
    """See an array as its elements; None of a number."""
    if isinstance(value, Lazy):
        return value
    if isinstance(value, Const) and isinstance(value.value, np.ndarray):
        value = table(value.value, value.name)
    if isinstance(value, Array):
        array = value
        return Lazy(array.dtype, array.shape, lambda index: element(array, index), (array,))
    return None


def over_elements(operation: Callable[..., Any], operands: list[Any], scope: Any) -> Lazy | None:
    """Expression over the elements of its operands, of which arrays have one shape; None if all are numbers.

    Raises:
        TranslationError: If shapes differ.
    """
    operands = [scope.held(one) if isinstance(one, Array) and reads_memory(one) else one for one in operands]
    arrays = [lazy(operand, scope.table) for operand in operands]
    shapes = [array.shape for array in arrays if array is not None]
    if not shapes:
        return None
    shape = shapes[0]
    for other in shapes[1:]:
        shape = scope.common_shape(shape, other, "array expressions take one shape, these are {} and {}")

    def at(index: list[str]) -> Scalar:
        parts = [operand if array is None else array.at(index) for operand, array in zip(operands, arrays, strict=True)]
        return scalar(operation(*parts))

    reads = tuple(part for array in arrays if array is not None for part in array.reads)
    return Lazy(at(["0"] * len(shape)).dtype, shape, at, reads)


def known_element(value: np.ndarray, index: list[Any]) -> Any:
    """Element or part of a known array at known indices, or None where they are not known."""
    keys = []
    for at in index:
        parts = at if isinstance(at, tuple) else (at,)
        if not all(part is None or isinstance(part, Const) for part in parts):
            return None
        known = [None if part is None else part.value for part in parts]
        keys.append(slice(*known) if isinstance(at, tuple) else known[0])
    found = value[tuple(keys)]
    return Const(found.item() if isinstance(found, NUMBERS) and dtype_of(value.dtype) != "float" else found)
