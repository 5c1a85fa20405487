"""Provenance of written results: the command, and the software that wrote them."""

from __future__ import annotations

import platform
import shlex
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

from beltarm_env import __version__

_ROOT = Path(__file__).resolve().parents[2]


def command_line() -> str:
    """Command that this process was started with."""
    script = Path(sys.argv[0])
    shown = script.resolve().relative_to(_ROOT) if script.resolve().is_relative_to(_ROOT) else script
    return shlex.join(["python", shown.as_posix(), *sys.argv[1:]])


def commit() -> str:
    """Commit of the checkout, with `-dirty` where files differ from it; "unknown" without git."""
    try:
        described = subprocess.run(
            ["git", "describe", "--always", "--dirty"], cwd=_ROOT, capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return described.stdout.strip()


def software(*packages: str) -> dict[str, object]:
    """Version and commit of this project, and versions of Python and of packages."""
    versions = {"python": platform.python_version(), **{name: version(name) for name in packages}}
    return {"version": __version__, "commit": commit(), "versions": versions}
