"""What a function is translated in: its variables, their types, and the lines written so far."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from beltarm_env.engine.translation.numbers import bare
from beltarm_env.engine.translation.reading import located
from beltarm_env.engine.translation.types import (
    INT,
    SMALL,
    Array,
    ArrayType,
    Const,
    Group,
    Lazy,
    Record,
    RecordType,
    Scalar,
    Size,
    TranslationError,
    Value,
    joined,
    shown_type,
)
from beltarm_env.engine.translation.whole import may_wrap, span

WORDS = set(
    "auto break case char const continue default do double else enum extern float for goto if inline int long register "
    "restrict return short signed sizeof static struct switch typedef union unsigned void volatile while bool true "
    "false NULL NAN INFINITY ROUNDER INT64_MIN errno linux stderr stdin stdout unix".split()
)
"""Keywords of C and macros of headers and compilers, which no field may be called either."""
RESERVED = WORDS | set(
    "real main self memset R PRECISE int8_t int16_t int32_t int64_t uint8_t uint16_t uint32_t uint64_t size_t y0 y1 "
    "yn j0 j1 jn gamma signgam exp log sin cos tan pow round floor ceil sqrt fabs fmod floorf ceilf sqrtf fabsf fmodf "
    "isnan isfinite isinf square cube fourth_power floor_div floor_mod real_sqrt real_floor real_ceil real_fmod "
    "real_abs real_sign real_mod real_floor_div real_max real_min float_max float_min int_max int_min int_abs int_add "
    "int_sub int_mul int_of int_at int_cut INT64_C heap result_ shift_left shift_right".split()
)
"""Names that mean something else in C, or in the headers of the programs."""

_UNPLACED = re.compile(r'CHECKED_AT\((?!")')
PREFIX = "k_"
"""Of the names of functions, so that they never meet those of variables."""


@dataclass
class Local:
    """Variable of C."""

    kind: Any  # type of a number, a struct or an array
    text: str  # declaration
    within: tuple[int, ...] | None = None  # branches and loops that it is set in; None is outside all loops


@dataclass
class Scope:
    """Names and lines of one function."""

    program: Any
    outside: dict[str, Any] = field(default_factory=dict)  # globals and what a closure holds
    kinds: dict[str, Any] = field(default_factory=dict)  # types of variables, from pass to pass
    negative: set[str] = field(default_factory=set)  # whole numbers that may be, from pass to pass
    names: dict[str, Value] = field(default_factory=dict)
    exits: list[dict[str, Value]] = field(default_factory=list)  # names at each break and continue of a loop
    locals: dict[str, Local] = field(default_factory=dict)
    lines: list[str] = field(default_factory=list)
    line: int = 0
    counter: int = 0
    loops: int = 0
    blocks: int = 0  # branches and loops of the program so far
    within: tuple[int, ...] = ()  # those that the translation is in
    changed: bool = False
    taken: set[str] = field(default_factory=set)
    places: dict[str, str] = field(default_factory=dict)  # names of C of the kernel's variables
    counters: set[str] = field(default_factory=set)  # of loops, which are over before what is made of them is
    parameters: dict[str, Any] = field(default_factory=dict)  # names of C and types
    assigned: dict[str, int] = field(default_factory=dict)  # how often each variable is, but by loops
    forms: dict[str, Any] = field(default_factory=dict)  # of variables that are assigned more than once
    source: Any = None  # function whose statements are translated
    uses_heap: bool = False

    def write(self, text: str) -> None:
        """Write a line; checks in it say where they are."""
        if self.program.checked:
            text = _UNPLACED.sub(lambda _: f'CHECKED_AT("{located(self.source, self.line)}", ', text)
        self.lines.append(text)

    def apart(self, action: Callable[[], Any]) -> tuple[Any, list[str]]:
        """Return what an action returns, and the lines that it writes, which are not written yet."""
        before, self.lines = self.lines, []
        try:
            found = action()
            return found, self.lines
        finally:
            self.lines = before

    def c_name(self, name: str) -> str:
        """Find a name of C for a variable."""
        name = re.sub(r"\W", "_", "".join(one if one.isascii() else f"u{ord(one):x}_" for one in name))
        wanted = f"{name}_" if name in RESERVED or name in self.program.taken else name
        while wanted in self.taken:
            wanted += "_"
        self.taken.add(wanted)
        self.program.locals.add(wanted)
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
        self.locals[name] = Local(kind, text, self.within if self.loops else None)
        return name

    def kept(self, value: Any) -> Any:
        """Compute a number now, into a variable."""
        return self._copied(value) if isinstance(value, Scalar) and not value.code.isidentifier() else value

    def held(self, value: Any) -> Any:
        """Compute a value now, unless it is one that no later assignment or call changes."""
        if isinstance(value, Group):
            return Group(value.make, tuple((name, self.held(part)) for name, part in value.fields))
        if isinstance(value, Lazy):
            return self.copy_of(value)
        if isinstance(value, Scalar | Record | Array) and self.changes(value):
            return self._copied(value)
        return value

    def copy_of(self, source: Lazy) -> Array:
        """Compute an array expression now, into an array of its own."""
        raise NotImplementedError

    def changes(self, value: Any) -> bool:
        """Tell whether an expression may give something else later: it reads memory, or a variable set again."""
        if isinstance(value, Group):
            return any(self.changes(part) for _, part in value.fields)
        if not isinstance(value, Scalar | Record | Array):
            return False
        if re.search(r"\[|->", value.code):
            return True
        parts = (*value.shape, *value.strides) if isinstance(value, Array) else ()
        text = " ".join([value.code, *map(str, parts)])
        again = {place for name, place in self.places.items() if self.often(name)}
        return not again.isdisjoint(re.findall(r"[A-Za-z_]\w*", text))

    def stays(self, array: Array) -> bool:
        """Tell whether an array has a name of C, and is what a name that is set here stands for, as long as it does."""
        texts = (array.code, *map(str, (*array.shape, *array.strides)))
        return array.code.isidentifier() and not self.changes(array) and not any(map(self.set_without, texts))

    def set_without(self, text: str) -> bool:
        """Tell whether a loop counts by a variable of C of an expression, or may set it and not come to this block."""
        for name in re.findall(r"[A-Za-z_]\w*", text) if self.loops else ():
            within = self.locals[name].within if name in self.locals else None
            if name in self.counters or (within is not None and within[: len(self.within)] != self.within):
                return True
        return False

    def often(self, name: str) -> bool:
        """Tell whether a variable, or one of its parts, is assigned more than once."""
        return self.assigned.get(name.partition(".")[0], 0) > 1

    def _copied(self, value: Any) -> Any:
        if isinstance(value, Array):
            value = self.steady(value)
        name = self.fresh(type_of(value), "t")
        self.write(f"{name} = {bare(value.code)};")
        return replace(value, code=name)

    def steady(self, array: Array) -> Array:
        """Compute lengths and strides of an array into variables that nothing else changes."""
        shape, strides = map(self.stable, array.shape), map(self.stable, array.strides)
        return replace(array, shape=tuple(shape), strides=tuple(strides))

    def common_shape(self, a: tuple[Size, ...], b: tuple[Size, ...], message: str) -> tuple[Size, ...]:
        """Shape that two arrays have to have in common; checked by the program where it computes them.

        Raises:
            TranslationError: If they are known to differ, with `message` about both.
        """
        if a == b:
            return a
        unknown = [m != n and not (isinstance(m, int) and isinstance(n, int)) for m, n in zip(a, b, strict=False)]
        if len(a) != len(b) or not all(m == n or x for m, n, x in zip(a, b, unknown, strict=True)):
            raise TranslationError(message.format(a, b))
        if not self.program.runs_here:
            raise TranslationError(f"{message.format(a, b)}, which the program computes: take known lengths")
        for m, n, differs in zip(a, b, unknown, strict=True):
            if differs:
                self.write(f'CHECK_EQUAL({bare(str(m))}, {bare(str(n))}, "{located(self.source, self.line)}");')
        return tuple(n if isinstance(n, int) else m for m, n in zip(a, b, strict=True))

    def stable(self, size: Size) -> Size:
        """Compute a length into a variable that nothing else changes."""
        length = Scalar(INT, str(size))
        if isinstance(size, int):
            return size
        if size.isidentifier() and not self.changes(length) and not self.set_without(size):
            return size
        return self._copied(length).code

    def spanned(self, name: str, kind: Any, value: Any) -> tuple[int, int] | None:
        """Span of a variable that is assigned a value; of one that is assigned again, its sign alone is known."""
        if kind not in (SMALL, INT) or not isinstance(value, Scalar):
            return None
        low, high = span(value)
        if not self.often(name):
            return low, high
        if (low < 0 or may_wrap(value)) and name not in self.negative:
            self.negative.add(name)
            self.changed = True
        return None if name in self.negative else (0, span(Scalar(kind, name))[1])

    def unify(self, name: str, kind: Any) -> Any:
        """Type that a variable has, given that it is assigned one of `kind`."""
        if name not in self.kinds:
            self.kinds[name] = kind
        try:
            common = joined(self.kinds[name], kind)
        except TranslationError:
            shown = f"{shown_type(self.kinds[name])} to {shown_type(kind)}"
            raise TranslationError(f"{name} changes its type from {shown}: take two names") from None
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
        strides = tuple(stride if isinstance(stride, int) else None for stride in value.strides)
        return ArrayType(value.dtype, shape, strides, value.constant)
    if isinstance(value, Const | Group):
        raise TranslationError("a number or an array is expected")
    raise TranslationError("an array expression must be written into an array: a[:] = ...")
