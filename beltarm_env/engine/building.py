"""Shared objects, compiled from C texts and kept in a cache.

An object is named by the hash of all that it is made of: its C text with what that includes, the flags, the compiler's
version and the level of the processor. Old code is never run, and what is there already needs no compiler's time.
Settings come from the environment:

- `BELTARM_CC`: command line of the compiler, such as `gcc`; else the package `ziglang` is used, if it is installed.
- `BELTARM_LEVEL`: level of the processor, such as `x86_64_v3`; else that of this machine.
- `BELTARM_CACHE_DIR`: folder of the cache; else `__pycache__` of this package, or the user's cache folder.
"""

from __future__ import annotations

import ctypes
import os
import platform
import re
import shlex
import shutil
import struct
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from hashlib import sha256
from importlib.machinery import EXTENSION_SUFFIXES, ExtensionFileLoader
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

try:
    import fcntl
except ImportError:  # Windows, where all processes compile
    fcntl = None

SOURCES = Path(__file__).parent / "c"
FLAGS = "-O3", "-g0", "-std=c11", "-ffp-contract=off", "-fno-math-errno", "-fvisibility=hidden", "-shared"
"""Flags of every object. Without contraction of products and sums, results are those of plain Python.

With `-fno-trapping-math`, gcc 12 makes -0.0 of `float(int(-0.9))`.
"""
_LEVELS = "baseline", "x86_64", "x86_64_v2", "x86_64_v3", "x86_64_v4"
_INCLUDE = re.compile(r'^#include "(\w+\.h)"$', re.MULTILINE)
_RUNTIME = "-rtlib=none"
_INSIDE = "-mllvm", "-hoist-runtime-checks=false"
"""clang compares the places of arrays before an inner loop, to run it in vectors where they lie apart. If it does so
before the outer loop, two rows of one array never lie apart, and the loop over their columns is one by one."""
_WIDE = "-mprefer-vector-width=512"  # half as long for the loops over arms
_LAST = "-mllvm", "-epilogue-vectorization-minimum-VF=8"  # also over the last arms, fewer than such a vector holds


class BuildError(Exception):
    """Failure to build a shared object, with what the compiler says."""


class UnavailableError(BuildError):
    """Failure to build anything on this machine."""


class Compiler(NamedTuple):
    """Compiler of C.

    Args:
        command: Its command line, without flags.
        version: Text that differs between versions.
        zig: Whether it is that of Zig, which names processors in its own way.
    """

    command: tuple[str, ...]
    version: str
    zig: bool


def compiler() -> Compiler | None:
    """Return the compiler; None if there is none."""
    told = os.environ.get("BELTARM_CC", "")
    return _told_compiler(told) if told.strip() else _packaged_compiler()


@cache
def _told_compiler(told: str) -> Compiler:
    words = shlex.split(told, posix=os.name != "nt")
    zig = any(Path(word).stem in ("zig", "ziglang") for word in words)
    version = told
    with suppress(OSError):
        path = Path(shutil.which(words[0]) or words[0]).resolve()
        seen = path.stat()
        version = f"{told} {path} {seen.st_size} {seen.st_mtime_ns}"
    if zig and "ziglang" in words:
        version = f"{version} {_ziglang_version()}"
    return Compiler(tuple(words), version, zig)


@cache
def _packaged_compiler() -> Compiler | None:
    spec = find_spec("ziglang")
    if spec is None or spec.origin is None:
        return None
    program = Path(spec.origin).with_name("zig.exe" if os.name == "nt" else "zig")
    return Compiler((str(program), "cc"), f"ziglang {_ziglang_version()}", zig=True) if program.is_file() else None


def _ziglang_version() -> str:
    from importlib.metadata import PackageNotFoundError, version  # slow to import

    try:
        return version("ziglang")
    except PackageNotFoundError:
        return "unknown"


def level() -> str:
    """Return the level of instructions of this machine: `x86_64` to `x86_64_v4`, `baseline` for other processors."""
    told = os.environ.get("BELTARM_LEVEL", "")
    if told:
        return told
    module = glue()
    return baseline() if module is None else _LEVELS[module.level()]


def baseline() -> str:
    """Return the level that every machine of this kind has."""
    return "x86_64" if platform.machine().lower() in ("x86_64", "amd64") else "baseline"


def cache_folder() -> Path | None:
    """Return the folder that keeps objects, the first that can be written; None if there is none."""
    return next((folder for folder in _folders() if _can_be_written(folder)), None)


def _folders() -> list[Path]:
    told = os.environ.get("BELTARM_CACHE_DIR", "")
    folders = [Path(told).expanduser()] if told else []
    folders.append(Path(__file__).parent / "__pycache__")
    with suppress(RuntimeError):  # a user without a home folder
        folders.append(_user_folder() / "beltarm")
    return folders


def _user_folder() -> Path:
    if os.name == "nt":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


@cache
def _can_be_written(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def build(
    text: str, name: str, *, target: str | None = None, options: Sequence[str] = (), system: str | None = None
) -> Path:
    """Build a shared object, if the cache does not have it.

    Args:
        text: C. Files in the folder `c` of this package may be included.
        name: What the names of its files begin with.
        target: Level of the processor; None for that of this machine.
        options: Further flags.
        system: Another kind of machine by Zig's name, such as `aarch64-linux-gnu.2.17`; None for this one.

    Returns:
        Its file. The C text lies beside it.

    Raises:
        BuildError: If it cannot be built.
    """
    program = compiler()
    if program is None:
        from beltarm_env.engine import shipped

        why = "there is no compiler; install the package ziglang, or set BELTARM_CC"
        changed = shipped.changed_source()
        raise UnavailableError(why if changed is None else f"{changed} was changed after the kernels were built. {why}")
    whole = _with_included(text)
    flags = (*FLAGS, *_machine_flags(program, target or level(), system), *options)
    digest = sha256("\0".join((whole, *flags, program.version, system or platform.machine())).encode()).hexdigest()
    file = f"{name}.{digest[:32]}{'.dll' if _is_windows(system) else '.so'}"
    for folder in _folders():
        if _is_usable(folder / file, system):
            return folder / file
    folder = cache_folder()
    if folder is None:
        raise UnavailableError("no folder can be written; set BELTARM_CACHE_DIR to one that can")
    path = folder / file
    try:
        with _turn(path):
            if not _is_usable(path, system):  # no other process has built it meanwhile
                _compile(program, flags, whole, path, system)
    except OSError as error:
        raise BuildError(f"{name}: {error}") from error
    return path


def found(file: str, *folders: Path) -> Path | None:
    """Return the object of a name that was built before, in the cache or some folders; None if there is none."""
    return next((path for folder in folders or _folders() if _is_usable(path := folder / file)), None)


def setting() -> tuple[str, str, str]:
    """Return what objects depend on beside their text: the compiler, the level and the machine."""
    program = compiler()
    return "" if program is None else program.version, level(), platform.machine()


def load(path: Path) -> ctypes.CDLL:
    """Load a shared object; its entries are those of `build`.

    Raises:
        OSError: If it is damaged.
    """
    return ctypes.CDLL(str(path))


@cache
def glue() -> ModuleType | None:
    """Return the module `_glue`, which calls kernels; None if it can neither be found nor built."""
    try:
        return load_glue()
    except BuildError:
        return None


def load_glue() -> ModuleType:
    """Load the module `_glue`: the one that was built beforehand, or one that is built.

    Raises:
        BuildError: If it cannot be built, or this Python has another binary interface.
    """
    if sys.implementation.name != "cpython" or re.search(r"\dt", EXTENSION_SUFFIXES[0]):
        raise BuildError("_glue: it is made for CPython with its global lock")
    from beltarm_env.engine import shipped

    path = shipped.glue()
    if path is None:  # built for every machine of this kind
        library = [str(Path(sys.base_prefix) / "libs" / "python3.lib")] if os.name == "nt" else []
        path = build(glue_text(), "_glue", target=baseline(), options=glue_options(library))
    name = f"{__package__}._glue"
    spec = spec_from_file_location(name, path, loader=ExtensionFileLoader(name, str(path)))
    assert spec is not None and spec.loader is not None
    try:
        module = module_from_spec(spec)
        spec.loader.exec_module(module)
    except ImportError as error:
        raise BuildError(f"_glue: {error}") from error
    return module


def glue_text() -> str:
    """Return the C of the module `_glue`."""
    return (SOURCES / "glue.c").read_text(encoding="utf-8")


def glue_options(library: list[str], system: str | None = None) -> list[str]:
    """Return flags for names that Python defines: on Windows, the import library of these."""
    macos = sys.platform == "darwin" if system is None else "macos" in system
    return ["-Wl,-undefined,dynamic_lookup"] if macos else library


def _with_included(text: str) -> str:
    """Put files in the place of the lines that include them: then the text is all that an object is made of."""
    seen: set[str] = set()

    def content(match: re.Match[str]) -> str:
        path = SOURCES / match[1]
        if match[1] in seen:
            return ""
        seen.add(match[1])
        return _INCLUDE.sub(content, path.read_text(encoding="utf-8")) if path.is_file() else match[0]

    return _INCLUDE.sub(content, text)


def _is_windows(system: str | None) -> bool:
    return os.name == "nt" if system is None else "windows" in system


def _machine_flags(program: Compiler, target: str, system: str | None) -> tuple[str, ...]:
    flags = () if _is_windows(system) else ("-fPIC",)  # code of Windows is always so
    if system is not None:
        flags = (*flags, "-target", system)
    if program.zig:
        flags = (*flags, *_INSIDE)
    if target == "baseline":
        return (*flags, "-mcpu=baseline") if program.zig else flags
    wide = [_WIDE, *(_LAST if program.zig else ())] if target == "x86_64_v4" else []
    march = target if program.zig else target.replace("x86_64_", "x86-64-").replace("_", "-")
    return *flags, f"-march={march}", *wide


def _is_usable(path: Path, system: str | None = None) -> bool:
    """Tell whether an object is there and not damaged; one of another kind of machine is not loaded for that."""
    try:
        if not _complete(path):
            return False
        if system is None:
            load(path)
    except OSError:
        return False
    return True


def _complete(path: Path) -> bool:
    """Tell whether a file has its end, as far as that is known of Linux's: to load one that was cut is a bus error.

    Raises:
        OSError: If it cannot be read.
    """
    with path.open("rb") as file:
        head = file.read(64)
        size = os.fstat(file.fileno()).st_size
    if head[:5] != b"\x7fELF\x02" or len(head) < 64:
        return size > 0
    (table,), (entry_size, entries) = struct.unpack_from("Q", head, 40), struct.unpack_from("HH", head, 58)
    return table + entry_size * entries <= size


@contextmanager
def _turn(path: Path) -> Iterator[None]:
    """Wait until no other process builds this object."""
    if fcntl is None:
        yield
        return
    lock = path.with_suffix(".lock")
    with lock.open("wb") as file:
        with suppress(OSError):  # a file system without locks
            fcntl.flock(file, fcntl.LOCK_EX)
        try:
            yield
        finally:
            lock.unlink(missing_ok=True)


def _compile(program: Compiler, flags: Sequence[str], text: str, path: Path, system: str | None = None) -> None:
    """Compile a text, and put it and the object into their place at once.

    Raises:
        BuildError: If the compiler fails.
        OSError: If there is no such compiler, or a file cannot be written.
    """
    with tempfile.TemporaryDirectory(prefix="build-", dir=path.parent) as scratch:
        source = path.with_suffix(".c")
        written = Path(scratch) / source.name
        written.write_text(text, encoding="utf-8")
        written.replace(source)
        made = Path(scratch) / path.name
        # The runtime library of Zig's compiler takes seconds to build and is seldom needed.
        linux = sys.platform == "linux" if system is None else "linux" in system
        lean = [_RUNTIME] if program.zig and linux else []
        libraries = [] if _is_windows(system) else ["-lm"]
        _run(program, [*flags, *lean], source, made, libraries)
        if lean and system is None and not _is_usable(made):
            _run(program, flags, source, made, libraries)
        with made.open("rb") as file:
            os.fsync(file.fileno())
        with suppress(PermissionError):  # on Windows, where another process has built it and uses it
            made.replace(path)


def _run(program: Compiler, flags: Sequence[str], source: Path, made: Path, libraries: Sequence[str]) -> None:
    import subprocess  # slow to import

    environment = {
        # What it keeps of a library serves all objects, and the rest is needed only once.
        "ZIG_GLOBAL_CACHE_DIR": str(source.parent / "zig"),
        "ZIG_LOCAL_CACHE_DIR": str(made.parent),
        **os.environ,
    }
    command = [*program.command, *flags, "-o", str(made), str(source), *libraries]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, errors="replace", check=False)
    if done.returncode != 0 or not made.is_file():
        raise BuildError(f"{source.name}: {shlex.join(command)}\n{done.stderr.strip()}")
