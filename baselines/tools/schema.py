"""JSON that others may have written: parsed with finite numbers alone, and checked by a JSON Schema (2020-12)."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from typing import Any

from jsonschema import Draft202012Validator, validators

TEXT, INTEGER, NUMBER, FLAG = ({"type": name} for name in ("string", "integer", "number", "boolean"))
_LARGEST = 2**63 - 1


def object_of(may_lack: tuple[str, ...] = (), /, **properties: Any) -> dict[str, Any]:
    """Schema of an object with these properties, some of which it may lack; it may have others."""
    required = [name for name in properties if name not in may_lack]
    return {"type": "object", "required": required, "properties": properties}


def list_of(items: Any) -> dict[str, Any]:
    """Schema of a list."""
    return {"type": "array", "items": items}


def mapping_of(values: Any) -> dict[str, Any]:
    """Schema of an object with any properties, all of one kind."""
    return {"type": "object", "additionalProperties": values}


def in_a_line(value: object, most: int = 200) -> str:
    """Words for what others may have written: printable, in a line, of at most so many characters."""
    text = " ".join(str(value)[: 2 * most].split())
    text = "".join(letter if letter.isprintable() else "?" for letter in text)
    return text if len(text) <= most else f"{text[: most - 3]}..."


def loads(text: str, **options: Any) -> Any:
    """Read JSON as `json.loads` does; what is nested too deeply is none, and raises ValueError as well."""
    try:
        return json.loads(text, **options)
    except RecursionError as error:
        raise ValueError(str(error)) from None


def parse(data: bytes) -> Any:
    """Parse JSON in UTF-8.

    Raises:
        ValueError: If it is none, or has a number that is not finite or takes more than 64 bits.
    """
    content = loads(data.decode("utf-8"), parse_constant=_number, parse_float=_number, parse_int=_number)
    try:
        json.dumps(content, ensure_ascii=False).encode("utf-8")  # which halves of characters cannot be
    except RecursionError as error:
        raise ValueError(str(error)) from None
    return content


def _number(text: str) -> float:
    value = int(text) if text.lstrip("-").isdigit() else float(text)
    if not abs(value) <= (_LARGEST if isinstance(value, int) else sys.float_info.max):
        raise ValueError(f"its number {text[:20]} is not finite, or too large")
    return value


def _is_finite(_: object, value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


_TYPES = Draft202012Validator.TYPE_CHECKER.redefine("number", _is_finite)
_Validator = validators.extend(Draft202012Validator, type_checker=_TYPES)


def check(content: object, where: str, schema: Mapping[str, Any]) -> None:
    """Check content by a JSON Schema.

    Raises:
        ValueError: Beginning with `where`: the first place that does not fit, what is wanted and what is there.
    """
    for error in _Validator(schema).iter_errors(content):
        place, wanted = f"{where}: {in_a_line(error.json_path, 100)}", error.validator_value
        if error.validator == "required":
            raise ValueError(f"{place}.{next(name for name in wanted if name not in error.instance)} must be there")
        rule = f"of {error.validator} {in_a_line(wanted, 80)}".replace("type number", "type finite number")
        if error.validator == "enum":
            rule = f"one of {', '.join(wanted)}"
        raise ValueError(f"{place} must be {rule}, got {in_a_line(error.instance, 80)!r}")
