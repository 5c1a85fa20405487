"""Command lines within the process of the tests: a user's mistakes are many, and starting Python takes seconds."""

import contextlib
import io
import sys
from collections.abc import Callable
from pathlib import Path
from unittest.mock import patch


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
