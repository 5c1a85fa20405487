"""Expressions of a kernel, from Python's syntax tree to values of the translation."""

from __future__ import annotations

import ast
import builtins
import inspect
import re
from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np

from beltarm_env.engine.translation import arrays
from beltarm_env.engine.translation.known import Missing, constants_of
from beltarm_env.engine.translation.numbers import NUMBERS, bare, binary, cast, condition, scalar, unary
from beltarm_env.engine.translation.scope import PREFIX, Scope
from beltarm_env.engine.translation.types import (
    BOOL,
    UNSET,
    Array,
    Const,
    Group,
    Lazy,
    Record,
    Scalar,
    TranslationError,
    Value,
    field_of,
    is_named_tuple,
    joined,
    make_of,
    names_of,
    parts_of,
    reads_memory,
    shown,
)
from beltarm_env.engine.translation.whole import either

WRITES = re.compile(rf"\b{PREFIX}\w+\(|__atomic_fetch_add|^[^=]*\] = ")
"""A line of C that may change what was read before: a call, or an assignment to an element."""


class Expressions(Scope):
    """Evaluation of expressions; statements that they need, such as calls, are written on the way."""

    def value(self, node: ast.expr) -> Value:
        """Evaluate an expression."""
        self.line = getattr(node, "lineno", self.line)
        method = getattr(self, f"_{type(node).__name__.lower()}", None)
        if method is None:
            raise TranslationError(f"{construct(node)} is not translated: {ast.unparse(node)}")
        return method(node)

    def _constant(self, node: ast.Constant) -> Value:
        return Const(node.value)

    def _name(self, node: ast.Name) -> Value:
        if self.names.get(node.id) is UNSET:
            raise TranslationError(f"{node.id} is set on one way and not on another: set it before they part")
        if node.id in self.names:
            return self.names[node.id]
        if node.id in self.assigned:
            raise TranslationError(f"{node.id} is used before it is set")
        if node.id in self.outside:
            value, constants = self.outside[node.id], constants_of(self.source)
            plain = getattr(value, "py_func", value)
            copied = constants and constants_of(plain) == constants  # with the same constants, which are told already
            read = inspect.unwrap(plain) if copied else value
            self.program.note(self.source.__module__, node.id, read, dict(constants))
            return Const(value, node.id)
        if hasattr(builtins, node.id):
            self.program.note(self.source.__module__, node.id, Missing)
            return Const(getattr(builtins, node.id), node.id)
        raise TranslationError(f"unknown name {node.id!r}")

    def _attribute(self, node: ast.Attribute) -> Value:
        owner = self.value(node.value)
        if isinstance(owner, Const):
            if isinstance(owner.value, np.ndarray) and node.attr == "shape":
                return Const(owner.value.shape)
            if node.attr in self.program.overrides:
                return Const(self.program.overrides[node.attr], node.attr)
            value, prefix = getattr(owner.value, node.attr), f"{owner.name}_" if is_named_tuple(owner.value) else ""
            if isinstance(owner.value, ModuleType):
                self.program.note(owner.value.__name__, node.attr, value)
            elif isinstance(owner.value, type):
                self.program.note(owner.value.__module__, f"{owner.value.__qualname__}.{node.attr}", value)
            elif not isinstance(owner.value, slice) and node.attr not in getattr(owner.value, "_fields", ()):
                self.program.told = False
            return Const(value, f"{prefix}{node.attr}")
        if isinstance(owner, Array) and node.attr == "shape":
            return Group(None, tuple((f"f{k}", arrays.sized(size)) for k, size in enumerate(owner.shape)))
        if isinstance(owner, Array | Lazy | Scalar):
            raise TranslationError(f".{node.attr} is not translated: {ast.unparse(node)}")
        return field_of(owner, node.attr)

    def _subscript(self, node: ast.Subscript) -> Value:
        owner = self.value(node.value)
        index = self.indices(node.slice)
        if isinstance(owner, Const) and isinstance(owner.value, np.ndarray):
            found = arrays.known_element(owner.value, index)
            if found is not None and isinstance(found.value, NUMBERS):
                return found
            owner = self.table(owner.value, owner.name)
        if isinstance(owner, Array):
            found = arrays.view(owner, index)
            return scalar(found) if isinstance(found, Scalar) else found
        if isinstance(owner, Lazy):
            raise TranslationError(f"an array expression cannot be indexed: {ast.unparse(node)}")
        if make_of(owner) is dict:
            raise TranslationError(f"a dict is for Python, and not read here: {ast.unparse(node)}")
        (at,) = index
        if isinstance(at, tuple) and all(end is None or isinstance(end, Const) for end in at):
            chosen = slice(*(end and end.value for end in at))
            return self.tuple_of(parts_of(owner)[chosen])
        if not isinstance(at, Const):
            if isinstance(owner, Const) and all(isinstance(entry, NUMBERS) for entry in owner.value):
                return arrays.view(self.table(np.array(owner.value), owner.name), index)
            raise TranslationError(f"a tuple is indexed by what is known only: {ast.unparse(node)}")
        if isinstance(owner, Const):
            return Const(owner.value[at.value])
        return parts_of(owner)[at.value]

    def indices(self, node: ast.expr) -> list[Any]:
        """Evaluate an index: values, and pairs of start and stop."""
        found: list[Any] = []
        for entry in node.elts if isinstance(node, ast.Tuple) else [node]:
            index, lines = self.apart(lambda entry=entry: self._index(entry))
            if any(WRITES.search(line) for line in lines):
                found = [at if isinstance(at, tuple) else self.held(at) for at in found]
            self.lines += lines
            found.append(index)
        return found

    def _index(self, node: ast.expr) -> Any:
        if isinstance(node, ast.Slice):
            if node.step is not None:
                raise TranslationError(f"slices with a step are not translated: {ast.unparse(node)}")
            parts = [Const(None) if part is None else self.value(part) for part in (node.lower, node.upper)]
        else:
            found = self.value(node)
            if isinstance(found, Const) and isinstance(found.value, slice):
                parts = [Const(found.value.start), Const(found.value.stop)]
            elif make_of(found) is slice:
                parts = parts_of(found)
            else:
                return found
        # What is written into the slice changes none of its ends.
        held = [self.held(part) if reads_memory(part) else part for part in parts]
        return tuple(None if part == Const(None) else part for part in held)

    def _tuple(self, node: ast.Tuple) -> Value:
        return self.tuple_of(self.entries(node.elts))

    def _dict(self, node: ast.Dict) -> Value:
        """Make a dict for Python, which nothing reads here."""
        keys = [key.value if isinstance(key, ast.Constant) else None for key in node.keys]
        names = [key for key in keys if isinstance(key, str) and key.isidentifier()]
        if not names or len(set(names)) < len(keys):
            raise TranslationError(f"the keys of a dict are different names in quotes: {ast.unparse(node)}")
        return Group(dict, tuple(zip(names, self.in_order(node.values), strict=True)))

    def entries(self, nodes: list[ast.expr]) -> list[Value]:
        """Evaluate expressions in their order, of which `*a` is as many as the tuple `a` has."""
        plain = [node.value if isinstance(node, ast.Starred) else node for node in nodes]
        found: list[Value] = []
        for value, node in zip(self.in_order(plain), nodes, strict=True):
            found += parts_of(value) if isinstance(node, ast.Starred) else [value]
        return found

    def _generatorexp(self, node: ast.GeneratorExp) -> Value:
        """Make a tuple of what a generator gives for each entry of another tuple."""
        generator, *others = node.generators
        if others or generator.ifs or not isinstance(generator.target, ast.Name):
            raise TranslationError(f"a generator has one name, and no condition: {ast.unparse(node)}")
        name, found = generator.target.id, list[Value]()
        before = self.names.get(name)
        for part in parts_of(self.held(self.value(generator.iter))):
            self.names[name] = part
            found = self._also(found, node.elt)
        self.names.pop(name, None)
        if before is not None:
            self.names[name] = before
        return self.tuple_of(found)

    def in_order(self, nodes: list[ast.expr]) -> list[Value]:
        """Evaluate expressions one after the other; what is read before a call is not what it changes."""
        found: list[Value] = []
        for node in nodes:
            found = self._also(found, node)
        return found

    def _also(self, found: list[Value], node: ast.expr) -> list[Value]:
        """Evaluate an expression after others, as `in_order`."""
        first, value = self.then(Group(None, tuple(("", one) for one in found)), node)
        return [*parts_of(first), value]

    def then(self, first: Value, node: ast.expr) -> tuple[Value, Value]:
        """Evaluate an expression after another value, as `in_order`."""
        value, lines = self.apart(lambda: self.value(node))
        if reads_memory(first) and any(WRITES.search(line) for line in lines):
            first = self.held(first)
        self.lines += lines
        return first, value

    def tuple_of(self, entries: list[Value], make: Any = None) -> Value:
        """Make a tuple, or a named tuple, from its entries."""
        known = [entry.value for entry in entries if isinstance(entry, Const)]
        if len(known) == len(entries) and not any(isinstance(value, np.ndarray) for value in known):
            return Const(tuple(known) if make is None else make(*known))
        names = make._fields if make is not None else tuple(f"f{k}" for k in range(len(entries)))
        return Group(make, tuple(zip(names, entries, strict=True)))

    def _binop(self, node: ast.BinOp) -> Value:
        left, right = self.in_order([node.left, node.right])
        return self.combined(type(node.op), left, right)

    def combined(self, kind: type, left: Value, right: Value) -> Value:
        """Combine two values by an operator, element by element if they are arrays."""
        if kind is ast.Add and _is_tuple(left) and _is_tuple(right):
            return self.tuple_of([*parts_of(left), *parts_of(right)])
        if isinstance(left, Array | Lazy) or isinstance(right, Array | Lazy):  # NumPy reads numbers before elements
            left, right = (self.held(one) if isinstance(one, Scalar) else one for one in (left, right))
        over = arrays.over_elements(lambda a, b: binary(kind, a, b), [left, right], self)
        return binary(kind, left, right) if over is None else over

    def _unaryop(self, node: ast.UnaryOp) -> Value:
        kind = type(node.op)
        if kind is ast.Not:
            return unary(kind, self.asked(node.operand))
        operand = self.value(node.operand)
        over = arrays.over_elements(lambda a: unary(kind, a), [operand], self)
        return unary(kind, operand) if over is None else over

    def _compare(self, node: ast.Compare) -> Value:
        left, found = self.value(node.left), None
        for k, (operation, right_node) in enumerate(zip(node.ops, node.comparators, strict=True)):
            before = len(self.lines)
            left, right = self.then(left, right_node)
            if k and len(self.lines) > before:  # Python may not come to it
                raise TranslationError(f"the end of a chain of comparisons takes no call: {ast.unparse(node)}")
            one = self._compared(type(operation), left, right)
            if k + 1 < len(node.ops) and isinstance(right, Scalar):
                right = self.kept(right)
            if found is None:
                found = one
            elif isinstance(found, Const):
                found = one if found.value else found
            elif isinstance(one, Const):
                found = found if one.value else one
            else:
                found = Scalar(BOOL, f"({scalar(found).code} && {scalar(one).code})")
            left = right
        assert found is not None
        return found

    def _compared(self, kind: type, left: Value, right: Value) -> Value:
        if kind in (ast.Is, ast.IsNot):
            if not (isinstance(right, Const) and right.value is None):
                raise TranslationError("`is` compares with None only")
            is_none = isinstance(left, Const) and left.value is None
            return Const(is_none == (kind is ast.Is))
        return binary(kind, left, right)

    def asked(self, node: ast.expr) -> Any:
        """Evaluate what an `if` asks: a known bool, or an expression."""
        return self._boolop(node, asks=True) if isinstance(node, ast.BoolOp) else condition(self.value(node))

    def _boolop(self, node: ast.BoolOp, asks: bool = False) -> Value:
        def operand_of(operand: ast.expr) -> Any:
            if asks or isinstance(operand, ast.BoolOp):
                return self.asked(operand) if asks else self.value(operand)
            value = self.value(operand)
            if scalar(value).dtype != BOOL:
                raise TranslationError(f"and, or of numbers are translated in conditions alone: {ast.unparse(node)}")
            return condition(value)

        conjunction = isinstance(node.op, ast.And)
        found: Any = None
        for operand in node.values:
            if isinstance(found, Const):
                if found.value != conjunction:
                    return found
                found = None
            if found is None:
                found = operand_of(operand)
                continue
            later, written = self.apart(lambda operand=operand: operand_of(operand))
            if isinstance(later, Const) and not written:
                if later.value != conjunction:
                    return later
                continue
            if written:  # what has to run first runs only if it is asked for
                name = self.fresh(BOOL, "asked")
                self.write(f"{name} = {bare(found.code)};")
                self.write(f"if ({name if conjunction else f'!{name}'}) {{")
                self.lines += [f"    {line}" for line in written]
                self.write(f"    {name} = {bare(scalar(later).code)};")
                self.write("}")
                found = Scalar(BOOL, name)
            else:
                found = Scalar(BOOL, f"({found.code} {'&&' if conjunction else '||'} {scalar(later).code})")
        return found

    def _ifexp(self, node: ast.IfExp) -> Value:
        asked = self.asked(node.test)
        if isinstance(asked, Const):
            return self.value(node.body if asked.value else node.orelse)
        first, before_first = self.apart(lambda: self.value(node.body))
        second, before_second = self.apart(lambda: self.value(node.orelse))
        if isinstance(first, Group) or isinstance(second, Group):
            first_parts, second_parts = parts_of(first), parts_of(second)
            if make_of(first) is not make_of(second) or names_of(first) != names_of(second):
                raise TranslationError(f"a choice between {shown(first)} and {shown(second)}: take tuples of one class")
            if before_first or before_second:
                raise TranslationError("a choice between tuples takes no calls")
            asked = self.kept(asked)
            chosen = [self._either(asked, a, b) for a, b in zip(first_parts, second_parts, strict=True)]
            return self.tuple_of(chosen, make_of(first))
        if not (before_first or before_second):
            return self._either(asked, first, second)
        dtype = joined(scalar(first).dtype, scalar(second).dtype)
        name = self.fresh(dtype, "chosen")
        self.write(f"if ({bare(asked.code)}) {{")
        self.lines += [f"    {line}" for line in before_first]
        self.write(f"    {name} = {bare(cast(first, dtype).code)};")
        self.write("} else {")
        self.lines += [f"    {line}" for line in before_second]
        self.write(f"    {name} = {bare(cast(second, dtype).code)};")
        self.write("}")
        return Scalar(dtype, name, either(scalar(first), scalar(second)))

    def _either(self, asked: Scalar, first: Value, second: Value) -> Value:
        if isinstance(first, Array) and isinstance(second, Array):
            if (first.shape, first.strides, first.dtype) != (second.shape, second.strides, second.dtype):
                raise TranslationError("a choice between arrays takes arrays of one shape")
            code = f"({asked.code} ? {first.code} : {second.code})"
            memory = first.memory if first.memory == second.memory else ""
            return replace(
                first,
                code=code,
                constant=first.constant or second.constant,
                in_loop=first.in_loop or second.in_loop,
                memory=memory,
            )
        if isinstance(first, Record) and isinstance(second, Record):
            return Record(joined(first.type, second.type), f"({asked.code} ? {first.code} : {second.code})")
        a, b = scalar(first), scalar(second)
        dtype = joined(a.dtype, b.dtype)
        return Scalar(dtype, f"({asked.code} ? {cast(first, dtype).code} : {cast(second, dtype).code})", either(a, b))


def _is_tuple(value: Value) -> bool:
    return isinstance(value, Group | Record) or (isinstance(value, Const) and isinstance(value.value, tuple))


def construct(node: ast.AST) -> str:
    """Name a construct of Python: `a list comprehension`."""
    word = type(node).__name__
    known = {"ListComp": "list comprehension", "DictComp": "dict comprehension", "JoinedStr": "formatted string"}
    known |= {"SetComp": "set comprehension", "GeneratorExp": "generator", "FunctionDef": "function in a function"}
    return f"a {known.get(word, word.lower())}"
