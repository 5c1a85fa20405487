"""Statements of a kernel, and what it returns: one function of C."""

from __future__ import annotations

import ast
import json
from collections.abc import Callable
from typing import Any

import numpy as np

from beltarm_env.engine.translation import arrays
from beltarm_env.engine.translation.assigning import Assignments
from beltarm_env.engine.translation.expressions import construct
from beltarm_env.engine.translation.numbers import NUMBERS, bare, cast, constant, scalar
from beltarm_env.engine.translation.scope import type_of
from beltarm_env.engine.translation.types import (
    BOOL,
    INT,
    SMALL,
    UNSET,
    Array,
    Const,
    ConstType,
    Group,
    Lazy,
    Record,
    RecordType,
    Scalar,
    TranslationError,
    Value,
    joined,
    key_of,
    known_group,
    parts_of,
)
from beltarm_env.engine.translation.whole import WHOLE, fits, span


class NotReturnableError(TranslationError):
    """A function returns what C cannot: it is written out where it is called."""


class Function(Assignments):
    """Translation of one function: its statements into lines."""

    returned: Any = None  # type of what is returned, joined over all returns
    known: Const | None = None  # what is returned, where that is no number
    span: tuple[int, int] | None = None  # of the whole numbers returned

    def block(self, body: list[ast.stmt]) -> bool:
        """Translate statements; tell whether the last one leaves the block."""
        for statement in body:
            self.line = statement.lineno
            method = getattr(self, f"_do_{type(statement).__name__.lower()}", None)
            if method is None:
                raise TranslationError(f"{construct(statement)} is not translated")
            if method(statement):
                return True
        return False

    def _do_pass(self, statement: ast.Pass) -> None:
        """Translate nothing."""

    def _do_expr(self, statement: ast.Expr) -> None:
        if not isinstance(statement.value, ast.Constant):
            self.value(statement.value)

    def _do_assert(self, statement: ast.Assert) -> None:
        """Leave out what is for readers and type checkers."""

    def _do_raise(self, statement: ast.Raise) -> bool:
        """Fail with a text, which the glue raises."""
        match statement.exc:
            case ast.Call(ast.Name("ValueError"), [ast.Constant(str(text))]) if self.program.runs_here:
                literal = json.dumps(text).replace("??", '?""?')  # which C would read as other characters
                self.write(f"fail({literal});")
                return True
        raise TranslationError(f"{construct(statement)} is not translated, only ValueError('text'), for Python")

    def _do_return(self, statement: ast.Return) -> bool:
        self.give(Const(None) if statement.value is None else self.value(statement.value))
        return True

    def give(self, value: Value) -> None:
        """Return a value."""
        if isinstance(value, Const) and not _all_numbers(value.value):
            if self.returned not in (None, ConstType(key_of(value.value))):
                raise TranslationError("a function returns either a number or what is known, not both")
            self.returned, self.known = ConstType(key_of(value.value)), value
            self.write("return;")
            return
        if isinstance(value, Const):
            value = scalar(value) if isinstance(value.value, NUMBERS) else known_group(value)
        if isinstance(value, Group):
            record = self.record(value)
            if record is None:
                raise NotReturnableError("it returns arrays")
            value = record
        if not isinstance(value, Scalar | Record):
            raise NotReturnableError("it returns arrays")
        kind = joined(self.returned, type_of(value)) if self.returned is not None else type_of(value)
        if kind != self.returned:
            self.changed, self.returned = True, kind
        if isinstance(value, Scalar) and kind in (SMALL, INT):
            low, high = span(value)
            self.span = (min(low, self.span[0]), max(high, self.span[1])) if self.span else (low, high)
        if isinstance(kind, RecordType):
            self.write(f"return {bare(self.as_record(value, kind))};")
        else:
            self.write(f"return {bare(cast(value, kind).code)};")

    def _do_break(self, statement: ast.Break) -> bool:
        self.exits.append(dict(self.names))
        self.write("break;")
        return True

    def _do_continue(self, statement: ast.Continue) -> bool:
        self.exits.append(dict(self.names))
        self.write("continue;")
        return True

    def _do_if(self, statement: ast.If) -> bool:
        asked = self.asked(statement.test)
        if isinstance(asked, Const):
            return self.block(statement.body if asked.value else statement.orelse)
        self.write(f"if ({bare(asked.code)}) {{")
        before = dict(self.names)
        ends = []
        for k, body in enumerate((statement.body, statement.orelse)):
            if k and not body:
                ends.append((False, before))
                continue
            if k:
                self.write("} else {")
            self.names = dict(before)
            gone, lines = self._inside(lambda body=body: self.block(body))
            ends.append((gone, self.names))
            self.lines += [f"    {line}" for line in lines]
        self.write("}")
        (gone, names), (other_gone, others) = ends
        self.names = others if gone else names if other_gone else _met(names, others)
        return gone and other_gone

    def _do_while(self, statement: ast.While) -> bool:
        if statement.orelse:
            raise TranslationError("while ... else is not translated")
        asked, lines = self.apart(lambda: self.asked(statement.test))
        endless = isinstance(asked, Const) and bool(asked.value) and not _leaves(statement.body, ast.Break)
        if isinstance(asked, Const):
            if not asked.value:
                return False
            asked = Scalar(BOOL, "true")
        if lines:
            self.write("while (true) {")
            self.lines += [f"    {line}" for line in lines]
            self.write(f"    if (!({bare(asked.code)})) {{")
            self.write("        break;")
            self.write("    }")
        else:
            self.write(f"while ({bare(asked.code)}) {{")
        self._looped(lambda: self.block(statement.body))
        return endless

    def _looped(self, turn: Callable[[], Any]) -> None:
        """Translate the turns of a loop, and end it."""
        of_outer, self.exits, self.loops = self.exits, [], self.loops + 1
        _, lines = self._inside(turn)
        self.lines += [f"    {line}" for line in lines]
        self.write("}")
        self.names = _met(*self.exits, self.names)
        self.exits, self.loops = of_outer, self.loops - 1

    def _inside(self, action: Callable[[], Any]) -> tuple[Any, list[str]]:
        """Translate a branch or the turns of a loop, as `apart`."""
        before, self.blocks = self.within, self.blocks + 1
        self.within = (*before, self.blocks)
        try:
            return self.apart(action)
        finally:
            self.within = before

    def _do_for(self, statement: ast.For) -> None:
        iterated = statement.iter
        if statement.orelse:
            raise TranslationError("for ... else is not translated")
        if not isinstance(iterated, ast.Call) or self.value(iterated.func) != Const(range, "range"):
            self._over_tuple(statement)
            return
        if not isinstance(statement.target, ast.Name):
            raise TranslationError(f"a loop over a range has one variable: {ast.unparse(statement.target)}")
        bounds = self.in_order(iterated.args)
        if any(scalar(bound).dtype not in WHOLE for bound in bounds):
            raise TranslationError(f"the bounds of a range are whole numbers: {ast.unparse(iterated)}")
        start, stop = (Const(0), bounds[0]) if len(bounds) == 1 else bounds[:2]
        step = int(constant(bounds[2])) if len(bounds) == 3 else 1
        if step == 0:
            raise TranslationError(f"the step of a range must not be zero: {ast.unparse(iterated)}")
        if isinstance(start, Const) and isinstance(stop, Const) and len(range(start.value, stop.value, step)) == 0:
            return
        name = statement.target.id
        own = self.assigned.get(name, 0) == 0  # if not, the variable changes within the loop, which counts on
        place = self.c_name("unused" if name == "_" else name if own else f"{name}_count")
        counter = _counter(place, scalar(start), scalar(stop), step)
        first = bare(cast(start, counter.dtype).code)
        last = bare(cast(self.kept(self.held(stop)), counter.dtype).code)  # computed once, before the loop
        compare = "<" if step > 0 else ">"
        advance = f"++{place}" if step == 1 else f"--{place}" if step == -1 else f"{place} += {step}"
        if not fits(span(counter)[0] + min(step, 0), span(counter)[1] + max(step, 0), INT):
            advance = f"{place} = int_add({place}, {step})"
        before = self.names.get(name)
        self.write(f"for ({counter.dtype} {place} = {first}; {place} {compare} {last}; {advance}) {{")
        self._looped(lambda: self._turn(name, counter, own, statement.body))
        self.taken.discard(place)
        if own:  # the variable ends with its loop
            self.names.pop(name, None)
            if before is not None:
                self.names[name] = before

    def _turn(self, name: str, counter: Scalar, own: bool, body: list[ast.stmt]) -> None:
        """Translate one turn of a loop."""
        self.counters.add(counter.code)
        if own:
            self.names[name] = counter
        else:
            self._assign_name(name, counter)
        self.block(body)

    def _over_tuple(self, statement: ast.For) -> None:
        """Translate a loop over a tuple, turn by turn."""
        iterated = self.value(statement.iter)
        if isinstance(iterated, Const) and isinstance(iterated.value, np.ndarray):
            iterated = self.table(iterated.value, iterated.name)
        if isinstance(iterated, Array):
            self._over_rows(statement, iterated)
            return
        if _leaves(statement.body, ast.Break | ast.Continue):
            raise TranslationError("a loop over a tuple is written out, and takes neither break nor continue")
        stored = {n.id for n in ast.walk(statement) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}
        stored -= {n.id for n in ast.walk(statement.target) if isinstance(n, ast.Name)}
        self.assigned = {**self.assigned, **dict.fromkeys(stored, 2)}  # in each turn
        for part in parts_of(self.held(iterated)):
            self.assign(statement.target, part)
            if self.block(statement.body):
                return

    def _over_rows(self, statement: ast.For, array: Array) -> None:
        """Translate a loop over the entries of an array, or its rows."""
        array, place = self.held(array), self.c_name("row")
        length = bare(str(self.stable(array.shape[0])))
        self.write(f"for (int64_t {place} = 0; {place} < {length}; ++{place}) {{")
        row = Scalar(INT, place, (0, 2**31 - 1))

        def turn() -> None:
            self.counters.add(place)
            entry = arrays.view(array, [row])
            self.assign(statement.target, scalar(entry) if isinstance(entry, Scalar) else entry)
            self.block(statement.body)

        self._looped(turn)

    def _do_assign(self, statement: ast.Assign) -> None:
        value = self.value(statement.value)
        if len(statement.targets) > 1:
            value = self.kept(self.held(value))
        for target in statement.targets:
            self.assign(target, value)

    def _do_annassign(self, statement: ast.AnnAssign) -> None:
        if statement.value is not None:
            self.assign(statement.target, self.value(statement.value))

    def _do_augassign(self, statement: ast.AugAssign) -> None:
        target, kind = statement.target, type(statement.op)
        if isinstance(target, ast.Name):
            old = self._name(target)
        elif isinstance(target, ast.Subscript):
            old = self.place_of(target)
        else:
            raise TranslationError(f"nothing is assigned to {ast.unparse(target)}")
        if isinstance(old, Array):
            new = self.combined(kind, old, self.value(statement.value))
            assert isinstance(new, Lazy)
            if old.dtype in WHOLE and joined(new.dtype, old.dtype) != old.dtype:  # NumPy raises
                raise TranslationError(f"elements of type {old.dtype} take none of {new.dtype} in place")
            self.fill(old, new)
        else:
            place = old
            old, more = self.then(old, statement.value)
            new = self.combined(kind, old, more)
            if isinstance(target, ast.Name):
                self.assign(target, new)
            else:
                self.put(place, new)

    def finish(self, left: bool) -> None:
        """End the function.

        Raises:
            TranslationError: If one way through it returns something, and another does not.
        """
        if not left and self.returned not in (None, ConstType(key_of(None))):
            raise TranslationError("it returns something on one way and nothing on another: return on all ways")


def _met(*ways: dict[str, Value]) -> dict[str, Value]:
    """Names where ways meet, by the last of them; known values that differ are variables by now."""
    every: dict[str, Value] = {}
    for names in ways:
        every |= names
    certain = {name for name in every if all(names.get(name, UNSET) is not UNSET for names in ways)}
    return {name: value if name in certain else UNSET for name, value in every.items()}


def _all_numbers(value: Any) -> bool:
    if isinstance(value, NUMBERS):
        return True
    return isinstance(value, tuple) and len(value) > 0 and all(map(_all_numbers, value))


def _leaves(body: list[ast.stmt], kinds: Any) -> bool:
    """Tell whether a loop's own body breaks, or continues."""
    for statement in body:
        if isinstance(statement, kinds):
            return True
        if isinstance(statement, ast.If) and (_leaves(statement.body, kinds) or _leaves(statement.orelse, kinds)):
            return True
    return False


def _counter(place: str, start: Scalar, stop: Scalar, step: int) -> Scalar:
    """Variable of a loop over a range; its type holds the value after the last, too."""
    (low, high), (least, most) = span(start), span(stop)
    spanned = (low, max(low, most - 1)) if step > 0 else (min(high, least + 1), high)
    beyond = min(spanned[0] + step, spanned[0]), max(spanned[1] + step, spanned[1])
    return Scalar(SMALL if fits(*beyond, SMALL) else INT, place, spanned)
