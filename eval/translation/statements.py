"""Statements of a kernel."""

from __future__ import annotations

import ast
from typing import Any

from eval.translation.assigning import Assignments
from eval.translation.expressions import construct
from eval.translation.numbers import bare, cast, constant, scalar
from eval.translation.types import (
    BOOL,
    INT,
    Array,
    Const,
    Scalar,
    TranslationError,
    Value,
    parts_of,
)


class Statements(Assignments):
    """Translation of statements into lines."""

    returned: Any = None  # type of what is returned, joined over all returns

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
        asked = self.asked(statement.test)
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
        asked, lines = self.apart(lambda: self.asked(statement.test))
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
            self._over_tuple(statement)
            return
        assert isinstance(iterated, ast.Call)
        if not isinstance(statement.target, ast.Name):
            raise TranslationError(f"a loop over a range has one variable: {ast.unparse(statement.target)}")
        bounds = self.in_order(iterated.args)
        if any(scalar(bound).dtype not in (INT, BOOL) for bound in bounds):
            raise TranslationError(f"the bounds of a range are whole numbers: {ast.unparse(iterated)}")
        start, stop = (Const(0), bounds[0]) if len(bounds) == 1 else bounds[:2]
        step = int(constant(bounds[2])) if len(bounds) == 3 else 1
        if isinstance(start, Const) and isinstance(stop, Const) and len(range(start.value, stop.value, step)) == 0:
            return
        name = statement.target.id
        own = self.assigned.get(name, 0) == 0  # if not, the variable changes within the loop, which counts on
        place = self.c_name("unused" if name == "_" else name if own else f"{name}_count")
        first = bare(cast(start, INT).code)
        last = bare(cast(self.kept(self.held(stop)), INT).code)  # computed once, before the loop
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

    def _over_tuple(self, statement: ast.For) -> None:
        """Translate a loop over a tuple, turn by turn."""
        if _leaves(statement.body):
            raise TranslationError("a loop over a tuple is written out, and takes neither break nor continue")
        for part in parts_of(self.held(self.value(statement.iter))):
            self.assign(statement.target, part)
            if self.block(statement.body):
                return

    def _do_assign(self, statement: ast.Assign) -> None:
        value = self.value(statement.value)
        if len(statement.targets) > 1 and isinstance(value, Scalar):
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
            self.fill(old, self.combined(kind, old, self.value(statement.value)))
        else:
            place = old
            old, more = self.then(old, statement.value)
            new = self.combined(kind, old, more)
            if isinstance(target, ast.Name):
                self.assign(target, new)
            else:
                self.put(place, new)


def _leaves(body: list[ast.stmt]) -> bool:
    """Tell whether a loop's own body breaks or continues."""
    for statement in body:
        if isinstance(statement, ast.Break | ast.Continue):
            return True
        if isinstance(statement, ast.If) and (_leaves(statement.body) or _leaves(statement.orelse)):
            return True
    return False
