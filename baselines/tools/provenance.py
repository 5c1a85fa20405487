"""Where written results come from: the command, and the state of the sources."""

from __future__ import annotations

import shlex
import subprocess
import sys
from pathlib import Path

_ROOT = Path(__file__).resolve().parents[2]


def command_line() -> str:
    """The command that this process was started with."""
    script = Path(sys.argv[0])
    shown = script.resolve().relative_to(_ROOT) if script.resolve().is_relative_to(_ROOT) else script
    return shlex.join(["python", shown.as_posix(), *sys.argv[1:]])


def commit() -> str:
    """The commit of the checkout, with `-dirty` where files differ from it; "unknown" without git."""
    try:
        described = subprocess.run(
            ["git", "describe", "--always", "--dirty"], cwd=_ROOT, capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return described.stdout.strip()
