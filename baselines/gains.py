"""Gains of a controller: a frozen dataclass whose fields know their range, and the file that tuned values live in.

`gains.json` holds, for each controller, its gains and where they come from; `baselines/tune.py` writes it.
"""

from __future__ import annotations

import json
from collections import namedtuple
from collections.abc import Iterable
from dataclasses import asdict, astuple, dataclass, field, fields
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from baselines.tools.command import this_python
from baselines.tools.files import read_text, write_text
from baselines.tools.schema import in_a_line, loads

FILE = Path(__file__).with_name("gains.json")


def tunable(default: float, low: float, high: float, log: bool = False) -> Any:
    """Field of `Gains` with its value before tuning, its range, and whether it is searched on a logarithmic scale."""
    return field(default=default, metadata={"low": low, "high": high, "log": log})


@dataclass(frozen=True)
class Gains:
    """Base of all gains.

    Raises:
        TypeError: If a gain is not a number.
        ValueError: If a gain is not finite or outside its range, naming it, the value and the range.
    """

    def __post_init__(self) -> None:
        """Check every gain against its range."""
        for gain in fields(self):
            value, low, high = getattr(self, gain.name), gain.metadata["low"], gain.metadata["high"]
            name = f"{type(self).__name__}.{gain.name}"
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise TypeError(f"{name} must be a number, got {value!r}")
            if not low <= value <= high:
                raise ValueError(f"{name} must lie within {low:g} and {high:g}, got {value!r}")

    def numbers(self) -> Any:
        """The gains as a named tuple of floats, which a kernel can read."""
        return _numbers(type(self), map(float, astuple(self)))


def _numbers(kind: type[Gains], values: Iterable[float]) -> Any:
    return _numbers_of(kind)._make(values)


@cache
def _numbers_of(kind: type[Gains]) -> Any:
    """Type of the numbers of a kind of gains; pickled by this kind, as it is in no module itself."""
    made: Any = namedtuple(kind.__name__, [gain.name for gain in fields(kind)])
    made.__reduce__ = lambda numbers: (_numbers, (kind, tuple(numbers)))
    return made


AnyGains = TypeVar("AnyGains", bound=Gains)


def tuned(name: str, kind: type[AnyGains]) -> AnyGains:
    """Tuned gains of the controller `name` in `FILE`, or those of `kind` if it has not been tuned.

    Raises:
        ValueError: If the file holds gains that `kind` does not have, or no number within its range.
    """
    entry = read_file(FILE).get(name)
    if entry is None:
        return kind()
    remedy = f"run `{this_python()} baselines/tune.py {name}`"
    known = {gain.name for gain in fields(kind)}
    if set(entry["gains"]) != known:
        raise ValueError(
            f"{FILE.name} has gains {in_a_line(', '.join(sorted(entry['gains'])), 80)} for {name!r}, but it needs "
            f"{', '.join(sorted(known))}: {remedy}"
        )
    try:
        return kind(**entry["gains"])
    except (TypeError, ValueError) as error:
        raise ValueError(f"{FILE.name}, {name!r}: {in_a_line(error, 120)}; {remedy}") from None


def read_file(path: Path = FILE) -> dict[str, Any]:
    """Contents of a file of gains: by controller, its `gains` and their `provenance`.

    Raises:
        ValueError: If the file is damaged.
    """
    if not path.exists():
        return {}
    try:
        entries = loads(read_text(path))
    except (OSError, ValueError) as error:  # no regular file, not JSON, or not even text
        raise ValueError(f"{path} is damaged ({error}): restore it, or remove it and tune anew") from None
    whole = isinstance(entries, dict) and all(
        isinstance(entry, dict) and isinstance(entry.get("gains"), dict) for entry in entries.values()
    )
    if not whole:
        raise ValueError(f"{path} is damaged (no gains by controller): restore it, or remove it and tune anew")
    return entries


def write_entry(name: str, gains: Gains, provenance: dict[str, Any], path: Path = FILE) -> None:
    """Write the gains of one controller to a file of gains and keep those of the others.

    Raises:
        ValueError: If the file is damaged.
        OSError: If it cannot be written.
    """
    entries = {**read_file(path), name: {"gains": asdict(gains), "provenance": provenance}}
    write_text(path, json.dumps({known: entries[known] for known in sorted(entries)}, indent=2) + "\n")
