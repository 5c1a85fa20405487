"""Hash of source files, in a module of its own: processes that run no kernel start sooner without the engine."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from pathlib import Path


def source_files(folder: Path) -> list[Path]:
    """Python files below a folder, and the C of the engine; not the C that lies in its cache."""
    found: list[Path] = []
    for place, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if name != "__pycache__"]  # where other processes build and tidy up
        ends = (".py", ".c", ".h") if Path(place).name == "c" else (".py",)
        found += [Path(place, name) for name in names if name.endswith(ends)]
    return sorted(found)


def named_sources(folder: Path) -> Iterator[tuple[str, bytes]]:
    """Yield the names and contents of source files."""
    for path in source_files(folder):
        yield path.relative_to(folder).as_posix(), path.read_bytes()


def sources_digest(*folders: Path) -> str:
    """SHA-256 of all source files below some folders, with their names."""
    total = hashlib.sha256()
    for folder in folders:
        for name, content in named_sources(folder):
            total.update(f"{name}\0".encode() + content + b"\0")
    return total.hexdigest()
