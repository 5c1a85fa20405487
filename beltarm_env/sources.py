"""Hash of source files; by itself, for processes that run no kernel start sooner without numba."""

from __future__ import annotations

import hashlib
from pathlib import Path


def sources_digest(*folders: Path) -> str:
    """SHA-256 of all Python files below some folders, with their names."""
    total = hashlib.sha256()
    for folder in folders:
        for path in sorted(folder.rglob("*.py")):
            total.update(f"{path.relative_to(folder).as_posix()}\0".encode() + path.read_bytes() + b"\0")
    return total.hexdigest()
