"""A program of C: a function for each kernel and each choice of types that it is called with, structs and tables."""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from eval.translation import arrays
from eval.translation.function import Function, NotReturnableError
from eval.translation.numbers import NUMBERS, bare, cast, dtype_of_number, literal, scalar
from eval.translation.reading import assignments, place, placed, tree_of
from eval.translation.scope import PREFIX, RESERVED, type_of
from eval.translation.statements import Statements
from eval.translation.tidy import text_of
from eval.translation.types import (
    INT,
    SMALL,
    Array,
    ArrayType,
    Const,
    ConstType,
    Group,
    GroupType,
    NotConstantError,
    Record,
    RecordType,
    Scalar,
    TranslationError,
    Value,
    dtype_of,
    key_of,
)
from eval.translation.whole import natural, span


class Program:
    """Functions that have been translated, in an order in which each comes after those that it calls.

    Args:
        overrides: Values of global names that the program has in place of the kernels' own: `{"LANES": 1}`.
    """

    def __init__(self, overrides: dict[str, Any] | None = None) -> None:
        self.overrides = overrides or {}
        self.functions: dict[Any, tuple[str, Any, Any, Const | None]] = {}  # C name, type, span, known value
        self._texts: dict[str, str] = {}  # of functions, by name
        self._roots: set[str] = set()  # functions that none of the others calls
        self.structs: dict[RecordType, str] = {}
        self.struct_texts: list[str] = []
        self.tables: dict[Any, tuple[str, str]] = {}
        self.taken: set[str] = set(RESERVED)
        self.locals: set[str] = set()  # names of variables, which no table takes
        self._kept: list[Any] = []  # so that no identity is used twice
        self._running: list[Any] = []
        self._written: dict[str, str] = {}  # text to name: functions that differ in types alone may be the same

    def struct(self, kind: RecordType) -> str:
        """Name of a struct, declared at its first use."""
        if kind not in self.structs:
            fields = [
                f"    {self.struct(of) if isinstance(of, RecordType) else of} {name};" for name, of in kind.fields
            ]
            name = self._free(kind.name)
            self.structs[kind] = name
            self.struct_texts.append("\n".join(["typedef struct {", *fields, f"}} {name};"]))
        return self.structs[kind]

    def table(self, values: np.ndarray, name: str) -> Array:
        """Put a known array into the program, once."""
        dtype = dtype_of(values.dtype)
        key = (dtype, values.shape, values.tobytes())
        if key not in self.tables:
            label = self._free(re.sub(r"\W", "_", name.lstrip("_")).upper() or "TABLE")
            numbers = [literal(number, dtype) for number in values.ravel()]
            rows = textwrap.wrap(", ".join(numbers), 112, break_long_words=False)
            body = "\n".join(f"    {row}" for row in rows)
            size = max(values.size, 1)
            self.tables[key] = (label, f"static const {dtype} {label}[{size}] = {{ /* {_shape(values)} */\n{body}\n}};")
        shape = tuple(map(int, values.shape))
        label = self.tables[key][0]
        return Array(dtype, shape, arrays.contiguous(shape), label, constant=True, memory=label)

    def used_tables(self) -> list[str]:
        """Declarations of the tables that functions read; the others were known number by number."""
        text = "\n".join(self.texts)
        return [declared for label, declared in self.tables.values() if re.search(rf"\b{label}\b", text)]

    @property
    def texts(self) -> list[str]:
        """Functions; not those that were translated for types that a variable has no more."""
        needed, found = set(self._roots), []
        for name, text in reversed(self._texts.items()):
            if name in needed:
                needed.update(re.findall(rf"\b{PREFIX}\w+(?=\()", text))
                found.insert(0, text)
        return found

    def _free(self, name: str) -> str:
        wanted, k = name, 2
        while wanted in self.taken or wanted in self.locals:
            wanted, k = f"{name}_{k}", k + 1
        self.taken.add(wanted)
        return wanted

    # ---- calls -------------------------------------------------------------------------------------------------

    def call(self, caller: Statements, function: Callable[..., Any], values: list[Value]) -> Value:
        """Translate a call: of a function that is translated for these types, or written out where it is called."""
        name, kind, spanned, known, passed = self._translated(function, values, caller)
        if name is None:
            return self._written_out(caller, function, values)
        if not self._running:
            self._roots.add(name)
        call = f"{name}({', '.join(passed)})"
        if isinstance(kind, ConstType) or kind is None:
            caller.write(f"{call};")
            return known or Const(None)
        place = caller.fresh(kind, "t")
        caller.write(f"{place} = {call};")
        return Record(kind, place) if isinstance(kind, RecordType) else Scalar(kind, place, spanned)

    def _translated(
        self, function: Callable[..., Any], values: list[Value], caller: Statements
    ) -> tuple[str | None, Any, Any, Const | None, list[str]]:
        for static in (False, True):
            kinds = tuple(self._argument_type(value, static, caller) for value in values)
            known_memory: dict[str, int] = {}
            key = (function, kinds, tuple(_facts(values, known_memory)))
            if key not in self.functions:
                if key in self._running:
                    raise TranslationError(f"{function.__name__} calls itself")
                try:
                    self._running.append(key)
                    self.functions[key] = self._specialised(function, kinds, values, known_memory)
                except NotConstantError:
                    if static:
                        raise
                    continue
                except NotReturnableError:
                    self.functions[key] = ("", None, None, None)
                finally:
                    self._running.remove(key)
            name, kind, spanned, known = self.functions[key]
            if not name:
                return None, None, None, None, []
            passed = [code for value, of in zip(values, kinds, strict=True) for code in self._passed(value, of, caller)]
            return name, kind, spanned, known, passed
        raise AssertionError

    def _argument_type(self, value: Value, static: bool, caller: Statements) -> Any:
        if isinstance(value, Const):
            if isinstance(value.value, NUMBERS):
                whole = isinstance(value.value, int | np.integer)
                return ConstType(key_of(value.value)) if static and whole else scalar(value).dtype
            if isinstance(value.value, np.ndarray):
                return type_of(self.table(value.value, value.name))
            self._kept.append(value.value)
            return ConstType(key_of(value.value))
        if isinstance(value, Group):
            record = caller.record(value)
            if record is not None:
                return record.type
            return GroupType(value.make, tuple((k, self._argument_type(v, static, caller)) for k, v in value.fields))
        return type_of(value)

    def _passed(self, value: Value, kind: Any, caller: Statements) -> Iterable[str]:
        if isinstance(kind, ConstType):
            return
        if isinstance(kind, GroupType):
            assert isinstance(value, Group)
            for (_, part), (_, of) in zip(value.fields, kind.fields, strict=True):
                yield from self._passed(part, of, caller)
        elif isinstance(kind, RecordType):
            yield bare(caller.as_record(value, kind))
        elif isinstance(kind, ArrayType):
            array = self.table(value.value, value.name) if isinstance(value, Const) else value
            assert isinstance(array, Array)
            yield bare(array.code)
            yield from (bare(arrays.text(size)) for size in array.shape if not isinstance(size, int))
        else:
            yield bare(cast(value, kind).code)

    # ---- functions ---------------------------------------------------------------------------------------------

    def _specialised(
        self, function: Callable[..., Any], kinds: tuple[Any, ...], values: list[Value], memory: dict[str, int]
    ) -> tuple[str, Any, Any, Const | None]:
        tree = tree_of(function)
        remembered: dict[str, Any] = {}
        negative: set[str] = set()
        returned: Any = None
        while True:  # until no variable changes its type any more
            body = self._body(function, tree, remembered)
            body.negative, body.returned = negative, returned
            parameters: list[str] = []
            for argument, kind, value in zip(tree.args.args, kinds, values, strict=True):
                body.names[argument.arg] = self._parameter(body, argument.arg, kind, value, parameters, memory)
            try:
                body.finish(body.block(tree.body))
            except TranslationError as error:
                raise placed(error, function, body.line) from None
            except (ArithmeticError, AssertionError, AttributeError, LookupError, TypeError, ValueError) as error:
                found = TranslationError(f"{type(error).__name__}: {error}")  # of what is known: of Python itself
                raise placed(found, function, body.line) from error
            if not body.changed:
                break
            returned = body.returned
        name = PREFIX + function.__name__.strip("_")
        text = text_of(function, name, body, parameters)
        if text not in self._written:
            self._written[text] = self._free(name)
            self._texts[self._written[text]] = text.replace(f"{name}(", f"{self._written[text]}(", 1)
        return self._written[text], body.returned, body.span, body.known

    def _body(self, function: Callable[..., Any], tree: ast.FunctionDef, kinds: dict[str, Any]) -> Function:
        closure = inspect.getclosurevars(function)
        outside = {**function.__globals__, **closure.nonlocals, **self.overrides}
        body = Function(self, outside, self.overrides, kinds)
        body.assigned = assignments(tree)
        return body

    def _parameter(
        self, body: Function, name: str, kind: Any, value: Value, parameters: list[str], memory: dict[str, int]
    ) -> Value:
        """Declare a parameter; what a group holds becomes several."""
        if isinstance(kind, ConstType):
            return value
        if isinstance(kind, GroupType):
            assert isinstance(value, Group)
            parts = [
                (field, self._parameter(body, f"{name}_{field}", of, part, parameters, memory))
                for (field, of), (_, part) in zip(kind.fields, value.fields, strict=True)
            ]
            return Group(kind.make, tuple(parts))
        place = body.c_name(name)
        often = bool(body.assigned.get(name))
        if isinstance(kind, ArrayType):
            parameters.append(f"{'const ' if kind.constant else ''}{kind.dtype} *{place}")
            shape: list[Any] = list(kind.shape)
            for axis, size in enumerate(shape):
                if size is None:
                    shape[axis] = body.c_name(f"{place}_length")
                    parameters.append(f"int32_t {shape[axis]}")
            body.parameters[place] = kind
            body.places[name] = place
            if often:
                shape = list(body.lengths(name, tuple(shape), body.unify(name, kind)))
            of = "" if (isinstance(value, Array) and not value.memory) or often else f"<{_number(value, memory)}>"
            return Array(kind.dtype, tuple(shape), kind.strides, place, kind.constant, memory=of)
        parameters.append(f"{self.struct(kind) if isinstance(kind, RecordType) else kind} {place}")
        body.parameters[place] = kind
        given = Scalar(str(kind), place)
        if kind in (SMALL, INT) and natural(scalar(value)):
            given = replace(given, span=(0, span(given)[1]))
        if often:
            common = body.unify(name, kind)
            if common != kind:  # it becomes a wider number: a variable of its own
                wide = body.c_name(name)
                body.places[name] = wide
                body.declare(wide, common)
                body.write(f"{wide} = {cast(given, common).code};")
                return Scalar(common, wide, body.spanned(name, common, given))
            body.places[name] = place
        if isinstance(kind, RecordType):
            return Record(kind, place)
        return replace(given, span=body.spanned(name, kind, given))

    def _written_out(self, caller: Statements, function: Callable[..., Any], values: list[Value]) -> Value:
        """Evaluate a function that is one return statement, in the place of its call."""
        tree = tree_of(function)
        body = [s for s in tree.body if not (isinstance(s, ast.Expr) and isinstance(s.value, ast.Constant))]
        if len(body) != 1 or not isinstance(body[0], ast.Return) or body[0].value is None:
            raise TranslationError(f"{place(function)} returns an array: write it into an argument instead")
        inner = inspect.getclosurevars(function)
        names, outside, line = caller.names, caller.outside, caller.line
        caller.names = {a.arg: value for a, value in zip(tree.args.args, values, strict=True)}
        caller.outside = {**function.__globals__, **inner.nonlocals, **self.overrides}
        try:
            return caller.value(body[0].value)
        except TranslationError as error:
            raise placed(error, function, caller.line) from None
        finally:
            caller.names, caller.outside, caller.line = names, outside, line


def _facts(values: Iterable[Value], memory: dict[str, int]) -> Iterable[Any]:
    """What a function is translated for beside types: which arguments are not negative, and which share memory."""
    for value in values:
        if isinstance(value, Group):
            yield tuple(_facts([part for _, part in value.fields], memory))
        elif isinstance(value, Array):
            yield _number(value, memory) if value.memory else None
        elif isinstance(value, Scalar) and value.dtype in (SMALL, INT):
            yield natural(value)
        elif isinstance(value, Const) and isinstance(value.value, NUMBERS):
            yield dtype_of_number(value.value) in (SMALL, INT) and value.value >= 0


def _number(value: Value, memory: dict[str, int]) -> int:
    """Number of the memory that an array is a part of; a known array has its own."""
    return memory.setdefault(value.memory if isinstance(value, Array) else f"known {len(memory)}", len(memory))


def _shape(values: np.ndarray) -> str:
    return " by ".join(map(str, values.shape)) or "one number"
