"""Packages of users, whose kernels are compiled in processes of their own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path


def package(folder: Path) -> Path:
    """Make an empty package."""
    folder.mkdir()
    (folder / "__init__.py").touch()
    return folder


def done(toy: Path, code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Some code after it was run in a process of its own."""
    known = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA")}
    return subprocess.run(
        [sys.executable, "-c", code],
        env={
            **known,
            "PYTHONPATH": str(toy.parent),
            "PYTHONDONTWRITEBYTECODE": "1",
            **environment,
        },  # *.pyc have a time too
        capture_output=True,
        text=True,
        check=True,
        timeout=300,
    )
