"""What Python and kernels call: functions that numba compiles as kernels, and as parts of kernels."""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from copy import copy
from functools import cached_property, partial, update_wrapper
from typing import Any, ParamSpec, TypeVar, cast
from uuid import uuid4

import llvmlite.binding as llvm
import numba
from numba.core import config
from numba.core.compiler_lock import global_compiler_lock
from numba.core.errors import NumbaError, TypingError
from numba.core.registry import CPUDispatcher
from numba.core.targetconfig import ConfigStack

from beltarm_env.jit.cache import ContentKeyedCache
from beltarm_env.jit.linking import Elsewhere, PartCompiler, WholeCompiler

PLAIN = bool(getattr(config, "DISABLE_JIT", 0))
"""Whether all functions are left as they are."""
_OPTIONS = {
    "nopython": True,
    "boundscheck": None,
    "error_model": "numpy",
    "no_cfunc_wrapper": True,
    # Else as whatever calls it:
    "forceinline": False,
    "fastmath": False,
}
_SELDOM = 100_000, 50, 100  # objects made until cycles are looked for, and how much less often among older ones
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


def shared(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Compile a kernel as `compiled` does, of which all that call it run the same machine code, cached on disk.

    For functions of modules that are long and that several kernels call: their calls are not inlined.
    """
    return function if PLAIN else cast("Callable[_P, _R]", _Shared(function))


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
        super().__init__(function, targetoptions=options, pipeline_class=WholeCompiler)
        self._cache = ContentKeyedCache(function)

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


class _Shared(_Kernel):
    """A kernel that others call where its machine code is."""

    def __reduce__(self) -> Any:
        return self.py_func.__qualname__

    def compile(self, sig: Any) -> Any:
        """Return machine code for arguments of some types, from the cache or compiled."""
        with global_compiler_lock:
            if self.is_compiling:  # it would wait for itself
                raise TypingError(f"{self.py_func.__name__} calls itself, and so cannot be `shared`")
            return super().compile(sig)

    def provide(self, types: Any, name: str) -> None:
        """Tell LLVM where machine code for arguments of some types is, and by which name a kernel calls it."""
        self.compile(types)
        found = self.overloads[types]
        llvm.add_symbol(name, found.library.get_pointer_to_function(found.fndesc.llvm_func_name))

    @property
    def is_found_by_name(self) -> bool:
        """Whether it is what its module has by its name, so that a kernel from the cache finds it."""
        found: Any = sys.modules[self.__module__]
        for name in self.py_func.__qualname__.split("."):
            found = getattr(found, name, None)
        return found is self

    @cached_property
    def _callers(self) -> _Call:
        return _Call(self)

    @property
    def _numba_type_(self) -> Any:
        return self._callers._numba_type_


class _Call(CPUDispatcher):
    """A shared kernel as others see it: its name, and that it must be there."""

    def __init__(self, kernel: _Shared) -> None:
        super().__init__(kernel.py_func, targetoptions=_OPTIONS)
        self._kernel: Any = kernel

    def compile(self, sig: Any) -> Any:
        """Return what stands for the kernel with arguments of some types, compiled if it is not yet."""
        kernel, types = self._kernel, tuple(sig)
        if types not in self.overloads:
            # Kept with the code of those that call it: nothing else has that name, in no process.
            name = f"beltarm.{uuid4().hex}"
            kernel.provide(types, name)
            found = kernel.overloads[types]
            self._require_callable(found.signature.return_type)
            called = copy(found.fndesc)
            called.mangled_name = name
            library = Elsewhere(kernel.targetctx.codegen(), name, partial(kernel.provide, types, name))
            entry = object()
            kernel.targetctx.insert_user_function(entry, called, [library])
            self.overloads[types] = found._replace(entry_point=entry, fndesc=called, library=library)
        return self.overloads[types].entry_point

    def _require_callable(self, returned: Any) -> None:
        what = self.py_func.__qualname__
        if not self._kernel.is_found_by_name:
            raise TypingError(f"{what} is not what its module has by that name: mark it `compiled`, not `shared`")
        if _holds_array(self._kernel.targetctx, returned):  # it counts none, and its callers may
            raise TypingError(f"{what} returns an array: mark it `allocating`, not `shared`")


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
        super().__init__(function, targetoptions=options, pipeline_class=PartCompiler)
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
        return None if _holds_array(self.targetctx, found.signature.return_type) else found

    def add_overload(self, cres: Any) -> None:
        self.overloads[tuple(cres.signature.args)] = cres


def _holds_array(context: Any, returned: Any) -> bool:
    return context.data_model_manager[returned].contains_nrt_meminfo()
