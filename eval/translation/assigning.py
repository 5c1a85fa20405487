"""Assignments of a kernel: to names, elements and parts of arrays, and several of these at once."""

from __future__ import annotations

import ast
import re
from typing import Any

import numpy as np

from eval.translation import arrays
from eval.translation.calls import Calls
from eval.translation.numbers import NUMBERS, bare, cast, scalar
from eval.translation.scope import type_of
from eval.translation.types import (
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
        return arrays.view(owner, self.indices(target.slice))

    def put(self, place: Any, value: Value) -> None:
        """Write a value into an element or a part of an array."""
        if isinstance(place, Scalar):
            self.write(f"{place.code} = {bare(cast(value, place.dtype).code)};")
        elif isinstance(value, Group | Record) or (isinstance(value, Const) and isinstance(value.value, tuple)):
            for k, part in enumerate(parts_of(self.held(value))):
                self.put(arrays.view(place, [Const(k)]), part)
        else:
            self.fill(place, value)

    def _assign_name(self, name: str, value: Value) -> None:
        once = self.assigned.get(name, 0) <= 1
        if isinstance(value, Lazy):
            raise TranslationError(f"the array expression for {name} must be written into an array: {name}[:] = ...")
        if isinstance(value, Const) and not isinstance(value.value, NUMBERS):
            if isinstance(value.value, np.ndarray):
                value = self.table(value.value, value.name or name)
            elif isinstance(value.value, tuple) and not once and all(isinstance(v, NUMBERS) for v in value.value):
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
            if value.code.isidentifier() and once and not value.in_loop:
                self.names[name] = value
                return
            if value.in_loop and not once:
                raise TranslationError(f"{name} keeps an array that a loop allocates in every turn: take two, by turns")
            if None in getattr(type_of(value), "shape", ()):
                value = self._sized(value)
            if once and value.in_loop and value.code.isidentifier():
                self.names[name] = value
                return
        kind = type_of(value if not isinstance(value, Const) else scalar(value))
        kind = self.unify(name, kind)
        place = self._variable(name, kind)
        if isinstance(kind, ArrayType):
            assert isinstance(value, Array)
            shape = self.lengths(name, value.shape, kind)
            self.write(f"{place} = {bare(value.code)};")
            self.names[name] = Array(kind.dtype, shape, kind.strides, place, kind.constant, value.in_loop)
        elif isinstance(kind, RecordType):
            self.write(f"{place} = {bare(self.as_record(value, kind))};")
            self.names[name] = Record(kind, place)
        else:
            self.write(f"{place} = {bare(cast(value, kind).code)};")
            self.names[name] = Scalar(kind, place)

    def _named_parts(self, name: str, value: Group) -> Group:
        """Compute the numbers of a group into variables."""
        parts: list[tuple[str, Any]] = []
        for field, part in value.fields:
            label = f"{name}.{field}"
            if isinstance(part, Group):
                part = self._named_parts(label, part)
            elif isinstance(part, Scalar | Record) or (
                isinstance(part, Array) and (not part.code.isidentifier() or self.changes(part))
            ):
                kind = self.unify(label, type_of(part))
                place = self._variable(label, kind)
                shape = self.lengths(label, part.shape, kind) if isinstance(part, Array) else ()
                self.write(f"{place} = {bare(part.code)};")
                if isinstance(part, Array):
                    part = Array(part.dtype, shape, part.strides, place, part.constant, part.in_loop)
                else:
                    part = Record(kind, place) if isinstance(kind, RecordType) else Scalar(kind, place)
            parts.append((field, part))
        return Group(value.make, tuple(parts))

    def lengths(self, name: str, shape: tuple[Size, ...], kind: Any) -> tuple[Size, ...]:
        """Shape of an array that a variable is assigned; a length that changes is a variable as well."""
        if self.assigned.get(name.partition(".")[0], 0) <= 1 or None not in kind.shape:
            return shape
        place = self._variable(f"{name}.length", INT)
        self.write(f"{place} = {bare(arrays.text(shape[0]))};")
        return (place, *shape[1:])

    def _sized(self, value: Array) -> Array:
        """Compute lengths that the program computes, into variables."""
        shape = tuple(size if isinstance(size, int) else self.kept(Scalar(INT, size)).code for size in value.shape)
        return Array(value.dtype, shape, value.strides, value.code, value.constant, value.in_loop)

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
            if (
                isinstance(part, Const)
                and isinstance(part.value, tuple)
                and all(isinstance(v, NUMBERS) for v in part.value)
            ):
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


def _codes(value: Value) -> str:
    """Expressions of C that a value is made of."""
    if isinstance(value, Group):
        return " ".join(_codes(part) for _, part in value.fields)
    return value.code if isinstance(value, Scalar | Record | Array) else ""
