"""Cache of compiled kernels on disk.

A kept kernel is found again by the fingerprint of all that it is made of (see `fingerprint`), and by the sources of
this package, which compiles it. An edited equation, constant or helper is thus never run in its old form, whatever
module it is in and wherever the cache lies (`__pycache__`, `NUMBA_CACHE_DIR`). A kernel without a fingerprint is not
kept.

Where the cache lacks a kernel, a line on stderr says why the first call takes so long. A kernel that the cache has is
loaded without the compiler. Of several processes that want one which it lacks, one compiles, and the others wait. Where
nothing can be kept, each process compiles, and a line says so.
"""

from __future__ import annotations

import glob
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
import numpy as np
from numba.core.caching import FunctionCache
from numba.core.runtime.nrt import rtsys
from numba.core.serialize import dumps

from beltarm_env.jit.fingerprint import UnknownError, fingerprint
from beltarm_env.sources import sources_digest

try:
    import fcntl
except ImportError:  # Windows, where all of them compile
    fcntl = None

ANNOUNCEMENT = "beltarm: compiling kernels, which takes from seconds to a minute"
_UNKEPT = "beltarm: compiled kernels are not kept, and each process compiles them anew: {}"
_VERSIONS = numba.__version__, np.__version__
_CHECK = hashlib.sha256().digest_size
_MARK = f"-{sys.implementation.cache_tag}"
"""What names of files are known by, beside those of numba's own cache in the same folder."""
_NO_BRACKETS = str.maketrans("", "", "<>")  # of "<locals>", which Windows does not allow


class ContentKeyedCache(FunctionCache):
    """numba's cache of one function, by the contents of all that it is made of."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._turn: _Turn | None = None
        self._cache_file: Any = None
        self._why_not = "no folder can be written; set NUMBA_CACHE_DIR to one that can"
        sources = _own_sources()
        try:
            super().__init__(function)
        except (RuntimeError, OSError):  # of numba, which has found no folder
            self.disable()
            return
        if sources is None:
            self.disable()
            self._why_not = "the sources of beltarm_env are not files of a folder"
            return
        folder, path = Path(self._cache_path), Path(function.__code__.co_filename)
        name = f"{path.stem}.{function.__qualname__}{_MARK}.{sources}".translate(_NO_BRACKETS)
        self._cache_file = SignatureFiles(folder, name, single=function.__closure__ is None)
        _drop_outdated(folder, sources)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Look a kernel up; numba compiles one that is not found, and no other process has compiled meanwhile."""
        rtsys.initialize(target_context)  # all that a kernel needs to run; numba would load its compiler as well
        try:
            found = self._load_overload(sig, target_context)
            if found is None:
                announce()
                if not self._enabled:
                    _warn(self._why_not)
                else:
                    self._turn = self._cache_file.turn(self._index_key(sig, target_context.codegen()))
                    found = self._load_overload(sig, target_context)
        except UnknownError as error:
            announce()
            _warn(f"{self._py_func.__qualname__} uses {error}, and an edit of that would not be seen")
            return None
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a kernel, if it can be kept."""
        try:
            super().save_overload(sig, data)
        except UnknownError:
            pass
        except OSError as error:
            _warn(f"{error.strerror or error}: {self._cache_path}; set NUMBA_CACHE_DIR to another folder")

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        # With the module's name: of two by which a file is run or imported, each has its own shared kernels.
        made_of: Any = self._py_func
        return sig, codegen.magic_tuple(), made_of.__module__, fingerprint(made_of, sig)

    def end_turn(self) -> None:
        """Let other processes look up what this one has compiled, or failed to."""
        if self._turn is not None:
            self._turn.end()
            self._turn = None


class SignatureFiles:
    """Files of one function, one for each signature.

    numba has one index of all signatures instead, and of two processes that write it at a time one is forgotten, or its
    code is taken for the other's.

    Args:
        folder: Where they lie.
        name: What their names begin with.
        single: Whether only the newest kernel of a signature is kept: there are no others of this name.
    """

    def __init__(self, folder: Path, name: str, single: bool = True) -> None:
        self._folder = folder
        self._name = name
        self._single = single

    def _path(self, key: Any) -> Path:
        *signature, made_of = key
        return self._folder / f"{self._name}.{_short(repr((_VERSIONS, signature)))}.{_short(repr(made_of))}.nbc"

    def load(self, key: Any) -> Any:
        """Return what was saved under a signature; None if nothing was, or it is damaged."""
        with suppress(OSError):
            content = self._path(key).read_bytes()
            if content[:_CHECK] == hashlib.sha256(content[_CHECK:]).digest():
                with suppress(pickle.UnpicklingError, AttributeError, ImportError):  # of a class that is there no more
                    saved, data = pickle.loads(content[_CHECK:])
                    return data if saved == key else None
        return None

    def turn(self, key: Any) -> _Turn:
        """Wait until no other process compiles this kernel."""
        return _Turn(Path(f"{self._path(key)}.lock"))

    def save(self, key: Any, data: Any) -> None:
        """Write the file of a signature, and drop those of earlier forms of the function.

        Raises:
            OSError: If it cannot be written.
        """
        path = self._path(key)
        temporary = path.with_name(f"{path.name}.{os.getpid()}")
        content = dumps((key, data))
        try:
            temporary.write_bytes(hashlib.sha256(content).digest() + content)
            temporary.replace(path)
        except OSError:
            with suppress(OSError):
                temporary.unlink()
            raise
        if self._single:
            for other in self._folder.glob(f"{glob.escape(path.name.rsplit('.', 2)[0])}.*.nbc"):
                with suppress(OSError):
                    if other != path:
                        other.unlink()


def _short(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]


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
            with suppress(OSError):
                self._lock.unlink()
            self._file.close()


@cache
def announce() -> None:
    """Say once that kernels are compiled, unless this process works for another one, which says it."""
    _say(ANNOUNCEMENT)


@cache
def _warn(why: str) -> None:
    _say(_UNKEPT.format(why))


def _say(line: str) -> None:
    if multiprocessing.parent_process() is None:
        print(line, file=sys.stderr, flush=True)


@cache
def _own_sources() -> str | None:
    """The first digits of the hash of this package's sources; None where only byte code is installed."""
    folder = Path(__file__).parents[1]
    return sources_digest(folder)[:16] if Path(__file__).is_file() else None


@cache
def _drop_outdated(folder: Path, sources: str) -> None:
    """Delete the kernels in a folder that another state of this package compiled."""
    with suppress(OSError):
        for kernel in folder.glob(f"*{_MARK}.*.nbc*"):  # also half-written ones and locks
            if f".{sources}." not in kernel.name:
                with suppress(OSError):  # another process was quicker, or the folder is read-only
                    kernel.unlink()
