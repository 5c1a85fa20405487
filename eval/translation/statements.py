"""Statements of a kernel."""

from __future__ import annotations

import ast
import re
from typing import Any

import numpy as np

from eval.translation import arrays
from eval.translation.calls import Calls
from eval.translation.expressions import known_group, parts_of
from eval.translation.numbers import NUMBERS, bare, cast, condition, constant, scalar
from eval.translation.scope import type_of
from eval.translation.types import (
    BOOL,
    INT,
    Array,
    ArrayType,
    Const,
    Group,
    Lazy,
    Record,
    RecordType,
    Scalar,
    TranslationError,
    Value,
    record_type,
)


class Statements(Calls):
    """Translation of statements into lines."""

    returned: Any = None  # type of what is returned, joined over all returns

    def block(self, body: list[ast.stmt]) -> bool:
        """Translate statements; tell whether the last one leaves the block."""
        for statement in body:
            self.line = statement.lineno
            method = getattr(self, f"_do_{type(statement).__name__.lower()}", None)
            if method is None:
                raise TranslationError(f"{type(statement).__name__} is not translated")
            if method(statement):
                return True
        return False

    def _indented(self, body: list[ast.stmt]) -> None:
        _, lines = self.apart(lambda: self.block(body))
        self.lines += [f"    {line}" for line in lines]

    def _do_pass(self, statement: ast.Pass) -> None:
        """Translate nothing."""

    def _do_expr(self, statement: ast.Expr) -> None:
        if not isinstance(statement.value, ast.Constant):
            self.value(statement.value)

    def _do_assert(self, statement: ast.Assert) -> None:
        """Leave out what is for readers and type checkers."""

    def _do_return(self, statement: ast.Return) -> bool:
        self.give(Const(None) if statement.value is None else self.value(statement.value))
        return True

    def give(self, value: Value) -> None:
        """Return a value."""
        raise NotImplementedError

    def _do_break(self, statement: ast.Break) -> bool:
        self.write("break;")
        return True

    def _do_continue(self, statement: ast.Continue) -> bool:
        self.write("continue;")
        return True

    def _do_if(self, statement: ast.If) -> bool:
        asked = condition(self.value(statement.test))
        if isinstance(asked, Const):
            return self.block(statement.body if asked.value else statement.orelse)
        self.write(f"if ({bare(asked.code)}) {{")
        left = []
        before = dict(self.names)
        ends = []
        for k, body in enumerate((statement.body, statement.orelse)):
            if k and not body:
                left.append(False)
                ends.append(before)
                continue
            if k:
                self.write("} else {")
            self.names = dict(before)
            gone, lines = self.apart(lambda body=body: self.block(body))
            left.append(gone)
            ends.append(self.names)
            self.lines += [f"    {line}" for line in lines]
        self.write("}")
        # Names that both branches, or the one that goes on, have set; known values that differ are variables by now.
        self.names = {**ends[0], **ends[1]} if not (left[0] or left[1]) else (ends[1] if left[0] else ends[0])
        return all(left)

    def _do_while(self, statement: ast.While) -> None:
        asked, lines = self.apart(lambda: condition(self.value(statement.test)))
        if isinstance(asked, Const):
            if not asked.value:
                return
            asked = Scalar(BOOL, "true")
        self.loops += 1
        if lines:
            self.write("while (true) {")
            self.lines += [f"    {line}" for line in lines]
            self.write(f"    if (!({bare(asked.code)})) {{")
            self.write("        break;")
            self.write("    }")
        else:
            self.write(f"while ({bare(asked.code)}) {{")
        self._indented(statement.body)
        self.write("}")
        self.loops -= 1

    def _do_for(self, statement: ast.For) -> None:
        iterated = statement.iter
        is_range = (
            isinstance(iterated, ast.Call) and isinstance(iterated.func, ast.Name) and iterated.func.id == "range"
        )
        if statement.orelse:
            raise TranslationError("for ... else is not translated")
        if not is_range:
            for part in parts_of(self.value(iterated)):  # a tuple: turn by turn
                self.assign(statement.target, part)
                self.block(statement.body)
            return
        assert isinstance(iterated, ast.Call) and isinstance(statement.target, ast.Name)
        bounds = [self.value(argument) for argument in iterated.args]
        start, stop = (Const(0), bounds[0]) if len(bounds) == 1 else bounds[:2]
        step = int(constant(bounds[2])) if len(bounds) == 3 else 1
        if isinstance(start, Const) and isinstance(stop, Const) and len(range(start.value, stop.value, step)) == 0:
            return
        name = statement.target.id
        own = self.assigned.get(name, 0) == 0  # if not, the variable changes within the loop, which counts on
        place = self.c_name("unused" if name == "_" else name if own else f"{name}_count")
        self.loop_names.append(place)
        first = bare(cast(start, INT).code)
        limit = stop if isinstance(stop, Const) else self._frozen(stop, iterated.args[-1] if len(bounds) < 2 else None)
        last = bare(cast(limit, INT).code)
        compare = "<" if step > 0 else ">"
        advance = f"++{place}" if step == 1 else f"--{place}" if step == -1 else f"{place} += {step}"
        before = self.names.get(name)
        self.loops += 1
        self.write(f"for (int32_t {place} = {first}; {place} {compare} {last}; {advance}) {{")
        _, lines = self.apart(lambda: self._turn(name, place, own, statement.body))
        self.lines += [f"    {line}" for line in lines]
        self.write("}")
        self.loops -= 1
        self.taken.discard(place)
        if own:  # the variable ends with its loop
            self.names.pop(name, None)
            if before is not None:
                self.names[name] = before

    def _turn(self, name: str, place: str, own: bool, body: list[ast.stmt]) -> None:
        """Translate one turn of a loop."""
        if own:
            self.names[name] = Scalar(INT, place)
        else:
            self._assign_name(name, Scalar(INT, place))
        self.block(body)

    def _frozen(self, stop: Value, node: ast.expr | None) -> Value:
        """Compute the end of a loop once, before it begins."""
        return self.kept(stop)

    def _do_assign(self, statement: ast.Assign) -> None:
        value = self.value(statement.value)
        if len(statement.targets) > 1 and isinstance(value, Scalar):
            value = self.kept(value)
        for target in statement.targets:
            self.assign(target, value)

    def _do_annassign(self, statement: ast.AnnAssign) -> None:
        if statement.value is not None:
            self.assign(statement.target, self.value(statement.value))

    def _do_augassign(self, statement: ast.AugAssign) -> None:
        target = statement.target
        load: Any = ast.parse(ast.unparse(target), mode="eval").body
        old = self.value(load)
        new = self.combined(type(statement.op), old, self.value(statement.value))
        if isinstance(old, Array):
            self.fill(old, new)
        else:
            self.assign(target, new)

    def assign(self, target: ast.expr, value: Value) -> None:
        """Assign a value to a name, an element, a part of an array, or several of these."""
        if isinstance(target, ast.Name):
            self._assign_name(target.id, value)
        elif isinstance(target, ast.Tuple | ast.List):
            parts = parts_of(value)
            if len(parts) != len(target.elts):
                raise TranslationError(f"{len(parts)} values for {len(target.elts)} targets")
            if isinstance(value, Group) and not self._independent(target.elts, parts):  # all before the first
                parts = [self.kept(part) if isinstance(part, Scalar) else part for part in parts]
                parts = [self._away(part) for part in parts]
            for one, part in zip(target.elts, parts, strict=True):
                self.assign(one, part)
        elif isinstance(target, ast.Subscript):
            self._assign_part(target, value)
        else:
            raise TranslationError(f"nothing is assigned to {ast.unparse(target)}")

    def _independent(self, targets: list[ast.expr], parts: list[Value]) -> bool:
        """Tell whether values can be assigned one by one, for none is made of a variable that is a target too."""
        places = [self.places.get(target.id, target.id) for target in targets if isinstance(target, ast.Name)]
        codes = " ".join(part.code for part in parts if isinstance(part, Scalar | Record))
        return len(places) == len(targets) and not any(re.search(rf"\b{place}\b", codes) for place in places)

    def _away(self, part: Value) -> Value:
        """Copy a variable that is about to be assigned: in `a, b = b, a`."""
        if isinstance(part, Scalar) and part.code in self.locals and not part.code.startswith("t_"):
            name = self.fresh(part.dtype, "t")
            self.write(f"{name} = {part.code};")
            return Scalar(part.dtype, name)
        return part

    def _assign_part(self, target: ast.Subscript, value: Value) -> None:
        owner = self.value(target.value)
        if not isinstance(owner, Array):
            raise TranslationError(f"elements are assigned to arrays only: {ast.unparse(target)}")
        if owner.constant:
            raise TranslationError(f"what is constant is not assigned to: {ast.unparse(target)}")
        place = arrays.view(owner, self.indices(target.slice))
        if isinstance(place, Scalar):
            self.write(f"{place.code} = {bare(cast(value, place.dtype).code)};")
            return
        if isinstance(value, Group | Record) or (isinstance(value, Const) and isinstance(value.value, tuple)):
            for k, part in enumerate(parts_of(value)):
                element = arrays.view(place, [Const(k)])
                assert isinstance(element, Scalar)
                self.write(f"{element.code} = {bare(cast(part, place.dtype).code)};")
            return
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
            self.write(f"{place} = {bare(value.code)};")
            self.names[name] = Array(kind.dtype, value.shape, kind.strides, place, kind.constant, value.in_loop)
        elif isinstance(kind, RecordType):
            self.write(f"{place} = {bare(self.as_record(value, kind))};")
            self.names[name] = Record(kind, place)
        else:
            self.write(f"{place} = {bare(cast(value, kind).code)};")
            self.names[name] = Scalar(kind, place)

    def _named_parts(self, name: str, value: Group) -> Group:
        """Compute the numbers of a group into variables."""
        parts = []
        for field, part in value.fields:
            if isinstance(part, Scalar | Record) or (isinstance(part, Array) and not part.code.isidentifier()):
                kind = self.unify(f"{name}.{field}", type_of(part))
                place = self._variable(f"{name}.{field}", kind)
                self.write(f"{place} = {bare(part.code)};")
                if isinstance(part, Array):
                    part = Array(part.dtype, part.shape, part.strides, place, part.constant, part.in_loop)
                else:
                    part = Record(kind, place) if isinstance(kind, RecordType) else Scalar(kind, place)
            parts.append((field, part))
        return Group(value.make, tuple(parts))

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
