"""Options of interrupted work: noted as it begins, so that `--resume` goes on with them unless others are given."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from baselines.tools.files import read_text, write_text
from baselines.tools.schema import in_a_line, loads


def note_options(path: Path, config: Any, **beside: Any) -> None:
    """Write the options of a command, a dataclass, and what else is to stand beside them, as JSON."""
    write_text(path, json.dumps({"config": asdict(config), **beside}, indent=2, default=str) + "\n")


def noted_options(path: Path, *but: str) -> dict[str, Any]:
    """Read the options that were noted, without those named in `but`; none where no file is.

    Raises:
        ValueError: If the file is damaged.
    """
    if not path.exists():
        return {}
    try:
        options = loads(read_text(path))["config"]
        return {name: value for name, value in options.items() if name not in but}
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{path} is damaged ({in_a_line(repr(error))}): choose another --out") from None


def as_arguments(kind: type[Any], options: Mapping[str, Any]) -> list[str]:
    """Return options as arguments of a command line, but for defaults, and for names that the command does not know.

    Args:
        kind: Options of a command, a dataclass.
        options: By name, as JSON has them. None of a positional argument.
    """
    arguments = list[str]()
    for each in fields(kind):
        value, name = options.get(each.name), each.name.replace("_", "-")
        if value is None or value == each.default:
            continue
        if isinstance(value, bool):  # a flag says what is not its default
            arguments.append(f"--{name}" if value else f"--no-{name}")
        elif isinstance(value, list):
            arguments += [f"--{name}", *map(str, value)]
        else:
            arguments.append(f"--{name}={value}")
    return arguments
