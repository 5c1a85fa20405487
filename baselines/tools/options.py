"""Options of a command, a dataclass, from its command line: tyro reads them and writes `--help`.

The docstring under a field says what the option does. A dataclass may sort its options into groups for `--help`:

    groups: ClassVar[Groups] = {"basic": ("out", "seed"), "algorithm": (), "run": ("jobs",)}

A group holds the options that it names, and an empty one all that no group names. To tyro a group is a dataclass within
a dataclass; such dataclasses are made here, so that commands work with one flat dataclass.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import redirect_stderr
from dataclasses import Field, asdict, field, fields, make_dataclass
from io import StringIO
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

import docstring_parser
import tyro

from baselines.tools.files import read_text, write_text
from baselines.tools.schema import in_a_line, loads

Groups = Mapping[str, tuple[str, ...]]
"""Names of options, by the name of their group."""
_Config = TypeVar("_Config")
_MARKERS = (tyro.conf.DisallowNone, tyro.conf.FlagCreatePairsOff, tyro.conf.OmitArgPrefixes)
_SAID_OTHERWISE = ("", "''", "None", "True", "False")  # defaults that the option's text says, or its being a flag


def parse(
    kind: type[_Config],
    description: str | None = None,
    arguments: Sequence[str] | None = None,
    begun: Callable[[_Config], Mapping[str, Any]] | None = None,
) -> _Config:
    """Read options, a dataclass, from the command line.

    `--help` begins with the description, by default the docstring of `kind`. From the options that are given, `begun`
    gives those that the work to go on with was begun with: they stand for those that are not given.

    Raises:
        SystemExit: After `--help`, and for arguments that are no options.
        ValueError: If options that the work was begun with cannot be read.
    """
    given = sys.argv[1:] if arguments is None else arguments
    config = _read(kind, description, given)
    begun_with = _as_arguments(kind, begun(config)) if begun else []
    if not begun_with:
        return config
    try:
        with redirect_stderr(StringIO()):
            return _read(kind, description, [*begun_with, *given])
    except SystemExit:
        noted = in_a_line(" ".join(begun_with))
        raise ValueError(f"cannot resume with the options noted, {noted}: give them anew with another --out") from None


def _read(kind: type[_Config], description: str | None, arguments: Sequence[str]) -> _Config:
    groups, text = _groups_of(kind), _paragraphs(description or kind.__doc__)
    read: Any = tyro.cli(_shaped(kind, groups), description=text, args=arguments, config=_MARKERS)
    parts = [getattr(read, group) for group in groups] or [read]
    return kind(**{each.name: getattr(part, each.name) for part in parts for each in fields(part)})


def _groups_of(kind: type[Any]) -> dict[str, list[Field[Any]]]:
    """Fields of each group that has any, as the group orders them."""
    groups: Groups = getattr(kind, "groups", {})
    known: dict[str, Field[Any]] = {each.name: each for each in fields(kind)}
    others = [name for name in known if not any(name in names for names in groups.values())]
    chosen = {group: [known[name] for name in names or others if name in known] for group, names in groups.items()}
    return {group: members for group, members in chosen.items() if members}


def _shaped(kind: type[Any], groups: Mapping[str, Iterable[Field[Any]]]) -> type[Any]:
    """Dataclass of the same options as tyro is to show them, in a dataclass of its own for each group."""
    hints, texts = get_type_hints(kind, include_extras=True), _texts(kind)

    def part(name: str, members: Iterable[Field[Any]]) -> type[Any]:
        shown = [
            (each.name, _shown(hints[each.name], texts.get(each.name, "")), field(default=each.default))
            for each in members
        ]
        return make_dataclass(name, shown, kw_only=True)

    if not groups:
        return part(kind.__name__, fields(kind))
    return make_dataclass(kind.__name__, [(name, part(name, members)) for name, members in groups.items()])


def _texts(kind: type[Any]) -> dict[str, str]:
    """Docstrings of the fields, those of base classes included."""
    found = [docstring_parser.parse_from_object(base).params for base in reversed(kind.__mro__[:-1])]
    return {param.arg_name: _joined(param.description) for params in found for param in params}


def _shown(hint: Any, text: str) -> Any:
    """Type of an option with its text, a plain default and a plain word for its values; its own marks come after."""
    inner, *marks = get_args(hint) if get_origin(hint) is Annotated else [hint]
    several = get_origin(inner) is tuple and tyro.conf.UseAppendAction not in marks
    values = f"{get_args(inner)[0].__name__.upper()} ..." if several else None
    plain = tyro.conf.arg(help=text, metavar=values, help_behavior_hint=_default_text)
    return Annotated[tuple([inner, plain, *marks])]  # pyright: ignore[reportInvalidTypeForm]


def _default_text(default: str) -> str:
    return "" if default in _SAID_OTHERWISE else f"(default: {default.removeprefix(f'{Path.cwd()}{os.sep}')})"


def _joined(text: str | None) -> str:
    return " ".join((text or "").split())


def _paragraphs(text: str | None) -> str:
    return "\n\n".join(_joined(paragraph) for paragraph in (text or "").split("\n\n"))


# Options of interrupted work: noted as it begins, so that `--resume` goes on with them unless others are given


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


def _as_arguments(kind: type[Any], options: Mapping[str, Any]) -> list[str]:
    """Return options, as JSON has them, as arguments of a command line, but for defaults and unknown names."""
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
