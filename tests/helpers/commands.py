"""Command lines within the process of the tests, for starting Python takes seconds; and in one of their own."""

import contextlib
import io
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import patch

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("beltarm_env", "baselines", "agents", "train", "eval")


def is_command(path: Path) -> bool:
    return '__name__ == "__main__"' in path.read_text(encoding="utf-8")


def stopped(main: Callable[[], object], arguments: tuple[str, ...], folder: Path) -> tuple[int, str]:
    """Exit code and errors of a command that stops, run in a folder as its script's `main` with these arguments."""
    errors = io.StringIO()
    with (
        contextlib.chdir(folder),
        contextlib.redirect_stderr(errors),
        patch.object(sys, "argv", ["script", *arguments]),
    ):
        try:
            main()
        except SystemExit as stop:
            return int(stop.code or 0), errors.getvalue()
    return 0, errors.getvalue()


def mistake(main: Callable[[], object], arguments: tuple[str, ...], folder: Path) -> str:
    """The one line with which a command refuses these arguments, as `stopped` runs it, exiting with 2."""
    code, errors = stopped(main, arguments, folder)
    assert code == 2, errors
    (line,) = errors.strip().splitlines()
    return line


def python(*words: object, cwd: Path | None = None, path: tuple[Path, ...] = (), **environment: str) -> str:
    """Output of a Python process of its own, which ends well, with more folders to import from."""
    known = {**os.environ, **({"PYTHONPATH": os.pathsep.join(map(str, path))} if path else {}), **environment}
    command = [sys.executable, *map(str, words)]
    done = subprocess.run(command, cwd=cwd, env=known, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-4000:]
    return done.stdout


def started(*words: object, cwd: Path, **options: Any) -> subprocess.Popen[str]:
    """A Python process of its own that is not waited for, with pipes for its output and its errors."""
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([sys.executable, *map(str, words)], cwd=cwd, **pipes, **options)
