"""Provenance of written results: the command, and the software that wrote them."""

from __future__ import annotations

import hashlib
import os
import platform
import shlex
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from baselines.tools.files import sha256_of
from beltarm_env import __version__
from beltarm_env.sources import sources_digest

_ROOT = Path(__file__).resolve().parents[2]
_OF_ANOTHER = ("GIT_DIR", "GIT_WORK_TREE", "GIT_INDEX_FILE", "GIT_COMMON_DIR", "GIT_OBJECT_DIRECTORY")  # as hooks set
_PACKAGES = ("gymnasium", "ziglang", "numpy", "optuna", "sb3-contrib", "scipy", "stable-baselines3", "torch")


def command_line() -> str:
    """Command that this process was started with."""
    script = Path(sys.argv[0])
    shown = script.resolve().relative_to(_ROOT) if script.resolve().is_relative_to(_ROOT) else script
    return shlex.join(["python", shown.as_posix(), *sys.argv[1:]])


def commit() -> str:
    """Commit of the checkout, with `-dirty` where files differ from it.

    "unknown" without git, and where these sources are no checkout of their own: in a folder of another repository, or
    at its top and in none of its commits.
    """
    try:
        return _git("describe", "--always", "--dirty")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def last_commit_of(path: Path) -> str:
    """Hash of the last commit that changed a file of the checkout.

    Raises:
        ValueError: If the file is in no commit, differs from its last one, or there is no git or no checkout.
    """
    try:
        changed, found = _git("status", "--porcelain", "--", path), _git("log", "-1", "--format=%H", "--", path)
    except (OSError, subprocess.CalledProcessError) as error:
        raise ValueError(f"git does not tell the last commit of {path.name}: {error}") from None
    if changed or not found:
        raise ValueError(f"{path.name} is not committed as it is: commit it first")
    return found


def _git(*arguments: str | Path) -> str:
    """What git says of the checkout.

    Raises:
        OSError: If there is no git, or another repository would answer.
        CalledProcessError: If git cannot answer.
    """
    environment = {name: value for name, value in os.environ.items() if name not in _OF_ANOTHER}

    def ask(*arguments: str | Path) -> str:
        found = subprocess.run(
            ["git", *arguments], cwd=_ROOT, env=environment, capture_output=True, text=True, check=True
        )
        return found.stdout.strip()

    if ask("rev-parse", "--show-prefix") or not ask("ls-files", "--", Path(__file__).resolve()):
        raise FileNotFoundError(f"{_ROOT} is not a checkout of its own")
    return ask(*arguments)


def code_and_packages() -> str:
    """Hash of all that numbers depend on besides options and files: code, tuned gains, Python and its packages."""
    code = sources_digest(*(_ROOT / folder for folder in ("beltarm_env", "baselines", "agents", "train", "eval")))
    gains = [sha256_of(_ROOT / "baselines" / name) for name in ("gains.json", "optimal/robust.json")]
    packages = [f"{name} {_version(name)}" for name in _PACKAGES]
    return hashlib.sha256("\n".join([code, *gains, platform.python_version(), *packages]).encode()).hexdigest()


def _version(package: str) -> str:
    """Version of a package; "none" where it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "none"


def software(*packages: str) -> dict[str, object]:
    """Version and commit of this project, and versions of Python and of packages."""
    versions = {"python": platform.python_version(), **{name: version(name) for name in packages}}
    return {"version": __version__, "commit": commit(), "versions": versions}
