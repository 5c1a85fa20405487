"""Provenance of a page's data: command, version, commit, machine, and a digest of the code that measured them.

The digest says whether the same code would measure the same data today. It is of Python's syntax trees, without
docstrings and comments, of all modules that the measurement imports, of the module's own functions only those that it
uses, and of other files that they read: tuned gains, shipped policies and observers, the engine's C, scenarios. So
words, tables and pictures change no digest. Versions of packages are those of constraints.txt, and not in it.
"""

import ast
import hashlib
import os
import platform
import re
from collections.abc import Iterable, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from baselines.tools.provenance import command_line, commit
from beltarm_env import __version__

ROOT = Path(__file__).resolve().parents[2]
_PACKAGES = ("beltarm_env", "baselines", "agents", "train", "eval")
_FILES = {
    "beltarm_env/engine/c/*.[ch]": "beltarm_env",
    "beltarm_env/mujoco/*.xml": "beltarm_env.mujoco",
    "baselines/gains.json": "baselines",
    "baselines/optimal/robust.json": "baselines",
    "agents/policies*/**/*.safetensors": "agents.policy",
    "agents/observer/shipped/*.safetensors": "agents.observer",
    "eval/comparison/scenarios.json": "eval.comparison.sets",
    "eval/report/verdict*": "eval.comparison.run",
    "eval/exports/templates/*.[ch].j2": "eval.exports",
}
"""Files that a measurement depends on if it reaches a package, or a module of it."""
_STARTS = ("measure", "Options")
"""Names of a module from which all that measures is reached."""


def provenance(module: str, starts: Iterable[str] = _STARTS) -> dict[str, Any]:
    """Provenance of what a module is about to measure by its functions `starts`: of the code that is there now."""
    return {
        "command": command_line(),
        "version": __version__,
        "commit": commit(),
        "python": platform.python_version(),
        "machine": f"{_processor()}, {os.cpu_count()} cores",
        "inputs": inputs_digest(module, tuple(starts)),
    }


def _processor() -> str:
    """Name of this machine's processor, as far as its system tells."""
    with suppress(OSError, IndexError):  # Linux names it there, but not on every processor
        named = re.findall(r"^model name\s*: (.*)", Path("/proc/cpuinfo").read_text(encoding="utf-8"), re.MULTILINE)
        return f"{platform.machine()}, {named[0]}"
    return platform.processor() or platform.machine()


def origin(about: dict[str, Any]) -> str:
    """Line about the provenance of data."""
    python = f"Python {about['python']} on {about['machine']}"
    return f"`{about['command']}`, beltarm {about['version']} ({about['commit']}), {python}, {about['seconds']:.0f} s."


def inputs_digest(module: str, starts: Iterable[str] = _STARTS) -> str:
    """SHA-256 of the code, gains and policies that a measurement depends on."""
    total = hashlib.sha256()
    reached, waiting = {module: _reached(_path(module), tuple(starts))}, [module]
    while waiting:
        for other in sorted(_imports(reached[waiting.pop()])):
            if other not in reached:
                reached[other] = _statements(_path(other))
                waiting.append(other)
    for name in sorted(reached):
        total.update(f"{name}\0{_digest(reached[name])}\0".encode())
    for pattern, package in _FILES.items():
        reads = any(name == package or name.startswith(f"{package}.") for name in reached)
        for path in sorted(ROOT.glob(pattern)) if reads else ():
            total.update(path.relative_to(ROOT).as_posix().encode() + path.read_bytes())
    return total.hexdigest()


@cache
def _digest(statements: tuple[ast.stmt, ...]) -> str:
    """SHA-256 of the syntax trees of statements."""
    return hashlib.sha256("\0".join(map(ast.dump, statements)).encode()).hexdigest()


def _path(module: str) -> Path:
    """File of a module of this project."""
    path = ROOT / module.replace(".", "/")
    return path / "__init__.py" if path.is_dir() else path.with_suffix(".py")


@cache
def _statements(path: Path) -> tuple[ast.stmt, ...]:
    """Statements of a module without docstrings."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [part for part in body if not _is_text(part)] or [ast.Pass()]  # pyright: ignore[reportAttributeAccessIssue]
    return tuple(tree.body)


def _is_text(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _reached(path: Path, starts: tuple[str, ...]) -> tuple[ast.stmt, ...]:
    """Statements of a module that its functions and classes `starts` use, one through the other."""
    statements = _statements(path)
    kept, wanted = set[ast.stmt](), set(starts)
    while found := {node for node in statements if node not in kept and wanted.intersection(_bound(node))}:
        kept |= found
        wanted |= {each.id for node in found for each in ast.walk(node) if isinstance(each, ast.Name)}
    return tuple(node for node in statements if node in kept)


def _bound(node: ast.stmt) -> Iterator[str]:
    """Names that a statement binds."""
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        yield node.name
    elif isinstance(node, ast.Import | ast.ImportFrom):
        yield from ((alias.asname or alias.name).split(".")[0] for alias in node.names)
    else:
        yield from (
            each.id for each in ast.walk(node) if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store)
        )


@cache
def _imports(statements: tuple[ast.stmt, ...]) -> set[str]:
    """Modules of this project that some statements import, inside functions too, with their packages."""
    named: set[str] = set()
    for node in (each for statement in statements for each in ast.walk(statement)):
        if isinstance(node, ast.Import):
            named |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            named |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    own = {name for name in named if name.split(".")[0] in _PACKAGES}
    packages = {".".join(name.split(".")[:k]) for name in own for k in range(1, name.count(".") + 1)}
    return {name for name in own | packages if _path(name).is_file()}
