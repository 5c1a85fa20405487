"""Compilation of scalar equations with numba, and the cache of compiled kernels.

Equations are plain functions of floats, written once. `inlined` marks those that kernels inline, so that LLVM sees one
flat loop over arms and vectorises it; `compiled` marks the kernels that Python calls, and `allocating` those that make
arrays. With `NUMBA_DISABLE_JIT=1` all leave the functions as they are, and the very same code runs as plain Python.

No `fastmath`: strict IEEE arithmetic is what makes one arm and arm *i* of a batch agree bit for bit.

**Parts.** numba makes machine code of every function, also of those that only kernels call, and optimises each together
with all that it calls. Here what a kernel calls is a part: numba finds its types and translates it for LLVM, and that
is all. The kernel that Python calls is linked from its parts, and only this whole is optimised, once. Compiling takes
half the time.

**Arrays.** numba counts who refers to an array, by an atomic operation wherever a kernel takes a view of one: a tenth
of the time that a filter takes. A kernel that makes no arrays needs none of this, because its caller holds them. Only
those that are marked `allocating` count, and those of their parts that make or return arrays. All other parts are the
same in all kernels.

**Cache.** numba keeps compiled kernels on disk, and takes one for fresh as long as the file that defines it is
unchanged. A kernel also holds what it inlines from other files, so here the names of the cached files carry a SHA-256
of all sources that a kernel can be made of: those of this package and of the kernel's own. An edited equation is thus
never run in its old form, wherever the cache lies (`__pycache__`, `NUMBA_CACHE_DIR`). Where the cache lacks a kernel, a
line on stderr says why the first call takes so long. A kernel that the cache has is loaded without the compiler. Of
several processes that want one which it lacks, one compiles, and the others wait.
"""

from __future__ import annotations

import gc
import hashlib
import multiprocessing
import os
import pickle
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import cache, cached_property, update_wrapper
from pathlib import Path
from typing import Any, Literal, ParamSpec, TypeVar, cast

import numba
from numba.core import config
from numba.core.caching import FunctionCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.environment import lookup_environment
from numba.core.errors import NumbaError
from numba.core.registry import CPUDispatcher
from numba.core.runtime.nrt import rtsys
from numba.core.serialize import dumps
from numba.core.targetconfig import ConfigStack
from numba.core.typed_passes import NativeLowering

from beltarm_env.sources import sources_digest

try:
    import fcntl
except ImportError:  # Windows, where all of them compile
    fcntl = None

ANNOUNCEMENT = "beltarm: compiling, about a minute, once"
PLAIN = bool(getattr(config, "DISABLE_JIT", 0))
"""Whether all functions are left as they are."""
_OPTIONS = {"nopython": True, "boundscheck": None, "error_model": "numpy", "no_cfunc_wrapper": True}
_SELDOM = 100_000, 50, 100  # objects made until cycles are looked for, and how much less often among older ones
_WIDEST = '"prefer-vector-width"="512"'
_P = ParamSpec("_P")
_R = TypeVar("_R")


def inlined(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Compile a scalar equation for inlining into kernels."""
    return function if PLAIN else cast("Callable[_P, _R]", _Inlined(function))


def compiled(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Compile a kernel that makes no arrays and raises no exception with values in it, cached on disk.

    Where it does nonetheless, compiling it raises a NumbaError.
    """
    return function if PLAIN else cast("Callable[_P, _R]", _Kernel(function))


def allocating(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Compile a kernel that makes arrays, raises exceptions with values, or calls what does, cached on disk."""
    return function if PLAIN else cast("Callable[_P, _R]", _Allocating(function))


def code_for(kernel: Callable[..., _R], *arguments: Any) -> Callable[..., _R]:
    """Return the machine code of a kernel for arguments of the types that these have.

    numba finds out the types of its arguments at each call, which takes longer than a short kernel runs. This code does
    not, and crashes on others: for calls whose arguments are the caller's own.
    """
    return kernel if PLAIN else cast("_Kernel", kernel).compile(tuple(map(numba.typeof, arguments)))


class _Inlined:
    """An equation: a part of kernels, and a kernel of its own only if Python calls it."""

    def __init__(self, function: Callable[..., Any]) -> None:
        update_wrapper(self, function)
        self.py_func = function

    def __call__(self, *arguments: Any) -> Any:
        return self._alone(*arguments)

    def __reduce__(self) -> str:
        return self.py_func.__qualname__

    @cached_property
    def _alone(self) -> _Kernel:
        return _Allocating(self.py_func)

    @cached_property
    def _parts(self) -> _Parts:
        return _Parts(self.py_func, False, forceinline=True)

    @property
    def _numba_type_(self) -> Any:
        """What numba takes the equation for where a kernel calls it."""
        return self._parts.for_caller()._numba_type_


class _Kernel(CPUDispatcher):
    """A kernel that Python calls; where another kernel calls it, a part of that one."""

    _counts = False  # who refers to an array

    def __init__(self, function: Callable[..., Any], *_: Any, **__: Any) -> None:
        options = {**_OPTIONS, "nogil": True, "_nrt": self._counts}
        super().__init__(function, targetoptions=options, pipeline_class=_WholeCompiler)
        self._cache = _ContentKeyedCache(function)

    def compile(self, sig: Any) -> Any:
        """Return machine code for arguments of some types, from the cache or compiled."""
        try:
            with _collecting_seldom():
                return super().compile(sig)
        except NumbaError as error:
            error.add_note("What makes arrays, or raises exceptions with values, is marked `allocating`.")
            raise
        finally:
            self._cache.end_turn()

    @cached_property
    def _parts(self) -> _Parts:
        return _Parts(self.py_func, self._counts)

    @property
    def _numba_type_(self) -> Any:
        return self._parts.for_caller()._numba_type_


@contextmanager
def _collecting_seldom() -> Iterator[None]:
    """Let Python look for cycles of objects less often: it took a tenth of the time that a kernel is compiled in."""
    before = gc.get_threshold()
    if before == _SELDOM:  # another thread compiles, and sets it back
        yield
        return
    gc.set_threshold(*_SELDOM)
    try:
        yield
    finally:
        gc.set_threshold(*before)


class _Allocating(_Kernel):
    """A kernel that makes arrays."""

    _counts = True


class _Parts:
    """A function that kernels call: a part of those that make arrays, and one of those that do not."""

    def __init__(self, function: Callable[..., Any], makes_arrays: bool, **options: Any) -> None:
        self._function, self._makes_arrays, self._options = function, makes_arrays, options
        self._made: dict[bool, _Part] = {}

    def for_caller(self) -> _Part:
        """Return the part for the kernel that numba compiles at the moment."""
        flags = ConfigStack.top_or_none()
        return self._part(flags is not None and bool(flags.nrt))

    def _part(self, counts: bool) -> _Part:
        if counts not in self._made:
            options = {**self._options, "_nrt": counts}
            instead = self._part(False) if counts and not self._makes_arrays else None
            self._made[counts] = _Part(self._function, targetoptions=options, instead=instead)
        return self._made[counts]


class _Part(CPUDispatcher):
    """A function that kernels call, for some of them.

    Args:
        function: What Python would run.
        targetoptions: Of numba.
        instead: Part that does not count, for callers that do: it serves them as well where it returns no array.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        *_: Any,
        targetoptions: dict[str, Any] | None = None,
        instead: _Part | None = None,
    ) -> None:
        options = {**_OPTIONS, "no_cpython_wrapper": True, **(targetoptions or {})}
        super().__init__(function, targetoptions=options, pipeline_class=_PartCompiler)
        self._instead: Any = instead

    def compile(self, sig: Any) -> Any:
        """Return what stands for the function with arguments of some types, translated if it is not yet."""
        found = self._without_counting(sig)
        if found is None:
            return super().compile(sig)
        self.overloads[tuple(sig)] = found
        return found.entry_point

    def _without_counting(self, sig: Any) -> Any:
        """Translation that does not count, if there may be one and it returns no array."""
        if self._instead is None:
            return None
        self._instead.compile(sig)
        found = self._instead.overloads[tuple(sig)]
        returned = self.targetctx.data_model_manager[found.signature.return_type]
        return None if returned.contains_nrt_meminfo() else found

    def add_overload(self, cres: Any) -> None:
        self.overloads[tuple(cres.signature.args)] = cres


class _WideLibrary(JITCodeLibrary):
    """Code that uses the widest vectors: LLVM prefers 256 bits on processors of Intel's that have 512."""

    def add_ir_module(self, ir_module: Any) -> None:
        for function in ir_module.functions:
            if not function.is_declaration:
                set.add(function.attributes, _WIDEST)  # not among those that llvmlite knows
        super().add_ir_module(ir_module)


class _PartLibrary(_WideLibrary):
    """Code of a part, neither linked nor optimised."""

    def finalize(self) -> None:
        self._finalized = True


class _WholeLibrary(_WideLibrary):
    """Code of a kernel, linked from its parts."""

    def finalize(self) -> None:
        found: dict[Any, None] = {}
        _collect(self._linking_libraries, found)
        # Callers first: LLVM leaves out what nothing calls yet.
        self._linking_libraries = list(found)[::-1]
        super().finalize()


def _collect(libraries: Iterable[Any], found: dict[Any, None]) -> None:
    """Note these libraries and all that they call, each behind what it calls."""
    for library in libraries:
        if library not in found:
            if isinstance(library, _PartLibrary):
                _collect(library._linking_libraries, found)
            found[library] = None


@register_pass(mutates_CFG=True, analysis_only=False)
class _PartLowering(NativeLowering):
    _name = "beltarm_part_lowering"

    def run_pass(self, state: Any) -> Literal[True]:
        state.library = _PartLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = True
        super().run_pass(state)
        entry = object()  # numba finds a function by what would call its machine code
        state.targetctx.insert_user_function(entry, state["cr"].fndesc, [state.library])
        state["cr"] = state["cr"]._replace(cfunc=entry)
        return True


@register_pass(mutates_CFG=True, analysis_only=False)
class _WholeLowering(NativeLowering):
    _name = "beltarm_whole_lowering"

    def run_pass(self, state: Any) -> Literal[True]:
        code = state.targetctx.codegen()
        state.library = _WholeLibrary(code, state.func_id.func_qualname)
        state.library.enable_object_caching()
        super().run_pass(state)
        for variable in state.library._final_module.global_variables:
            environment = lookup_environment(variable.name)  # what a part needs to raise
            if environment is not None:
                code.set_env(variable.name, environment)
        return True


class _PartCompiler(CompilerBase):
    lowering: Any = _PartLowering

    def define_pipelines(self) -> list[Any]:
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.passes = [(self.lowering if step is NativeLowering else step, text) for step, text in passes.passes]
        passes.finalize()
        return [passes]


class _WholeCompiler(_PartCompiler):
    lowering = _WholeLowering


class _ContentKeyedCache(FunctionCache):
    """numba's cache of one function, in files whose names carry a hash of all sources behind it."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        digest = _digest_behind(function.__module__.partition(".")[0])
        # The whole name changes, not just the stamp inside: another process may read the old files meanwhile.
        self._cache_file = _SignatureFiles(Path(self._cache_path), f"{self._impl.filename_base}-{digest}")
        self._turn: _Turn | None = None
        _drop_outdated(Path(self._cache_path), digest)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Look a kernel up; numba compiles one that is not found, and no other process has compiled meanwhile."""
        rtsys.initialize(target_context)  # all that a kernel needs to run; numba would load its compiler as well
        found = self._load_overload(sig, target_context)
        if found is None:
            _announce()
            self._turn = self._cache_file.turn(self._index_key(sig, target_context.codegen()))
            found = self._load_overload(sig, target_context)
        return found

    def end_turn(self) -> None:
        """Let other processes look up what this one has compiled, or failed to."""
        if self._turn is not None:
            self._turn.end()
            self._turn = None


class _SignatureFiles:
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
        try:
            kept, data = pickle.loads(self._path(key).read_bytes())
        except (OSError, pickle.UnpicklingError, EOFError, ValueError, AttributeError, ImportError, IndexError):
            return None  # not there, or damaged: compiled anew
        return data if kept == (numba.__version__, key) else None

    def turn(self, key: Any) -> _Turn:
        """Wait until no other process compiles this kernel."""
        return _Turn(Path(f"{self._path(key)}.lock"))

    def save(self, key: Any, data: Any) -> None:
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
    for kernel in folder.glob("*.nb[ic]*"):  # also half-written ones and locks
        if f"-{digest}." not in kernel.name:
            try:
                kernel.unlink()
            except OSError:
                continue  # another process was quicker, or the folder is read-only: then it does not fill up either
