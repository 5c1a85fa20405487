"""Kernels that were built beforehand: with those that a wheel holds, `BeltArm-v0` runs as C without a compiler.

The folder `built` of this package, which `prebuild` writes and nothing else:

    sources.json             hash of each source file
    SOURCES/_glue.abi3.so    the module that calls kernels
    SOURCES/kernels.json     a note of each kernel: its object, and what its result is
    SOURCES/LEVEL/OBJECT     its object for a level of the processor

SOURCES is the hash of all sources: after any change of them, nothing that was built from others is found.
"""

from __future__ import annotations

import hashlib
import json
import os
from functools import cache
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from typing import Any

from beltarm_env.sources import named_sources, sources_digest

PACKAGE = Path(__file__).parents[1]
BUILT = Path(__file__).parent / "built"


@cache
def sources() -> str:
    """Return the hash of the sources of `beltarm_env`."""
    return sources_digest(PACKAGE)[:16]


def key_of(words: list[Any]) -> str:
    """Return the key of a kernel's note.

    Args:
        words: What tells it from others of the same sources.
    """
    return hashlib.sha256(json.dumps(words).encode()).hexdigest()[:24]


def kernel(words: list[Any]) -> tuple[Path, dict[str, Any]] | None:
    """Return the folder of all levels, and a kernel's note; None if it was not built from the sources as they are."""
    folder = _folder()
    if folder is None or os.environ.get("BELTARM_CC"):  # whose code is wanted, then
        return None
    note = _notes(folder).get(key_of(words))
    return None if note is None else (folder, note)


@cache
def _notes(folder: Path) -> dict[str, Any]:
    try:
        return json.loads((folder / "kernels.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}


def glue() -> Path | None:
    """Return the file of the module `_glue`; None if it was not built from the sources as they are."""
    folder = _folder()
    files = [] if folder is None else [folder / f"_glue{end}" for end in EXTENSION_SUFFIXES]
    return next((file for file in files if file.is_file()), None)


def changed_source() -> str | None:
    """Name a source file that is not what it was when kernels were built; None if there is none."""
    try:
        built = json.loads((BUILT / "sources.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    now = source_hashes()
    return next((f"beltarm_env/{name}" for name in sorted({*built, *now}) if built.get(name) != now.get(name)), None)


def source_hashes() -> dict[str, str]:
    """Return the hash of each source file."""
    return {name: hashlib.sha256(content).hexdigest() for name, content in named_sources(PACKAGE)}


def _folder() -> Path | None:
    if not BUILT.is_dir():
        return None
    folder = BUILT / sources()
    return folder if folder.is_dir() else None
