"""Assignments of a kernel: to names, elements and parts of arrays, and several of these at once."""

from __future__ import annotations

import ast
import re
from dataclasses import replace
from typing import Any

import numpy as np

from beltarm_env.engine.translation import arrays
from beltarm_env.engine.translation.calls import Calls
from beltarm_env.engine.translation.numbers import NUMBERS, bare, cast, scalar
from beltarm_env.engine.translation.scope import type_of
from beltarm_env.engine.translation.types import (
    INT,
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
    key_of,
    known_group,
    parts_of,
    record_type,
)


class Assignments(Calls):
    """Translation of assignments into lines."""

    def assign(self, target: ast.expr, value: Value) -> None:
        """Assign a value to a name, an element, a part of an array, or several of these."""
        if isinstance(target, ast.Name):
            self._assign_name(target.id, value)
        elif isinstance(target, ast.Tuple | ast.List):
            parts = parts_of(value)
            if len(parts) != len(target.elts):
                raise TranslationError(f"{len(parts)} values for {len(target.elts)} targets")
            if isinstance(value, Record) and self.changes(value):
                parts = parts_of(self.held(value))
            if isinstance(value, Group) and not self._independent(target.elts, parts):  # all before the first
                parts = [self.held(part) for part in parts]
            for one, part in zip(target.elts, parts, strict=True):
                self.assign(one, part)
        elif isinstance(target, ast.Subscript):
            self.put(self.place_of(target), value)
        else:
            raise TranslationError(f"nothing is assigned to {ast.unparse(target)}")

    def _independent(self, targets: list[ast.expr], parts: list[Value]) -> bool:
        """Tell whether values can be assigned one by one, for none is made of a variable that is a target too."""
        names = {target.id for target in targets if isinstance(target, ast.Name)}
        places = {place for name, place in self.places.items() if name.partition(".")[0] in names}
        read = re.findall(r"[A-Za-z_]\w*", " ".join(_codes(part) for part in parts))
        return len(names) == len(targets) and places.isdisjoint(read)

    def place_of(self, target: ast.Subscript) -> Array | Scalar:
        """Element or part of an array that is assigned to."""
        owner = self.value(target.value)
        if not isinstance(owner, Array):
            raise TranslationError(f"elements are assigned to arrays only: {ast.unparse(target)}")
        if owner.constant:
            raise TranslationError(f"what is constant is not assigned to: {ast.unparse(target)}")
        index = [self.held(at) if isinstance(at, Scalar) else at for at in self.indices(target.slice)]
        return arrays.view(owner, index)

    def put(self, place: Any, value: Value) -> None:
        """Write a value into an element or a part of an array."""
        if isinstance(place, Scalar):
            self.write(f"{place.code} = {bare(cast(value, place.dtype).code)};")
        elif isinstance(value, Group | Record) or (isinstance(value, Const) and isinstance(value.value, tuple)):
            parts = parts_of(self.held(value))
            self.common_shape(place.shape, (len(parts),), "an array of shape {} cannot take numbers of shape {}")
            place = replace(place, shape=(len(parts),))
            for k, part in enumerate(parts):
                self.put(arrays.view(place, [Const(k)]), part)
        else:
            self.fill(place, value)

    def _assign_name(self, name: str, value: Value) -> None:
        once = not self.often(name)
        self._check_form(name, value)
        if isinstance(value, Lazy):
            raise TranslationError(f"the array expression for {name} must be written into an array: {name}[:] = ...")
        if isinstance(value, Const) and not isinstance(value.value, NUMBERS):
            if isinstance(value.value, np.ndarray):
                value = self.table(value.value, value.name or name)
            elif isinstance(value.value, tuple) and not once and _numeric(value.value):
                value = known_group(value)
            else:
                self.names[name] = value
                return
        if isinstance(value, Const) and once:
            self.names[name] = value
            return
        if isinstance(value, Group):
            record = self.record(value)
            if record is None:
                self.names[name] = self._named_parts(name, value)
                return
            value = record
        if isinstance(value, Array):
            if once and not value.in_loop and self.stays(value):
                self.names[name] = value
                return
            if value.in_loop and (not once or self.set_without(value.memory)):
                raise TranslationError(f"{name} keeps an array that a loop allocates in every turn: take two, by turns")
            value = self.steady(value)
            if once and value.in_loop and value.code.isidentifier():
                self.names[name] = value
                return
        self.names[name] = self._put_into_variable(name, value)

    def _put_into_variable(self, name: str, value: Value) -> Value:
        """Write a number, a struct or a view into a variable, and return what stands for it."""
        kind = self.unify(name, type_of(scalar(value) if isinstance(value, Const) else value))
        place = self._variable(name, kind)
        if isinstance(kind, ArrayType):
            assert isinstance(value, Array)
            shape, strides = self.lengths(name, value, kind)
            self.write(f"{place} = {bare(value.code)};")
            memory = "" if self.often(name) else value.memory
            return replace(value, shape=shape, strides=strides, code=place, constant=kind.constant, memory=memory)
        if isinstance(kind, RecordType):
            self.write(f"{place} = {bare(self.as_record(value, kind))};")
            return Record(kind, place)
        self.write(f"{place} = {bare(cast(value, kind).code)};")
        return Scalar(kind, place, self.spanned(name, kind, scalar(value)))

    def _check_form(self, name: str, value: Value) -> None:
        """Refuse a variable of which the translation cannot know what it is where ways through the kernel meet."""
        if not self.often(name):
            return
        before = self.forms.get(name, self._form(self.names[name]) if name in self.names else None)
        self.forms[name] = self._form(value)
        if self.within and before not in (None, self.forms[name]):
            raise TranslationError(f"{name} becomes something else in a branch or loop: take two names")

    def _form(self, value: Value) -> Any:
        """What is known of a value but for numbers and memory."""
        if isinstance(value, Const) and isinstance(value.value, tuple) and _numeric(value.value):
            value = known_group(value)
        if isinstance(value, Const) and not isinstance(value.value, (*NUMBERS, np.ndarray)):
            return key_of(value.value)
        if isinstance(value, Group) and self.record(value) is None:
            return value.make, tuple(self._form(part) for _, part in value.fields)
        return ()

    def _named_parts(self, name: str, value: Group) -> Group:
        """Compute the numbers of a group into variables."""
        often = self.often(name)
        parts: list[tuple[str, Any]] = []
        for field, part in value.fields:
            label = f"{name}.{field}"
            if isinstance(part, Lazy):
                raise TranslationError(f"the array expression for {label} must be written into an array before")
            if often and isinstance(part, Const):
                if isinstance(part.value, NUMBERS):
                    part = scalar(part)
                elif isinstance(part.value, np.ndarray):
                    part = self.table(part.value, part.name or field)
            if isinstance(part, Group):
                part = self._named_parts(label, part)
            elif isinstance(part, Scalar | Record):
                part = self._put_into_variable(label, part)
            elif isinstance(part, Array) and (often or not self.stays(part)):
                if part.in_loop and (often or self.set_without(part.memory)):
                    raise TranslationError(f"{label} keeps an array that a loop allocates in every turn")
                part = self._put_into_variable(label, self.steady(part))
            parts.append((field, part))
        return Group(value.make, tuple(parts))

    def lengths(self, name: str, array: Array, kind: Any) -> tuple[tuple[Size, ...], tuple[Size, ...]]:
        """Shape and strides of an array that a variable is assigned; what changes of them is a variable as well."""
        if not self.often(name):
            return array.shape, array.strides

        def kept(sizes: tuple[Size, ...], known: tuple[int | None, ...], word: str) -> tuple[Size, ...]:
            found = list(sizes)
            for axis, size in enumerate(sizes):
                if known[axis] is None:
                    found[axis] = self._variable(f"{name}.{word}{axis or ''}", INT)
                    self.write(f"{found[axis]} = {bare(str(size))};")
            return tuple(found)

        return kept(array.shape, kind.shape, "length"), kept(array.strides, kind.strides, "stride")

    def _variable(self, name: str, kind: Any) -> str:
        """Name of C of a variable, declared with its type of now."""
        if name not in self.places:
            self.places[name] = self.c_name(name)
        return self.declare(self.places[name], kind)

    def record(self, value: Value) -> Record | None:
        """Turn a tuple of numbers into a struct; None where it holds anything else."""
        if isinstance(value, Record):
            return value
        if not isinstance(value, Group):
            return None
        fields, codes = [], []
        for name, part in value.fields:
            if isinstance(part, Group):
                part = self.record(part) or part
            if isinstance(part, Const) and isinstance(part.value, NUMBERS):
                part = scalar(part)
            if isinstance(part, Const) and isinstance(part.value, tuple) and _numeric(part.value):
                part = self.record(known_group(part)) or part
            if not isinstance(part, Scalar | Record):
                return None
            fields.append((name, type_of(part)))
            codes.append(bare(part.code))
        kind = record_type(value.make, tuple(fields))
        return Record(kind, f"(({self.program.struct(kind)}){{{', '.join(codes)}}})")

    def as_record(self, value: Value, kind: RecordType) -> str:
        """Write a tuple of numbers as a struct of a type."""
        if isinstance(value, Record) and value.type == kind:
            return value.code
        codes = []
        for part, (_, of) in zip(parts_of(value), kind.fields, strict=True):
            codes.append(self.as_record(part, of) if isinstance(of, RecordType) else bare(cast(part, of).code))
        return f"(({self.program.struct(kind)}){{{', '.join(codes)}}})"


def _numeric(values: tuple[Any, ...]) -> bool:
    return all(isinstance(value, NUMBERS) for value in values)


def _codes(value: Value) -> str:
    """Expressions of C that a value is made of."""
    if isinstance(value, Group):
        return " ".join(_codes(part) for _, part in value.fields)
    return value.code if isinstance(value, Scalar | Record | Array) else ""
