"""Controllers of a user's own, named as `package.module:Class` or `path/to/file.py:Class`."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import os
import sys
import sysconfig
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any


def absolute(spec: str) -> str:
    """The same controller, however the working directory changes.

    Raises:
        ValueError: If it is not of one of the two forms.
    """
    where, colon, name = spec.rpartition(":")
    if not colon or not where or not name.isidentifier():
        raise ValueError(f"a controller is named package.module:Class or path/to/file.py:Class, got {spec!r}")
    return f"{Path(where).resolve()}:{name}" if where.endswith(".py") else spec


def factory(spec: str) -> Callable[[], Any]:
    """What makes the controller, called without arguments: a class, or a function that returns one.

    Raises:
        ValueError: If it cannot be imported, or is nothing that can be called.
    """
    where, _, name = absolute(spec).rpartition(":")
    try:
        module = _from_file(Path(where)) if where.endswith(".py") else _from_path(where)
    except Exception as error:  # whatever a user's module does when it is imported
        raise ValueError(f"{spec} cannot be imported: {type(error).__name__}: {error}") from None
    found = getattr(module, name, None)
    if not callable(found):
        public = ", ".join(sorted(key for key, value in vars(module).items() if isinstance(value, type)))
        raise ValueError(f"{where} has no class or function {name!r}; its classes: {public or 'none'}")
    return found


def _from_file(path: Path) -> ModuleType:
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}")
    _search(path.parent)  # for what lies beside it
    location = importlib.util.spec_from_file_location(f"controller_in_{path.stem}", path)
    assert location is not None and location.loader is not None
    module = importlib.util.module_from_spec(location)
    sys.modules[location.name] = module  # dataclasses look their module up
    location.loader.exec_module(module)
    return module


def _from_path(name: str) -> ModuleType:
    _search(Path.cwd())
    return importlib.import_module(name)


def _search(folder: Path) -> None:
    if str(folder) not in sys.path:
        sys.path.append(str(folder))


def identity(spec: str) -> str:
    """SHA-256 of the files that make the controller: whether kept results of it may be used again.

    It covers the files of the controller's folder and its sub-folders (of a package: of the whole package) that are
    imported, or read while the controller is made: gains and weights too. It does not cover what is read later, in
    `predict`, nor what lies elsewhere.

    Raises:
        ValueError: If it cannot be imported or made.
    """
    where, _, _ = absolute(spec).rpartition(":")
    with _files_read() as read:
        make(spec)
    module = Path(where) if where.endswith(".py") else Path(sys.modules[where].__file__ or where)
    folder = _top(module.resolve().parent)
    imported = {file for loaded in list(sys.modules.values()) if (file := getattr(loaded, "__file__", None))}
    paths = {module.resolve(), *(Path(path).resolve() for path in imported | read)}
    return digest(sorted(path for path in paths if path.is_relative_to(folder) and _is_own(path)))


def _top(folder: Path) -> Path:
    """The folder of the whole package, if this one is of a package."""
    while (folder / "__init__.py").exists():
        folder = folder.parent
    return folder


def _is_own(path: Path) -> bool:
    installed = (sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib"))
    return path.is_file() and "__pycache__" not in path.parts and not any(map(path.is_relative_to, installed))


_collecting: list[set[str]] = []


@contextmanager
def _files_read() -> Iterator[set[str]]:
    """Names of the files that are opened meanwhile, but for those that are written."""
    _begin_to_listen()
    _collecting.append(set())
    try:
        yield _collecting[-1]
    finally:
        _collecting.pop()


@cache
def _begin_to_listen() -> None:
    sys.addaudithook(_listen)  # for good: Python has no way to take one off


def _listen(event: str, arguments: tuple[Any, ...]) -> None:
    if _collecting and event == "open":
        name, _, flags = arguments
        if isinstance(name, str | bytes | os.PathLike) and not flags & (os.O_WRONLY | os.O_RDWR):
            _collecting[-1].add(os.fsdecode(name))


def digest_of_sources(*folders: Path) -> str:
    """SHA-256 of the Python files in some folders, with their names."""
    return digest(sorted(path for folder in folders for path in folder.rglob("*.py")))


def digest(paths: Iterable[Path]) -> str:
    """SHA-256 of some files, with their names."""
    total = hashlib.sha256()
    for path in paths:
        total.update(f"{path.name}\0".encode() + path.read_bytes() + b"\0")
    return total.hexdigest()


def make(spec: str) -> Any:
    """A controller of this kind.

    Raises:
        ValueError: If it cannot be made, saying why.
    """
    build = factory(spec)
    try:
        controller = build()
    except Exception as error:
        raise ValueError(f"{spec} cannot be made without arguments: {type(error).__name__}: {error}") from None
    if not callable(getattr(controller, "predict", None)):
        raise ValueError(f"{spec} has no method predict(observation, state, episode_start, deterministic)")
    return controller
