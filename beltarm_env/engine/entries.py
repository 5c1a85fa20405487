"""Entries of compiled kernels: the C that takes what Python gives, calls a translated function, and gives its result.

The types of a call alone decide about the C: numbers, arrays by their type, axes and layout, named tuples of these.
What is None, a function or a word is known in the program. Lengths are computed by it, so one entry serves batches of
every size. See `c/glue.c` for the words in which types are written.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from beltarm_env.engine.translation import arrays
from beltarm_env.engine.translation.numbers import NUMBERS, bare, scalar
from beltarm_env.engine.translation.program import Program
from beltarm_env.engine.translation.reading import place
from beltarm_env.engine.translation.statements import Function
from beltarm_env.engine.translation.tidy import releasing, without_unused
from beltarm_env.engine.translation.types import (
    BOOL,
    INT,
    REAL,
    UNSIGNED,
    Array,
    Const,
    Group,
    Record,
    Scalar,
    TranslationError,
    Value,
    dtype_of,
    make_of,
    parts_of,
)
from beltarm_env.engine.translation.whole import WHOLE

SYMBOL = "beltarm_kernel"
_TAKEN = (
    "p r n out heap Slot fail HeapArray beltarm_entry beltarm_failure beltarm_heap heap_mark heap_release heap_array "
    "given_array checked_at checked_add checked_sub checked_mul setjmp longjmp jmp_buf malloc free memcpy memmove abs "
    "abort exit div rand time plus_rounder INLINED EXPORT BEYOND"
).split()
"""Names of `c/engine.h`, and of what it includes."""
_LETTERS = {"float64": "d", "float32": "f", "int64": "l", "bool": "?", "int8": "b", "uint64": "L"}
_DTYPES = {letter: np.dtype(name) for name, letter in _LETTERS.items()}


def types_of(arguments: tuple[Any, ...]) -> tuple[str, tuple[Any, ...]]:
    """Words for the types of a call, and the classes and known values that they refer to.

    Raises:
        TranslationError: If an argument is nothing that a kernel takes.
    """
    constants: list[Any] = []
    return "".join(_type_of(argument, constants) for argument in arguments), tuple(constants)


def _type_of(argument: Any, constants: list[Any]) -> str:
    if argument is None:
        return "0"
    if isinstance(argument, bool):
        return "b"
    if isinstance(argument, int):
        return "n"
    if isinstance(argument, float):
        return "d"
    if isinstance(argument, tuple):
        constants.append(type(argument))
        return f"({''.join(_type_of(entry, constants) for entry in argument)})"
    if isinstance(argument, np.ndarray) and argument.dtype.name in _LETTERS and argument.dtype.isnative:
        flags = argument.flags
        layout = "cC" if flags.c_contiguous else "sS"
        return f"a{_LETTERS[argument.dtype.name]}{argument.ndim}{layout[not flags.writeable]}"
    if callable(argument) or isinstance(argument, str):
        constants.append(argument)
        return "k"
    kind = argument.dtype if isinstance(argument, np.ndarray) else type(argument).__name__
    raise TranslationError(f"kernels take numbers, arrays of {', '.join(_LETTERS)} and tuples of these, not {kind}")


@dataclass
class Entry:
    """Text of the C of a kernel for one choice of types, and what its result is."""

    text: str
    returns: str
    result: Any  # as `made`
    read: dict[tuple[str, str], tuple[str, str]] | None  # see `Program`; None: not all is told


def entry_of(function: Callable[..., Any], arguments: tuple[Any, ...], checked: bool = False) -> Entry:
    """Translate a kernel for arguments of the types that these have.

    Args:
        function: What Python would run.
        arguments: Of a call.
        checked: Whether the program checks every index.

    Raises:
        TranslationError: If it cannot be translated.
    """
    names = [*inspect.signature(function).parameters, *("more" for _ in arguments)]
    kinds, negative = dict[str, Any](), set[str]()
    while True:  # until no variable of a kernel that is written out here changes its type any more
        program = Program(runs_here=True, checked=checked)
        program.taken.update(_TAKEN)
        scope = Function(program, {}, kinds, negative, source=function)
        taken = _Taken(scope)
        values = [taken.value(name, argument) for name, argument in zip(names, arguments, strict=False)]
        given = _Given(scope, {array.memory for array in taken.arrays}, values[-1] if values else None)
        result = given.give(program.call(scope, function, values))
        if not scope.changed:
            break
    text = "\n".join([*program.struct_texts, *program.used_tables(), *program.texts])
    lines = without_unused(scope)
    fails = checked or any(
        word in text or word in "".join(lines) for word in ("CHECK_", "heap_array", "given_array", "fail(")
    )
    head = f"EXPORT const char *{SYMBOL}(void *const *p, const double *r, const int64_t *n, Slot *out)\n{{"
    opening = ["(void)p, (void)r, (void)n, (void)out;", *(["TAKE_FAILURES;"] if fails else []), *taken.lines]
    body = [*opening, *(releasing(lines, "void") if scope.uses_heap else lines), "return NULL;"]
    parts = [
        f"/* {place(function)} */",
        "#define BELTARM_CHECKED" if checked else "",
        '#include "engine.h"',
        *program.struct_texts,
        *program.used_tables(),
        *program.texts,
        "\n".join([head, *(f"    {line}" for line in body), "}"]),
    ]
    return Entry("\n\n".join(filter(None, parts)) + "\n", given.code, result, program.read if program.told else None)


@dataclass
class _Taken:
    """Arguments as values of the translation, and the lines that take them from what Python gives."""

    scope: Function
    lines: list[str] = field(default_factory=list)
    arrays: list[Array] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=lambda: {"p": 0, "r": 0, "n": 0})

    def value(self, name: str, argument: Any) -> Value:
        if argument is None or callable(argument) or isinstance(argument, str):
            return Const(argument)
        if isinstance(argument, tuple):
            make = type(argument) if hasattr(argument, "_fields") else None
            names = getattr(argument, "_fields", None) or [f"f{k}" for k in range(len(argument))]
            parts = [(key, self.value(f"{name}_{key}", part)) for key, part in zip(names, argument, strict=True)]
            return Group(make, tuple(parts))
        if isinstance(argument, np.ndarray):
            return self._array(name, argument)
        if isinstance(argument, bool):
            return Scalar(BOOL, self._take("bool", name, "n", " != 0"))
        if isinstance(argument, int):
            return Scalar(INT, self._take("int64_t", name, "n"))
        return Scalar(REAL, self._take("real", name, "r"))

    def _array(self, name: str, argument: np.ndarray) -> Array:
        constant, dtype = not argument.flags.writeable, dtype_of(argument.dtype)
        code = self._take(f"{'const ' if constant else ''}{dtype} *", name, "p")
        shape = tuple(self._take("int64_t", f"{name}_length{k or ''}", "n") for k in range(argument.ndim))
        strides = arrays.contiguous(shape)
        if not argument.flags.c_contiguous:
            strides = tuple(self._take("int64_t", f"{name}_stride{k or ''}", "n") for k in range(argument.ndim))
        array = Array(dtype, shape, strides, code, constant, memory=code, checked=self.scope.program.checked)
        self.arrays.append(array)
        return array

    def _take(self, kind: str, name: str, source: str, suffix: str = "") -> str:
        place, index = self.scope.c_name(name), self.counts[source]
        self.counts[source] += 1
        self.lines.append(f"{kind if kind.endswith('*') else f'{kind} '}{place} = {source}[{index}]{suffix};")
        return place


@dataclass
class _Given:
    """Lines that give a result to Python, and the words for its type."""

    scope: Function
    arguments: set[str]  # memory that arguments are
    last: Value | None  # argument
    code: str = ""
    slots: int = 0

    def give(self, value: Value) -> Any:
        """Give a value, and return what `made` makes the result of."""
        if isinstance(value, Const) and value.value is None:
            self.code += "0"
            return None
        if isinstance(value, Const) and isinstance(value.value, np.ndarray):
            value = self.scope.table(value.value, value.name)
        if isinstance(value, Const) and isinstance(value.value, NUMBERS):
            value = scalar(value)
        if isinstance(value, Scalar):
            self._number(value)
            return None
        if isinstance(value, Array):
            return self._array(value)
        make = make_of(value)
        if not isinstance(value, Group | Record | Const):
            raise TranslationError("a kernel that Python calls returns numbers, arrays and tuples of these")
        if make is dict and isinstance(value, Group | Record):
            return self._dict(value)
        self.code += "("
        parts = [self.give(part) for part in parts_of(value)]
        self.code += ")"
        parts = parts if any(parts) else []  # numbers alone need nothing
        return ("tuple", make, parts) if make is not None or parts else None

    def _dict(self, value: Group | Record) -> None:
        fields = value.fields if isinstance(value, Group) else value.type.fields
        self.code += f"{{{','.join(name for name, _ in fields)}:"
        if any(self.give(part) is not None or self.code[-1] not in "dnbL" for part in parts_of(value)):
            raise TranslationError("a dict that a kernel returns has numbers alone")
        self.code += "}"

    def _number(self, number: Scalar) -> None:
        number = scalar(number)
        letter = {BOOL: "b", UNSIGNED: "L"}.get(number.dtype, "n" if number.dtype in WHOLE else "d")
        member = "d" if letter == "d" else "n"
        self.code += letter
        self._put(member, f"(int64_t)({number.code})" if letter == "L" else bare(number.code))

    def _array(self, array: Array) -> Any:
        if array == self.last:
            self.code += "o"
            return None
        if array.memory in (*self.arguments, ""):
            raise TranslationError("it returns what may be a view of an argument: return a copy")
        if array.strides != arrays.contiguous(array.shape):
            copy = self.scope.allocate([arrays.sized(size) for size in array.shape], array.dtype)
            self.scope.fill(copy, array)
            array = copy
        letter = next((letter for letter, dtype in _DTYPES.items() if dtype_of(dtype) == array.dtype), None)
        if letter is None:
            raise TranslationError(f"it returns an array of {array.dtype}: return one of int64")
        self.code += f"A{letter}{len(array.shape)}"
        self._put("p", f"given_array({array.code}, sizeof({array.dtype}), {arrays.count_of(array.shape)})")
        for size in array.shape:
            self._put("n", str(size))
        return ("array", letter)

    def _put(self, member: str, code: str) -> None:
        self.scope.write(f"out[{self.slots}].{member} = {code};")
        self.slots += 1


def made(result: Any, given: Any) -> Any:
    """Make arrays and named tuples of what a kernel gives: `result` says which."""
    if result is None:
        return given
    if result[0] == "array":
        data, shape = given
        return np.ndarray(shape, _DTYPES[result[1]], data)
    _, make, parts = result
    entries = [made(part, entry) for part, entry in zip(parts, given, strict=True)] if parts else given
    return tuple(entries) if make is None else make(*entries)
