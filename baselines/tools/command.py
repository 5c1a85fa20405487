"""Commands: options from the command line, and one clear line for a user's mistakes, without a stack trace."""

from __future__ import annotations

import difflib
import os
import shlex
import shutil
import sys
import traceback
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from gymnasium.error import DependencyNotInstalled

Config = TypeVar("Config")


def run_command(
    file: str,
    kind: type[Config],
    work: Callable[[Config], object],
    description: str | None,
    begun: Callable[[Config], Mapping[str, Any]] | None = None,
) -> None:
    """Run a command with the options of its command line, see `options.parse`; errors as in `one_line_errors`.

    Where an option `traceback` is given, errors come with theirs.
    """
    script = f"{Path(file).parent.name}/{Path(file).name}"
    try:
        from baselines.tools.options import parse
    except ModuleNotFoundError as error:
        stop_without(script, error)
    with one_line_errors(script):
        config = parse(kind, description, begun=begun)
    with one_line_errors(script, whole=getattr(config, "traceback", False)):
        work(config)


def this_python() -> str:
    """Word that calls the interpreter that runs, in a command line that is shown: `python` only where that is it."""
    folder = Path(sys.executable).parent
    known = shutil.which("python")
    if known and Path(known).parent == folder:
        return "python"
    inside = folder.is_relative_to(Path.cwd())
    return shlex.quote(str(Path(sys.executable).relative_to(Path.cwd()) if inside else sys.executable))


def resume_command(script: str) -> str:
    """Return the command that goes on with the work of the command that runs."""
    arguments = [each for each in sys.argv[1:] if each not in ("--resume", "--overwrite")]
    return f"{this_python()} {shlex.join([script, *arguments, '--resume'])}"


def stop_without(script: str, error: ModuleNotFoundError) -> NoReturn:
    """Exit with the name of a package that is not installed, and how to install it."""
    package = (error.name or "a package").split(".")[0]
    known = str(error) if "pip install" in str(error) else f"{package} is not installed: run `make setup`"
    print(f"{script}: {known}", file=sys.stderr)
    sys.exit(2)


@contextmanager
def one_line_errors(script: str, *, whole: bool = False) -> Iterator[None]:
    """Exit with status 2 on a user's mistake, after its traceback if `whole`, and with 130 on Ctrl-C.

    Each error gets a line, which begins with the script's name.
    """
    try:
        try:
            yield
        finally:
            sys.stdout.flush()
    except BrokenPipeError:  # the reader of the output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # else Python's last flush would complain
        sys.exit(0)
    except (OSError, ValueError, DependencyNotInstalled) as error:
        if whole:
            traceback.print_exc()
        for line in str(error).splitlines():
            print(f"{script}: {line}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt as stop:
        print(f"{script}: {str(stop) or 'interrupted'}", file=sys.stderr)
        sys.exit(130)


def require_bounds(options: object, **bounds: tuple[int, int | None]) -> None:
    """Check numbers among options by their least and largest value, None for none; those that are None are not given.

    Raises:
        ValueError: If one is out of range, naming it.
    """
    for name, (least, largest) in bounds.items():
        value = getattr(options, name)
        if value is not None and not (least <= value and (largest is None or value <= largest)):
            allowed = f"be at least {least}" if largest is None else f"lie within {least} and {largest}"
            option = name.replace("_", "-")
            raise ValueError(f"--{option} must {allowed}, got {value}")


def require_known(names: Collection[str], known: Collection[str], complaint: str) -> None:
    """Check that names which a user wrote are known.

    Raises:
        ValueError: With the complaint, in which `{}` is the name, and the nearest known name or all of them.
    """
    by_letters = {one.lower(): one for one in known}
    for name in names:
        if name not in known:
            near = difflib.get_close_matches(name.lower(), by_letters, n=1)
            hint = f"did you mean {by_letters[near[0]]!r}?" if near else f"there are {', '.join(known)}"
            raise ValueError(f"{complaint.format(repr(name))}; {hint}")
