"""Errors of commands: one clear line for a user's mistakes, without a stack trace."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NoReturn


def stop_without(script: str, error: ModuleNotFoundError) -> NoReturn:
    """Exit with the name of a package that is not installed, and how to install it."""
    package = (error.name or "a package").split(".")[0]
    known = str(error) if "pip install" in str(error) else f"{package} is not installed: run `make setup`"
    print(f"{script}: {known}", file=sys.stderr)
    sys.exit(2)


@contextmanager
def one_line_errors(script: str) -> Iterator[None]:
    """Exit with status 2 on a user's mistake, and with 130 on Ctrl-C, with one line of text."""
    try:
        yield
    except BrokenPipeError:  # the reader of the output has seen enough
        sys.exit(0)
    except (OSError, ValueError) as error:
        print(f"{script}: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt as stop:
        print(f"{script}: {str(stop) or 'interrupted'}", file=sys.stderr)
        sys.exit(130)
