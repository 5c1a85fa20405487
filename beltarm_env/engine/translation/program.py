"""A program of C: a function for each kernel and each choice of types that it is called with, structs and tables."""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
from collections.abc import Callable, Collection, Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from beltarm_env.engine.translation import arrays
from beltarm_env.engine.translation.known import named, shown
from beltarm_env.engine.translation.numbers import NUMBERS, bare, cast, dtype_of_number, literal, scalar
from beltarm_env.engine.translation.reading import assignments, place, placed, tree_of
from beltarm_env.engine.translation.scope import PREFIX, RESERVED, WORDS, type_of
from beltarm_env.engine.translation.statements import Function, NotReturnableError
from beltarm_env.engine.translation.tidy import text_of
from beltarm_env.engine.translation.types import (
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
from beltarm_env.engine.translation.whole import natural, span


class Program:
    """Functions that have been translated, in an order in which each comes after those that it calls.

    Args:
        overrides: Values of global names that the program has in place of the kernels' own: `{"LANES": 1}`.
        runs_here: Whether Python calls it: then it allocates memory, and checks lengths that it computes.
        checked: Whether it checks every index.
    """

    def __init__(self, overrides: dict[str, Any] | None = None, runs_here: bool = False, checked: bool = False) -> None:
        self.overrides = overrides or {}
        self.runs_here = runs_here
        self.checked = checked
        self.functions: dict[Any, tuple[str, Any, Any, Const | None]] = {}  # C name, type, span, known value
        self._texts: dict[str, str] = {}  # of functions, by name
        self._roots: set[str] = set()  # functions that none of the others calls
        self.read: dict[tuple[str, str], tuple[str, str]] = {}  # module, name: what was read, as `shown`
        self.told = True  # whether that is all that the program is made of, beside arguments
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
            if taken := WORDS & {name for name, _ in kind.fields}:
                raise TranslationError(f"the field {min(taken)} of {kind.name} means something else in C: rename it")
            fields = [
                f"    {self.struct(of) if isinstance(of, RecordType) else of} {name};" for name, of in kind.fields
            ]
            name = self._free(kind.name)
            self.structs[kind] = name
            self.struct_texts.append("\n".join(["typedef struct {", *fields, f"}} {name};"]))
        return self.structs[kind]

    def note(self, module: str, name: str, value: Any, constants: Collection[str] = ()) -> None:
        """Note what a name of a module stood for, unless it is one of the constants that the kernel has instead."""
        words = shown(value), shown(value, codes=False)
        if words[0] and words[0] == shown(named(module, name)):
            self.told &= self.read.setdefault((module, name), words) == words
        elif name not in constants:
            self.told = False

    def table(self, values: np.ndarray, name: str) -> Array:
        """Put a known array into the program, once."""
        dtype = dtype_of(values.dtype)
        key = (dtype, values.shape, values.tobytes())
        if key not in self.tables:
            label = self._free(re.sub(r"\W", "_", name.lstrip("_")).upper() or "TABLE")
            numbers = [literal(number, dtype) for number in values.ravel()]
            rows = textwrap.wrap(", ".join(numbers), 112, break_long_words=False)
            body = "\n".join(f"    {row}" for row in rows)
            shown_shape = " by ".join(map(str, values.shape)) or "one number"
            head = f"static const {dtype} {label}[{max(values.size, 1)}] = {{ /* {shown_shape} */"
            self.tables[key] = (label, f"{head}\n{body}\n}};")
        shape = tuple(map(int, values.shape))
        label = self.tables[key][0]
        return Array(dtype, shape, arrays.contiguous(shape), label, constant=True, memory=label, checked=self.checked)

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

    def call(self, caller: Function, function: Callable[..., Any], values: list[Value]) -> Value:
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
        self, function: Callable[..., Any], values: list[Value], caller: Function
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

    def _argument_type(self, value: Value, static: bool, caller: Function) -> Any:
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

    def _passed(self, value: Value, kind: Any, caller: Function) -> Iterable[str]:
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
            for given, known in ((array.shape, kind.shape), (array.strides, kind.strides)):
                yield from (bare(str(size)) for size, of in zip(given, known, strict=True) if of is None)
        else:
            yield bare(cast(value, kind).code)

    # ---- functions ---------------------------------------------------------------------------------------------

    def _specialised(
        self, function: Callable[..., Any], kinds: tuple[Any, ...], values: list[Value], memory: dict[str, int]
    ) -> tuple[str, Any, Any, Const | None]:
        tree = self._tree(function)
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
                _own_variables(body, [name for name, value in body.names.items() if isinstance(value, Const | Group)])
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

    def _tree(self, function: Callable[..., Any]) -> ast.FunctionDef:
        self.note(function.__module__, function.__qualname__, inspect.unwrap(function))
        return tree_of(function)

    def _body(self, function: Callable[..., Any], tree: ast.FunctionDef, kinds: dict[str, Any]) -> Function:
        closure = inspect.getclosurevars(function)
        outside = {**function.__globals__, **closure.nonlocals, **self.overrides}
        body = Function(self, outside, kinds)
        body.assigned, body.source = assignments(tree), function
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
            sizes: list[list[Any]] = [list(kind.shape), list(kind.strides)]
            for found, word in zip(sizes, ("length", "stride"), strict=True):
                for axis, size in enumerate(found):
                    if size is None:
                        found[axis] = body.c_name(f"{place}_{word}{axis or ''}")
                        parameters.append(f"int64_t {found[axis]}")
            body.parameters[place] = kind
            body.places[name] = place
            of = "" if (isinstance(value, Array) and not value.memory) or often else f"<{_number(value, memory)}>"
            shape, strides = map(tuple, sizes)
            given = Array(kind.dtype, shape, strides, place, kind.constant, memory=of, checked=self.checked)
            if often:
                shape, strides = body.lengths(name, given, body.unify(name, kind))
            return replace(given, shape=shape, strides=strides)
        parameters.append(f"{self.struct(kind) if isinstance(kind, RecordType) else kind} {place}")
        body.parameters[place] = kind
        number = Scalar(str(kind), place)
        if kind in (SMALL, INT) and natural(scalar(value)):
            number = replace(number, span=(0, span(number)[1]))
        if often:
            common = body.unify(name, kind)
            if common != kind:  # it becomes a wider number: a variable of its own
                wide = body.c_name(name)
                body.places[name] = wide
                body.declare(wide, common)
                body.write(f"{wide} = {cast(number, common).code};")
                return Scalar(common, wide, body.spanned(name, common, number))
            body.places[name] = place
        if isinstance(kind, RecordType):
            return Record(kind, place)
        return replace(number, span=body.spanned(name, kind, number))

    def _written_out(self, caller: Function, function: Callable[..., Any], values: list[Value]) -> Value:
        """Translate a function whose last statement alone returns, in the place of its call."""
        tree = self._tree(function)
        body, last = tree.body[:-1], tree.body[-1]
        returns = [node for node in ast.walk(tree) if isinstance(node, ast.Return)]
        if len(returns) != 1 or not isinstance(last, ast.Return) or last.value is None:
            raise TranslationError(f"{place(function)} returns an array, but not at its end alone: return it there")
        inner = inspect.getclosurevars(function)
        values = [caller.held(value) for value in values]
        of_caller = {name: getattr(caller, name) for name in _OF_A_BODY}
        caller.names = {a.arg: value for a, value in zip(tree.args.args, values, strict=True)}
        caller.outside = {**function.__globals__, **inner.nonlocals, **self.overrides}
        caller.places, caller.forms, caller.assigned, caller.source = {}, {}, assignments(tree), function
        caller.kinds = caller.kinds.setdefault(f"<{function.__name__} {caller.counter}>", {})
        try:
            _own_variables(caller, list(caller.names))
            caller.block(body)
            return caller.value(last.value)
        except TranslationError as error:
            raise placed(error, function, caller.line) from None
        finally:
            for name, value in of_caller.items():
                setattr(caller, name, value)


def _own_variables(body: Function, parameters: list[str]) -> None:
    """Give variables of their own to parameters that the function assigns again."""
    for name in parameters:
        if body.often(name):
            body.assign(ast.Name(name), body.names[name])


_OF_A_BODY = ("names", "outside", "line", "places", "forms", "assigned", "source", "kinds")
"""What a scope has of the one function whose statements it translates at the moment."""


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
