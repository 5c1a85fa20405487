"""Compilation of scalar equations with numba, and the cache of compiled kernels.

Equations are plain functions of floats, written once. `inlined` marks those that kernels inline, so that LLVM sees one
flat loop over arms and vectorises it; `compiled` marks the kernels that Python calls. With `NUMBA_DISABLE_JIT=1` both
leave the functions as they are, and the very same code runs as plain Python.

Without wrappers for C callers, which nobody calls, compiling takes a third less time.

No `fastmath`: strict IEEE arithmetic is what makes one arm and arm *i* of a batch agree bit for bit.

**Cache.** numba keeps compiled kernels on disk, and takes one for fresh as long as the file that defines it is
unchanged. A kernel also holds what it inlines from other files, so here the names of the cached files carry a SHA-256
of all sources that a kernel can be made of: those of this package and of the kernel's own. An edited equation is thus
never run in its old form, wherever the cache lies (`__pycache__`, `NUMBA_CACHE_DIR`). Where the cache lacks a kernel, a
line on stderr says why the first call takes so long.
"""

from __future__ import annotations

import hashlib
import multiprocessing
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import numba
from numba.core.caching import FunctionCache, IndexDataCacheFile

ANNOUNCEMENT = "beltarm: compiling, about a minute, once"
_P = ParamSpec("_P")
_R = TypeVar("_R")


def inlined(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Compile a scalar equation for inlining into kernels."""
    return _jitted(function, forceinline=True)


def compiled(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Compile a kernel, cached on disk."""
    return _jitted(function, nogil=True)


def _jitted(function: Callable[_P, _R], **more: Any) -> Callable[_P, _R]:
    options = {"error_model": "numpy", "no_cfunc_wrapper": True, **more}
    jitted: Any = numba.njit(**options)(function)
    if jitted is not function:  # not with NUMBA_DISABLE_JIT=1
        jitted._cache = _ContentKeyedCache(function)
    return cast("Callable[_P, _R]", jitted)


def sources_digest(*folders: Path) -> str:
    """SHA-256 of all Python files below some folders, with their names."""
    total = hashlib.sha256()
    for folder in folders:
        for path in sorted(folder.rglob("*.py")):
            total.update(f"{path.relative_to(folder).as_posix()}\0".encode() + path.read_bytes() + b"\0")
    return total.hexdigest()


class _ContentKeyedCache(FunctionCache):
    """numba's cache of one function, in files whose names carry a hash of all sources behind it."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        digest = _digest_behind(function.__module__.partition(".")[0])
        # The whole name changes, not just the stamp inside: another process may read the old files meanwhile.
        self._cache_file = IndexDataCacheFile(self._cache_path, f"{self._impl.filename_base}-{digest}", digest)
        _drop_outdated(Path(self._cache_path), digest)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Look a kernel up; numba compiles one that is not found."""
        found = super().load_overload(sig, target_context)
        if found is None:
            _announce()
        return found


@cache
def _announce() -> None:
    """Say once that kernels are compiled, unless this process works for another one, which says it."""
    if multiprocessing.parent_process() is None:
        print(ANNOUNCEMENT, file=sys.stderr, flush=True)


@cache
def _digest_behind(package: str) -> str:
    """The first digits of the hash of this package's sources and of another top-level package's."""
    folders = {Path(__file__).parent, *map(Path, getattr(sys.modules[package], "__path__", ()))}
    return sources_digest(*sorted(folders))[:16]


@cache
def _drop_outdated(folder: Path, digest: str) -> None:
    """Delete the kernels in a folder that were compiled from other sources."""
    for kernel in folder.glob("*.nb[ic]"):
        if f"-{digest}." not in kernel.name:
            try:
                kernel.unlink()
            except OSError:
                continue  # another process was quicker, or the folder is read-only: then it does not fill up either
