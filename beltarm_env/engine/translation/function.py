"""One function of C: the statements of a kernel, and what it returns."""

from __future__ import annotations

from typing import Any

from beltarm_env.engine.translation.numbers import NUMBERS, bare, cast, scalar
from beltarm_env.engine.translation.scope import type_of
from beltarm_env.engine.translation.statements import Statements
from beltarm_env.engine.translation.types import (
    INT,
    SMALL,
    Const,
    ConstType,
    Group,
    Record,
    RecordType,
    Scalar,
    TranslationError,
    Value,
    joined,
    key_of,
    known_group,
)
from beltarm_env.engine.translation.whole import span


class NotReturnableError(TranslationError):
    """A function returns what C cannot: it is written out where it is called."""


class Function(Statements):
    """Translation of one function."""

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

    known: Const | None = None
    span: tuple[int, int] | None = None  # of the whole numbers returned

    def finish(self, left: bool) -> None:
        """End the function.

        Raises:
            TranslationError: If one way through it returns something, and another does not.
        """
        if not left and self.returned not in (None, ConstType(key_of(None))):
            raise TranslationError("it returns something on one way and nothing on another: return on all ways")


def _all_numbers(value: Any) -> bool:
    if isinstance(value, NUMBERS):
        return True
    return isinstance(value, tuple) and len(value) > 0 and all(map(_all_numbers, value))
