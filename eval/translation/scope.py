"""What a function is translated in: its variables, their types, and the lines written so far."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from eval.translation.numbers import bare
from eval.translation.types import (
    Array,
    ArrayType,
    Const,
    Group,
    Record,
    RecordType,
    Scalar,
    TranslationError,
    Value,
    joined,
)

RESERVED = set(
    "auto break case char const continue default do double else enum extern float for goto if inline int long register "
    "restrict return short signed sizeof static struct switch typedef union unsigned void volatile while bool true "
    "false real square cube main y0 y1 yn j0 j1 jn gamma signgam exp log sin cos tan floor ceil sqrt fabs".split()
)
"""Names that mean something else in C."""

PREFIX = "k_"
"""Of the names of functions, so that they never meet those of variables."""


@dataclass
class Local:
    """Variable of C."""

    kind: Any  # type of a number, a struct or an array
    text: str  # declaration


@dataclass
class Scope:
    """Names and lines of one function."""

    program: Any
    outside: dict[str, Any]  # globals and what a closure holds
    overrides: dict[str, Any]
    kinds: dict[str, Any] = field(default_factory=dict)  # types of variables, from pass to pass
    names: dict[str, Value] = field(default_factory=dict)
    locals: dict[str, Local] = field(default_factory=dict)
    lines: list[str] = field(default_factory=list)
    line: int = 0
    counter: int = 0
    loops: int = 0
    changed: bool = False
    taken: set[str] = field(default_factory=set)
    places: dict[str, str] = field(default_factory=dict)  # names of C of the kernel's variables
    parameters: dict[str, Any] = field(default_factory=dict)  # names of C and types
    assigned: dict[str, int] = field(default_factory=dict)  # how often each variable is, but by loops
    loop_names: list[str] = field(default_factory=list)

    def write(self, text: str) -> None:
        """Write a line."""
        self.lines.append(text)

    def apart(self, action: Callable[[], Any]) -> tuple[Any, list[str]]:
        """Return what an action returns, and the lines that it writes, which are not written yet."""
        before, self.lines = self.lines, []
        try:
            found = action()
            return found, self.lines
        finally:
            self.lines = before

    def read(self, name: str) -> Value:
        """Value of a variable."""
        return self.names[name]

    def c_name(self, name: str) -> str:
        """Find a name of C for a variable."""
        name = re.sub(r"\W", "_", name)
        wanted = f"{name}_" if name in RESERVED or name in self.program.taken else name
        while wanted in self.taken:
            wanted += "_"
        self.taken.add(wanted)
        return wanted

    def fresh(self, kind: Any, stem: str) -> str:
        """Declare a variable that the kernel does not have."""
        self.counter += 1
        return self.declare(self.c_name(f"{stem}_{self.counter}"), kind)

    def declare(self, name: str, kind: Any) -> str:
        """Declare a variable of C."""
        if name in self.parameters:
            return name
        if isinstance(kind, RecordType):
            text = f"{self.program.struct(kind)} {name} = {{0}};"
        elif isinstance(kind, ArrayType):
            text = f"{'const ' if kind.constant else ''}{kind.dtype} *{name} = NULL;"
        else:
            text = f"{kind} {name} = {'false' if kind == 'bool' else '0'};"
        self.locals[name] = Local(kind, text)
        return name

    def kept(self, value: Any) -> Any:
        """Compute a number now, into a variable."""
        if isinstance(value, Scalar) and not value.code.isidentifier():
            name = self.fresh(value.dtype, "t")
            self.write(f"{name} = {bare(value.code)};")
            return Scalar(value.dtype, name)
        return value

    def unify(self, name: str, kind: Any) -> Any:
        """Type that a variable has, given that it is assigned one of `kind`."""
        if name not in self.kinds:
            self.kinds[name] = kind
        common = joined(self.kinds[name], kind)
        if common != self.kinds[name]:
            self.kinds[name], self.changed = common, True
        return common

    def table(self, values: np.ndarray, name: str) -> Array:
        """Put a known array into the program."""
        return self.program.table(values, name)


def type_of(value: Value) -> Any:
    """Type of a value that a variable of C can hold, or a group of such."""
    if isinstance(value, Scalar):
        return value.dtype
    if isinstance(value, Record):
        return value.type
    if isinstance(value, Array):
        shape = tuple(size if isinstance(size, int) else None for size in value.shape)
        return ArrayType(value.dtype, shape, value.strides, value.constant)
    if isinstance(value, Const | Group):
        raise TranslationError("a number or an array is expected")
    raise TranslationError("an array expression must be written into an array: a[:] = ...")
