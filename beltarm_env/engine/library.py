"""Library of compiled kernels: what was compiled is kept, and found again by what it is made of.

A kernel's object lies under the hash of its whole C text, the flags, the compiler and the level of the processor (see
`building`). What is not in the text cannot matter, so an object is never that of an older state of the sources.

To translate takes longer than to look up. So a note says which object a call's types need. It names all functions and
values of modules that the text was made of, with a hash of each function's code, and holds only where the process has
loaded the same: after an edit, what it concerns is translated anew. A kernel of which not all can be told, such as a
closure, is translated in each process. Objects that were built beforehand come first (see `shipped`).
"""

from __future__ import annotations

import ctypes
import json
import multiprocessing
import os
import re
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from beltarm_env.engine import building, shipped
from beltarm_env.engine.entries import SYMBOL, Entry, entry_of, made
from beltarm_env.engine.translation.known import named, shown
from beltarm_env.sources import sources_digest

ANNOUNCEMENT = "beltarm: compiling kernels, which takes some seconds"
_OLD = 30 * 24 * 3600.0  # s
_OWN = re.compile(r"\w+\.[0-9a-f]{32}\.(so|dll|c|lock)|[0-9a-f]{16}/[0-9a-f]+\.json")  # files in the cache folder
Types = tuple[str, tuple[Any, ...]]


def compiled(
    function: Callable[..., Any], arguments: tuple[Any, ...], types: Types, checked: bool
) -> tuple[int, str, Callable[[Any], Any] | None]:
    """Return the address of a kernel's code, the words for its result, and what makes the result from what it gives.

    Raises:
        TranslationError: If it cannot be translated.
        BuildError: If it cannot be compiled.
    """
    words = words_of(function, types, checked)
    found, path = _shipped(words)
    note = _note_of(words) if path is None else None
    if path is None:
        found = _read(note)
        path = None if found is None else building.found(found["object"])
    if found is None or path is None:
        announce()
        entry = entry_of(function, arguments, checked)
        path = building.build(entry.text, function.__name__.strip("_"))
        returns, result = entry.returns, entry.result
        _write(note, entry, path.name)
    else:
        returns, result = found["returns"], _from_data(found["result"])
    address = ctypes.cast(getattr(building.load(path), SYMBOL), ctypes.c_void_p).value
    assert address is not None
    return address, returns, None if result is None else partial(made, result)


@cache
def announce() -> None:
    """Say once why the first calls take so long, unless this process works for another one, which says it."""
    if multiprocessing.parent_process() is None:
        print(ANNOUNCEMENT, file=sys.stderr, flush=True)


def words_of(function: Callable[..., Any], types: Types, checked: bool) -> list[Any] | None:
    """Words for a kernel and types; None if they do not tell it from others."""
    spec, constants = types
    names = [shown(one, codes=False) for one in (function, *constants)]
    return [names, spec, checked] if all(names) else None


def note_for(entry: Entry, file: str, codes: bool = True) -> dict[str, Any]:
    """Write what an object needs to be used, and what it was made of; without codes for all versions of Python."""
    read = [[*place, words[not codes]] for place, words in (entry.read or {}).items()]
    return {"object": file, "returns": entry.returns, "result": _as_data(entry.result), "read": read}


def _holds(note: dict[str, Any], codes: bool) -> bool:
    """Tell whether modules have what a kernel was made of."""
    return all(shown(named(module, name), codes) == words for module, name, words in note["read"])


def _shipped(words: list[Any] | None) -> tuple[dict[str, Any], Path | None] | tuple[None, None]:
    """Note and object of a kernel that was built beforehand."""
    built = None if words is None else shipped.kernel(words)
    if built is None or not _holds(built[1], codes=False):
        return None, None
    folder, note = built
    return note, building.found(note["object"], folder / building.level())


def _note_of(words: list[Any] | None) -> Path | None:
    """File of the note for a kernel in the cache."""
    folder = building.cache_folder()
    if folder is None or words is None:
        return None
    return folder / _translator() / f"{shipped.key_of([*words, building.setting()])}.json"


@cache
def _translator() -> str:
    """Hash of what translates."""
    return sources_digest(Path(__file__).parent)[:16]


def _read(note: Path | None) -> dict[str, Any] | None:
    if note is not None:
        with suppress(Exception):  # of a file that is damaged
            found = json.loads(note.read_text())
            _from_data(found["result"])
            return found if _holds(found, codes=True) and isinstance(found["object"] + found["returns"], str) else None
    return None


def _write(note: Path | None, entry: Entry, file: str) -> None:
    """Write a note, if it tells all: what the text is made of, and by their names the classes of the result."""
    if note is not None and entry.read is not None:
        with suppress(OSError, AttributeError, ValueError):  # of a file, or of a class that its name does not lead to
            content = note_for(entry, file)
            if _from_data(content["result"]) != entry.result:
                return
            if not note.parent.is_dir():
                note.parent.mkdir(parents=True, exist_ok=True)
                _drop_old(note.parents[1])
            temporary = note.with_name(f"{note.name}.{os.getpid()}")
            temporary.write_text(json.dumps(content))
            temporary.replace(note)


def _drop_old(folder: Path) -> None:
    """Delete what was compiled long ago: after many edits most of it is of no use, and the rest is built again."""
    for path in (*folder.glob("*"), *folder.glob("*/*.json")):
        with suppress(OSError):  # another process was quicker
            own = _OWN.fullmatch(path.relative_to(folder).as_posix())  # the folder may be a user's, with other files
            if own and path.is_file() and path.stat().st_mtime < time.time() - _OLD:
                path.unlink()


def _as_data(result: Any) -> Any:
    """Write what a result is made of, with classes by their names."""
    if result is None or result[0] == "array":
        return result
    _, make, parts = result
    name = None if make is None else f"{make.__module__}:{make.__qualname__}"
    return ["tuple", name, [_as_data(part) for part in parts]]


def _from_data(data: Any) -> Any:
    if data is None or data[0] == "array":
        return data
    _, name, parts = data
    return ("tuple", None if name is None else resolve_name(name), [_from_data(part) for part in parts])
