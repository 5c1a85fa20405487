"""Controllers of a user's own, named as `package.module:Class` or `path/to/file.py:Class`."""

import hashlib
import importlib
import importlib.util
import os
import re
import sys
from collections.abc import Callable
from contextlib import suppress
from fnmatch import fnmatch
from pathlib import Path
from types import ModuleType
from typing import Any

_NAMED = "a controller is named package.module:Class or path/to/file.py:Class"
_EXAMPLE = "an example is docs/examples/my_controller.py"
TIME_LIMIT, LONGEST = 3600.0, 7 * 86_400
"""Time that a controller may take for a batch of episodes [s], by default and at most. In the default 200 shifts
run one after the other in real time, and a quarter more."""
MOST_FILES, MOST_BYTES = 2000, 200_000_000
"""Size of a controller's folder beyond which it is not hashed: a home or a project that holds much else."""
PARTS, RESULTS = "parts", "results.json"
PICTURES = ("answer.png", "intervals.png", "residual.png", "tip_error.png", "torque.png")
WRITTEN = (RESULTS, "episodes.csv", "page.md", "report.html", *PICTURES)
"""Files that a comparison writes into the folder of its results, beside the parts that it keeps in a folder of it."""
_OTHERS = (
    ".git .hg .svn .venv* .tox .nox .conda .pixi .direnv __pycache__ .*cache .eggs .idea .vscode .*.sw? *~ .env* .ssh"
)
"""Names of what is no part of a controller beside it: version control, environments, caches, editors, secrets."""


def absolute(spec: str) -> str:
    """Specification with an absolute path, valid in any working directory.

    Raises:
        ValueError: If it is not of one of the two forms.
    """
    where, colon, name = spec.rpartition(":")
    if not colon or not where or not name.isidentifier():
        raise ValueError(f"{_NAMED}, got {spec!r}; {_EXAMPLE}")
    if not where.endswith(".py") and Path(where).is_file():
        raise ValueError(f"{_NAMED}, got {spec!r}: {where} is no Python file; {_EXAMPLE}")
    return f"{Path(where).resolve()}:{name}" if where.endswith(".py") else spec


def factory(spec: str) -> Callable[[], Any]:
    """Import the class, or the function without arguments, that makes the controller.

    Raises:
        ValueError: If it cannot be imported, or is nothing that can be called.
    """
    where, _, name = absolute(spec).rpartition(":")
    try:
        if where.endswith(".py"):
            module = _from_file(Path(where))
        else:
            _search(Path.cwd())
            module = importlib.import_module(where)
    except (Exception, SystemExit) as error:  # whatever a user's module does when it is imported
        raise ValueError(f"{spec} cannot be imported: {type(error).__name__}: {error}") from error
    maker = getattr(module, name, None)
    if not callable(maker):
        public = ", ".join(sorted(key for key, value in vars(module).items() if isinstance(value, type)))
        raise ValueError(f"{where} has no class or function {name!r}; its classes: {public or 'none'}")
    return maker


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


def _search(folder: Path) -> None:
    if str(folder) not in sys.path:
        sys.path.append(str(folder))


def home(spec: str) -> Path:
    """Folder of everything that belongs to the controller: the whole package, or the folder of a file by itself.

    Nothing of it is imported.

    Raises:
        ValueError: If there is no such file or package, or the class is nowhere in the file's text.
    """
    where, _, name = absolute(spec).rpartition(":")
    if not where.endswith(".py"):
        return _home_of_module(spec, *where.split("."))
    if not Path(where).is_file():
        raise ValueError(f"{spec} cannot be imported: there is no file {where}")
    made_otherwise = r"import \*|(globals|vars|locals|setattr|exec)\(|__getattr__"
    if not re.search(rf"\b{name}\b|{made_otherwise}", Path(where).read_text(errors="replace")):
        raise ValueError(f"{where} has no class or function {name!r}")
    folder = Path(where).resolve().parent
    while (folder.parent / "__init__.py").exists():
        folder = folder.parent
    return folder


def _home_of_module(spec: str, package: str, *inside: str) -> Path:
    _search(Path.cwd())
    try:
        spec_of = importlib.util.find_spec(package)
    except (ImportError, ValueError):
        spec_of = None
    if spec_of is None:
        raise ValueError(f"{spec} cannot be imported: No module named {package!r}")
    folders = [Path(folder).resolve() for folder in spec_of.submodule_search_locations or ()]
    for folder in folders:
        below = folder.joinpath(*inside)
        if below.with_suffix(".py").is_file() or below.is_dir():
            return folder
    if inside:
        raise ValueError(f"{spec} cannot be imported: No module named {'.'.join((package, *inside))!r}")
    return Path(spec_of.origin or ".").resolve().parent


def files_of(folder: Path, results: Path | None = None) -> list[Path] | None:
    """All files of a controller's folder in their order, but for `_OTHERS` and results of comparisons.

    None if the folder has more than `MOST_FILES` or `MOST_BYTES`, or a part of it cannot be read.
    """
    skipped = results.resolve() if results else None
    own: list[Path] = []
    entries, size = 0, 0
    with suppress(OSError):
        for root, folders, names in os.walk(folder, onerror=_raise, followlinks=True):
            here = Path(root).resolve()
            folders[:] = sorted(name for name in folders if _is_own(here / name, skipped))
            names = sorted(name for name in names if _is_own(here / name, skipped))
            files = [path for name in names if (path := Path(root, name)).is_file()]
            entries += len(folders) + len(files)
            size += sum(path.stat().st_size for path in files)
            if entries > MOST_FILES or size > MOST_BYTES:
                return None
            own += files
        return own
    return None


def identity(folder: Path, results: Path | None = None) -> str | None:
    """SHA-256 of all files of a controller's folder, see `files_of`; None if whether they are as before is unknown."""
    files, total = files_of(folder, results), hashlib.sha256()
    with suppress(OSError):
        for path in files or ():
            total.update(f"{path.relative_to(folder).as_posix()}\0".encode())
            total.update(hashlib.sha256(path.read_bytes()).digest())
        return None if files is None else total.hexdigest()
    return None


def _is_own(path: Path, results: Path | None) -> bool:
    if path.is_dir() and (path.resolve() == results or ((path / PARTS).is_dir() and (path / RESULTS).is_file())):
        return False
    kept = results is not None and path.parent == results / PARTS and path.suffix == ".safetensors"
    written = path.parent == results and path.name in WRITTEN
    return not (kept or written or any(fnmatch(path.name, pattern) for pattern in _OTHERS.split()))


def _raise(error: OSError) -> None:
    raise error


def make(spec: str) -> Any:
    """Make a controller.

    Raises:
        ValueError: If it cannot be made, saying why.
    """
    build = factory(spec)
    try:
        controller = build()
    except (Exception, SystemExit) as error:
        raise ValueError(f"{spec} cannot be made without arguments: {type(error).__name__}: {error}") from error
    if not callable(getattr(controller, "predict", None)):
        raise ValueError(f"{spec} has no method predict(observation, state, episode_start, deterministic)")
    return controller
