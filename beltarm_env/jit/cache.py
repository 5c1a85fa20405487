"""Cache of compiled kernels on disk.

numba takes a cached kernel for fresh as long as the file that defines it is unchanged. A kernel also holds what it
inlines from other files, so here the names of the cached files carry a SHA-256 of all sources that a kernel can be made
of: those of this package and of the kernel's own. An edited equation is thus never run in its old form, wherever the
cache lies (`__pycache__`, `NUMBA_CACHE_DIR`). Where the cache lacks a kernel, a line on stderr says why the first call
takes so long. A kernel that the cache has is loaded without the compiler. Of several processes that want one which it
lacks, one compiles, and the others wait.
"""

from __future__ import annotations

import hashlib
import multiprocessing
import os
import pickle
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core.caching import FunctionCache
from numba.core.runtime.nrt import rtsys
from numba.core.serialize import dumps

from beltarm_env.sources import sources_digest

try:
    import fcntl
except ImportError:  # Windows, where all of them compile
    fcntl = None

ANNOUNCEMENT = "beltarm: compiling what is used for the first time, seconds to a minute; it is kept"


class ContentKeyedCache(FunctionCache):
    """numba's cache of one function, in files whose names carry a hash of all sources behind it."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        digest = _digest_behind(function.__module__.partition(".")[0])
        # The whole name changes, not just the stamp inside: another process may read the old files meanwhile.
        self._cache_file = SignatureFiles(Path(self._cache_path), f"{self._impl.filename_base}-{digest}")
        self._turn: _Turn | None = None
        _drop_outdated(Path(self._cache_path), digest)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Look a kernel up; numba compiles one that is not found, and no other process has compiled meanwhile."""
        rtsys.initialize(target_context)  # all that a kernel needs to run; numba would load its compiler as well
        found = self._load_overload(sig, target_context)
        if found is None:
            announce()
            self._turn = self._cache_file.turn(self._index_key(sig, target_context.codegen()))
            found = self._load_overload(sig, target_context)
        return found

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        # With the module's name: of two by which a file is run or imported, each has its own shared kernels.
        return (*super()._index_key(sig, codegen), self._py_func.__module__)

    def end_turn(self) -> None:
        """Let other processes look up what this one has compiled, or failed to."""
        if self._turn is not None:
            self._turn.end()
            self._turn = None


class SignatureFiles:
    """Files of one function, one for each signature.

    numba has one index of all signatures instead, and of two processes that write it at a time one is forgotten, or its
    code is taken for the other's.
    """

    def __init__(self, folder: Path, name: str) -> None:
        self._folder = folder
        self._name = name

    def _path(self, key: Any) -> Path:
        return self._folder / f"{self._name}.{hashlib.sha256(repr(key).encode()).hexdigest()[:16]}.nbc"

    def load(self, key: Any) -> Any:
        """Return what was saved under a signature; None if nothing was, or it is damaged."""
        try:
            kept, data = pickle.loads(self._path(key).read_bytes())
        except (OSError, pickle.UnpicklingError, EOFError, ValueError, AttributeError, ImportError, IndexError):
            return None
        return data if kept == (numba.__version__, key) else None

    def turn(self, key: Any) -> _Turn:
        """Wait until no other process compiles this kernel."""
        return _Turn(Path(f"{self._path(key)}.lock"))

    def save(self, key: Any, data: Any) -> None:
        """Write the file of a signature."""
        path = self._path(key)
        temporary = path.with_name(f"{path.name}.{os.getpid()}")
        temporary.write_bytes(dumps(((numba.__version__, key), data)))
        temporary.replace(path)


class _Turn:
    """Turn of this process to compile a kernel, until it ends it or ends itself."""

    def __init__(self, lock: Path) -> None:
        self._lock, self._file = lock, None
        with suppress(OSError):  # a folder that is read-only
            self._file = lock.open("wb")
            if fcntl is not None:
                fcntl.flock(self._file, fcntl.LOCK_EX)

    def end(self) -> None:
        """Let the others look the kernel up."""
        if self._file is not None:
            self._lock.unlink(missing_ok=True)
            self._file.close()


@cache
def announce() -> None:
    """Say once that kernels are compiled, unless this process works for another one, which says it."""
    if multiprocessing.parent_process() is None:
        print(ANNOUNCEMENT, file=sys.stderr, flush=True)


@cache
def _digest_behind(package: str) -> str:
    """The first digits of the hash of this package's sources and of another top-level package's."""
    folders = {Path(__file__).parents[1], *map(Path, getattr(sys.modules[package], "__path__", ()))}
    return sources_digest(*sorted(folders))[:16]


@cache
def _drop_outdated(folder: Path, digest: str) -> None:
    """Delete the kernels in a folder that were compiled from other sources."""
    for kernel in folder.glob("*.nb[ic]*"):  # also half-written ones and locks
        if f"-{digest}." not in kernel.name:
            try:
                kernel.unlink()
            except OSError:
                continue  # another process was quicker, or the folder is read-only: then it does not fill up either
