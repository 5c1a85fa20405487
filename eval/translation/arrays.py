"""Arrays of the translation: views, elements, and expressions over all elements."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np

from eval.translation.numbers import NUMBERS, bare, scalar
from eval.translation.types import (
    INT,
    Array,
    Const,
    Lazy,
    Scalar,
    Size,
    TranslationError,
    dtype_of,
)

Table = Callable[[np.ndarray, str], Array]  # puts a known array into the program


def contiguous(shape: tuple[int, ...]) -> tuple[int, ...]:
    """Strides of an array whose elements lie side by side, the last axis first."""
    strides, step = [], 1
    for size in reversed(shape):
        strides.insert(0, step)
        step *= size
    return tuple(strides)


def text(size: Size) -> str:
    """Write a length or an offset."""
    return str(size)


def plus(a: Size, b: Size) -> Size:
    """Add two offsets, as far as they are known."""
    if isinstance(a, int) and isinstance(b, int):
        return a + b
    if a == 0:
        return b
    return a if b == 0 else f"({a} + {b})"


def times(a: Size, b: int) -> Size:
    """Multiply an offset by a known number."""
    if isinstance(a, int):
        return a * b
    return a if b == 1 else f"({a} * {b})"


def size_of(value: Any) -> Size:
    """Turn a whole number into an offset."""
    if isinstance(value, Const):
        if not isinstance(value.value, int | np.integer):
            raise TranslationError(f"an index must be a whole number, not {value.value!r}")
        return int(value.value)
    number = scalar(value)
    if number.dtype != INT:
        raise TranslationError(f"an index must be a whole number, not {number.dtype}")
    return number.code


def less(stop: Size, start: Size) -> Size:
    """Length of a slice."""
    if isinstance(stop, int) and isinstance(start, int):
        return max(stop - start, 0)
    if start == 0:
        return stop
    prefix = f"({start} + "
    if isinstance(stop, str) and stop.startswith(prefix) and stop.endswith(")"):
        rest = stop[len(prefix) : -1]
        return int(rest) if rest.isdigit() else rest
    return f"({stop} - {start})"


def sized(value: Size) -> Any:
    """Turn a length into a value."""
    return Const(value) if isinstance(value, int) else Scalar(INT, value)


def view(array: Array, index: list[Any]) -> Array | Scalar:
    """Index an array by whole numbers and (start, stop) pairs; None in a pair is the end."""
    if len(index) > len(array.shape):
        raise TranslationError(f"{len(index)} indices for an array of {len(array.shape)} axes")
    offset: Size = 0
    shape, strides = [], []
    for axis, (size, stride) in enumerate(zip(array.shape, array.strides, strict=True)):
        at = index[axis] if axis < len(index) else (None, None)
        if isinstance(at, tuple):
            start = 0 if at[0] is None else _from_end(size_of(at[0]), size)
            stop = size if at[1] is None else _from_end(size_of(at[1]), size)
            if isinstance(size, int):
                start = min(start, size) if isinstance(start, int) else start
                stop = min(stop, size) if isinstance(stop, int) else stop
            offset = plus(offset, times(start, stride))
            shape.append(less(stop, start))
            strides.append(stride)
        else:
            number = size_of(at)
            if isinstance(number, int) and isinstance(size, int) and not -size <= number < size:
                raise TranslationError(f"index {number} is outside an axis of {size}")
            offset = plus(offset, times(_from_end(number, size), stride))
    if not shape:
        return Scalar(array.dtype, f"{array.code}[{bare(text(offset))}]")
    code = array.code if offset == 0 else f"({array.code} + {text(offset)})"
    return Array(array.dtype, tuple(shape), tuple(strides), code, array.constant, array.in_loop)


def _from_end(at: Size, size: Size) -> Size:
    """Count a negative index from the end."""
    return plus(size, at) if isinstance(at, int) and at < 0 else at


def element(array: Array, index: list[str]) -> Scalar:
    """Element at indices given as names of C."""
    offset: Size = 0
    for name, stride in zip(index, array.strides, strict=True):
        offset = plus(offset, times(name, stride))
    return Scalar(array.dtype, f"{array.code}[{bare(text(offset))}]")


def overwrites(target: Array, place: Scalar, source: Scalar) -> bool:
    """Tell whether writing the elements of a target one by one may change elements of the source still to be read."""
    found = re.match(r"\(?([\w>-]+)", target.code)
    root = re.escape(found[1]) if found else ""
    rest = source.code.replace(place.code, "")
    if not re.search(rf"(?<![\w.>]){root}\b", rest):
        return False
    begins = re.fullmatch(rf"\({root} \+ (\d+)\)|{root}", target.code)
    length = target.shape[0]
    if begins is None or len(target.shape) > 1 or not isinstance(length, int):
        return True
    first, index = int(begins[1] or 0), re.escape(place.code.removeprefix(target.code))
    others = re.sub(rf"(?:\({root} \+ (\d+)\)|(?<![\w.>]){root}){index}", lambda at: f"#{at[1] or 0}#", rest)
    if re.search(rf"(?<![\w.>]){root}\b", others):
        return True
    starts = [int(number) for number in re.findall(r"#(\d+)#", others)]
    return any(start < first < start + length * max(target.strides) for start in starts)


def lazy(value: Any, table: Table) -> Lazy | None:
    """See an array as its elements; None of a number."""
    if isinstance(value, Lazy):
        return value
    if isinstance(value, Const) and isinstance(value.value, np.ndarray):
        value = table(value.value, value.name)
    if isinstance(value, Array):
        array = value
        return Lazy(array.dtype, array.shape, lambda index: element(array, index))
    return None


def over_elements(operation: Callable[..., Any], operands: list[Any], table: Table) -> Lazy | None:
    """Expression over the elements of its operands, of which arrays have one shape; None if all are numbers.

    Raises:
        TranslationError: If shapes differ.
    """
    arrays = [lazy(operand, table) for operand in operands]
    shapes = {array.shape for array in arrays if array is not None}
    if not shapes:
        return None
    if len(shapes) > 1:
        raise TranslationError(f"array expressions take one shape, these are {sorted(map(str, shapes))}")
    shape = shapes.pop()

    def at(index: list[str]) -> Scalar:
        parts = [operand if array is None else array.at(index) for operand, array in zip(operands, arrays, strict=True)]
        return scalar(operation(*parts))

    return Lazy(at(["0"] * len(shape)).dtype, shape, at)


def known_array(value: Any) -> np.ndarray | None:
    """The array of a known value, or None."""
    return value.value if isinstance(value, Const) and isinstance(value.value, np.ndarray) else None


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
