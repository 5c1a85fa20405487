"""Types and values of the translation: what is known of an expression before the program runs.

Const      a Python value that is known: a number, a named tuple, a table, a function, a module, None
Scalar     a number that the program computes, by an expression of C
Record     a named tuple, or a tuple, of numbers: a struct of C
Array      a view of numbers in memory: a pointer, with shape and strides, each known or computed by the program
Group      a named tuple of anything else: exists while translating only, its parts are passed one by one
Lazy       elements of an expression over arrays, computed one by one where it is written into an array
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

REAL, SINGLE, INT, SMALL, BOOL = "real", "float", "int64_t", "int32_t", "bool"
UNSIGNED, BYTE = "uint64_t", "int8_t"
"""Types of numbers in C. `real` stands for float64, and for float32 in a program of single precision.

A whole number is an INT, or a SMALL one if it is known to fit (see `whole`); arrays have INT. An UNSIGNED one meets its
like alone. Arrays of BYTE keep whole numbers in little room: an element that is read is SMALL.
"""

DTYPES = {
    **{np.dtype(np.float64): REAL, np.dtype(np.float32): SINGLE, np.dtype(np.int64): INT, np.dtype(np.bool_): BOOL},
    **{np.dtype(np.uint64): UNSIGNED, np.dtype(np.int8): BYTE},
}
_OF_TUPLES = ("__add__", "__len__", "__getitem__", "__iter__", "__eq__", "__mul__")
Size = int | str  # a number, or an expression of C


class TranslationError(ValueError):
    """Error about a construct that cannot be translated; names function, file, line and construct."""


class NotConstantError(TranslationError):
    """Error about an expression that has to be known when translating, and is not."""


@dataclass(frozen=True)
class RecordType:
    """Type of a struct of C."""

    name: str
    fields: tuple[tuple[str, Any], ...]  # name and type of each, a number's or a struct's
    make: Any = None  # class of the named tuple; None for a tuple


@dataclass(frozen=True)
class ArrayType:
    """Type of a view; a length or stride of None is one that the program computes."""

    dtype: str
    shape: tuple[int | None, ...]
    strides: tuple[int | None, ...]
    constant: bool


@dataclass(frozen=True)
class GroupType:
    """Types of the parts of a group."""

    make: Any
    fields: tuple[tuple[str, Any], ...]


@dataclass(frozen=True)
class ConstType:
    """Type of a known value, which is known in the function that it is passed to as well."""

    key: Any


@dataclass(frozen=True)
class Const:
    """Known value; `name` is what a table is called in the program."""

    value: Any
    name: str = ""


@dataclass(frozen=True)
class Scalar:
    """Number that the program computes."""

    dtype: str
    code: str
    span: tuple[int, int] | None = None  # of a whole number: least and largest value; None is all of its type


@dataclass(frozen=True)
class Record:
    """Struct that the program computes."""

    type: RecordType
    code: str


@dataclass(frozen=True)
class Array:
    """View of memory."""

    dtype: str
    shape: tuple[Size, ...]
    strides: tuple[Size, ...]
    code: str
    constant: bool = False
    in_loop: bool = False  # allocated anew in each turn of a loop: must not be kept beyond it
    memory: str = ""  # what it is a part of; arrays of two names do not overlap; "" is anything
    checked: bool = False  # whether the program checks indices


@dataclass(frozen=True)
class Group:
    """Parts of a named tuple."""

    make: Any
    fields: tuple[tuple[str, Any], ...]


@dataclass(frozen=True)
class Lazy:
    """Elements of an array expression."""

    dtype: str
    shape: tuple[Size, ...]
    at: Callable[[list[str]], Scalar]
    reads: tuple[Array, ...] = ()  # arrays that it is made of


Value = Const | Scalar | Record | Array | Group | Lazy
UNSET = Const(object())
"""Of a name that has no value on one of the ways that meet."""


def dtype_of(dtype: Any) -> str:
    """Name the type of C for a type of NumPy.

    Raises:
        TranslationError: If it has none.
    """
    dtype = np.dtype(dtype)
    if dtype not in DTYPES:
        raise TranslationError(f"numbers of type {dtype} are not translated: take {', '.join(map(str, DTYPES))}")
    return DTYPES[dtype]


def shown_type(kind: Any) -> str:
    """Name a type in a message."""
    if isinstance(kind, ArrayType):
        sizes = " by ".join("n" if size is None else str(size) for size in kind.shape)
        return f"an array of {sizes} {kind.dtype}"
    return f"a tuple {kind.name}" if isinstance(kind, RecordType) else str(kind)


def shown(value: Any) -> str:
    """Name a value in a message."""
    if isinstance(value, Const):
        return repr(value.value) if len(repr(value.value)) < 60 else f"a {type(value.value).__name__}"
    if isinstance(value, Lazy):
        return "an array expression"
    if isinstance(value, Array):
        return f"an array of shape {value.shape}"
    if isinstance(value, Group | Record):
        make = value.make if isinstance(value, Group) else value.type.make
        return f"a {make.__name__}" if make is not None else "a tuple"
    return f"{value.code}, which the program computes" if isinstance(value, Scalar) else str(value)


def joined(a: Any, b: Any) -> Any:
    """Find the type that two types of one variable have in common: that of the wider number."""
    if a == b:
        return a
    order = [BOOL, SMALL, INT, SINGLE, REAL]
    if a in order and b in order:
        if SINGLE in (a, b) and (INT in (a, b) or SMALL in (a, b)):
            return REAL
        return max(a, b, key=order.index)
    if isinstance(a, ArrayType) and isinstance(b, ArrayType) and len(a.shape) == len(b.shape) and a.dtype == b.dtype:
        shape = tuple(m if m == n else None for m, n in zip(a.shape, b.shape, strict=True))
        strides = tuple(m if m == n else None for m, n in zip(a.strides, b.strides, strict=True))
        return ArrayType(a.dtype, shape, strides, a.constant or b.constant)
    if isinstance(a, RecordType) and isinstance(b, RecordType) and a.make is b.make:
        if [name for name, _ in a.fields] == [name for name, _ in b.fields]:
            fields = zip(a.fields, b.fields, strict=True)
            return record_type(a.make, tuple((name, joined(s, t)) for (name, s), (_, t) in fields))
    raise TranslationError(f"{shown_type(a)} and {shown_type(b)} have no type in common")


def record_type(make: Any, fields: tuple[tuple[str, Any], ...]) -> RecordType:
    """Make the type of a struct, called like its class, or like its entries' types."""
    require_plain(make)
    if make is not None:
        return RecordType(make.__name__.lstrip("_"), fields, make)
    short = {REAL: "r", SINGLE: "f", INT: "i", SMALL: "s", BOOL: "b", UNSIGNED: "u"}
    codes = "".join(short.get(kind, "") if isinstance(kind, str) else f"_{kind.name}_" for _, kind in fields)
    return RecordType(f"Tuple_{codes}".replace("__", "_").rstrip("_"), fields)


def is_named_tuple(value: Any) -> bool:
    """Tell whether a Python value is a named tuple."""
    return isinstance(value, tuple) and hasattr(value, "_fields")


def field_of(owner: Value, name: str) -> Value:
    """Field of a named tuple, by name."""
    if isinstance(owner, Record) and name in (kinds := dict(owner.type.fields)):
        return _member(f"{owner.code}.{name}", kinds[name])
    if isinstance(owner, Group) and name in (parts := dict(owner.fields)):
        return parts[name]
    raise TranslationError(f"no field {name!r}")


def reads_memory(value: Value) -> bool:
    """Tell whether a number, or one of a tuple, is an element of an array, or such places a view; or is Lazy."""
    if isinstance(value, Group):
        return any(reads_memory(part) for _, part in value.fields)
    if isinstance(value, Lazy):
        return True
    return isinstance(value, Scalar | Record | Array) and bool(re.search(r"\[|->", value.code))


def make_of(value: Value) -> Any:
    """Class of a named tuple; None of a tuple."""
    if isinstance(value, Const):
        return type(value.value) if is_named_tuple(value.value) else None
    return value.type.make if isinstance(value, Record) else getattr(value, "make", None)


def names_of(value: Value) -> list[str]:
    """Names of the entries of a tuple."""
    if isinstance(value, Const):
        return [name for name, _ in known_group(value).fields]
    return [name for name, _ in (value.type if isinstance(value, Record) else value).fields]  # pyright: ignore[reportAttributeAccessIssue]


def known_group(value: Const) -> Group:
    """A known tuple as its entries, each known."""
    make = make_of(value)
    names = make._fields if make else tuple(f"f{k}" for k in range(len(value.value)))
    return Group(make, tuple(zip(names, parts_of(value), strict=True)))


@cache
def require_plain(make: Any) -> None:
    """Refuse a class of named tuples that are not what tuples are."""
    if not hasattr(make, "_fields"):
        return
    own = [name for name in _OF_TUPLES if getattr(make, name) is not getattr(tuple, name)]
    of = next(k for k, base in enumerate(make.__mro__) if "_fields" in vars(base))
    own += ["__new__" for base in make.__mro__[:of] if "__new__" in vars(base)]
    if own:
        raise TranslationError(f"{make.__name__} has {own[0]} of its own, which is not translated: write a function")


def parts_of(value: Value) -> list[Value]:
    """Entries of a tuple."""
    require_plain(make_of(value))
    if isinstance(value, Group):
        return [part for _, part in value.fields]
    if isinstance(value, Record):
        return [_member(f"{value.code}.{name}", kind) for name, kind in value.type.fields]
    if isinstance(value, Const) and isinstance(value.value, tuple):
        names = getattr(value.value, "_fields", [""] * len(value.value))
        return [Const(part, f"{value.name}_{name}") for part, name in zip(value.value, names, strict=True)]
    raise TranslationError("a tuple is expected")


def _member(code: str, kind: Any) -> Value:
    return Record(kind, code) if isinstance(kind, RecordType) else Scalar(kind, code)


def key_of(value: Any) -> Any:
    """What tells known values apart."""
    if value is None or isinstance(value, str | int | float | bool):
        return (type(value).__name__, repr(value))  # 0.0 and -0.0 are two
    if isinstance(value, np.generic):
        return (type(value).__name__, repr(value.item()))
    if isinstance(value, tuple):
        return (type(value), *map(key_of, value))
    return id(value)
