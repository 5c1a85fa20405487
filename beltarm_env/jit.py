"""How this package compiles its scalar equations with numba.

Equations are plain functions of floats, written once. `inlined` marks those that kernels inline, so that LLVM sees one
flat loop over arms and vectorises it; `compiled` marks the kernels that Python calls. With `NUMBA_DISABLE_JIT=1` both
leave the functions as they are, and the very same code runs as plain Python.

Without wrappers for C callers, which nobody calls, compiling takes a third less time.

No `fastmath`: strict IEEE arithmetic is what makes one arm and arm *i* of a batch agree bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import ParamSpec, TypeVar, cast

import numba

_P = ParamSpec("_P")
_R = TypeVar("_R")


def drop_stale_kernels(package: Path) -> None:
    """Delete a package's cached kernels that are older than any source file of it or of this package.

    numba compares a cached kernel with the file that defines it, not with the files whose functions it inlines, so an
    edited equation would otherwise go on running in its old form.
    """
    sources = [*Path(__file__).parent.rglob("*.py"), *package.rglob("*.py")]
    newest = max(source.stat().st_mtime for source in sources)
    for kernel in package.rglob("*.nb[ic]"):
        try:
            if kernel.stat().st_mtime < newest:
                kernel.unlink()
        except OSError:
            continue  # another process was quicker, or the folder is read-only: then its sources do not change either


def inlined(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Compile a scalar equation for inlining into kernels."""
    options = {"cache": True, "error_model": "numpy", "forceinline": True, "no_cfunc_wrapper": True}
    return cast("Callable[_P, _R]", numba.njit(**options)(function))


def compiled(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Compile a kernel, cached on disk."""
    options = {"cache": True, "error_model": "numpy", "nogil": True, "no_cfunc_wrapper": True}
    return cast("Callable[_P, _R]", numba.njit(**options)(function))


drop_stale_kernels(Path(__file__).parent)
