"""Kernels: Python functions that run as C.

`compiled` marks a function that Python calls, `inlined` an equation that is written into the loops of those that call
it. Python is the source and the reference: the C of a kernel is a translation of it and of all that it calls, and gives
the same bits. What a call needs is translated and compiled when it is first made, and kept (see `library`).

`BELTARM_ENGINE` chooses how kernels run:

    c          as C, the default; in plain Python where there is no compiler and nothing was built
    plain      in plain Python, which is the place to look with a debugger
    checked    as C that checks every index, where a ValueError names function and line, and every sum and product of
               whole numbers, where it says that one overflowed
"""

from __future__ import annotations

import inspect
import os
import sys
from collections.abc import Callable
from functools import cache, cached_property, partial, update_wrapper
from threading import RLock
from types import FunctionType
from typing import Any, ParamSpec, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from beltarm_env.engine import building, library
from beltarm_env.engine.entries import types_of
from beltarm_env.engine.translation.types import TranslationError

ENGINES = ("c", "plain", "checked")
ENGINE = os.environ.get("BELTARM_ENGINE") or "c"
if ENGINE not in ENGINES:
    raise ValueError(f"BELTARM_ENGINE must be one of {', '.join(ENGINES)}, got {ENGINE!r}")
PLAIN = ENGINE == "plain"
"""Whether all functions are left as they are."""
_P = ParamSpec("_P")
_R = TypeVar("_R")


def inlined(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Mark an equation that is written into the kernels that call it."""
    cast("Any", function).inlined = True
    return compiled(function)


def compiled(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Mark a kernel that Python calls, or others."""
    return function if PLAIN else cast("Callable[_P, _R]", Kernel(function))


def bound(
    kernel: Callable[..., _R], first: tuple[Any, ...], *others: Any, like: NDArray[Any] | None = None
) -> Callable[..., _R]:
    """Return what runs a kernel behind its first arguments in the least time, as `functools.partial` would.

    Args:
        kernel: So short that other threads of Python may wait for it.
        first: Arguments, which are looked at now: their arrays keep memory, shape and flags.
        *others: Of the types that all further ones will have.
        like: An array, in C's order: the last argument is a new one like it in each call, and its caller leaves it out.
            Floats come as arrays of shape (1,) then, as actions do.
    """
    if isinstance(kernel, Kernel):
        return kernel.bound(first, others, like)
    return _with_new(partial(kernel, *first), like)


def _with_new(run: Callable[..., _R], like: NDArray[Any] | None) -> Callable[..., _R]:
    return run if like is None else lambda *others: run(*map(_entry, others), np.empty_like(like))


def _entry(argument: Any) -> float:
    """Return the entry of an array of floats of shape (1,)."""
    if (
        not isinstance(argument, np.ndarray)
        or argument.shape != (1,)
        or argument.dtype.name not in ("float32", "float64")
    ):
        raise TypeError("an array of floats of shape (1,) is expected")
    return argument.item()


@cache
def with_constants(kernel: Callable[_P, _R], **constants: float) -> Callable[_P, _R]:
    """Return a kernel for which some global names have other values, there and in all that it calls."""
    function = _copy_of(kernel, constants, {})
    return Kernel(function) if isinstance(function, FunctionType) and isinstance(kernel, Kernel) else function


def _copy_of(function: Any, constants: dict[str, float], made: dict[Any, Any]) -> Any:
    """Copy a function that reads some global names, itself or through others; return one that does not as it is."""
    plain = getattr(function, "py_func", function)
    if not isinstance(plain, FunctionType):
        return function
    if plain not in made:
        made[plain] = function
        known = {name: plain.__globals__[name] for name in plain.__code__.co_names if name in plain.__globals__}
        constants = {**getattr(plain, "constants", {}), **constants}
        copies = {name: constants.get(name, _copy_of(value, constants, made)) for name, value in known.items()}
        if any(copies[name] is not value for name, value in known.items()):
            read = {**plain.__globals__, **copies}
            copy = FunctionType(plain.__code__, read, None, plain.__defaults__, plain.__closure__)
            made[plain] = update_wrapper(copy, plain)
            made[plain].constants = constants
    return made[plain]


def in_threads(kernel: Callable[..., object], threads: int, *arguments: Any) -> None:
    """Run a kernel in several threads, this one among them, until the work is done.

    Args:
        kernel: Takes the index of a thread and the arguments; ends when nothing is left to do, see `take_block`.
        threads: Their number; fewer, where the system allows no more.
        *arguments: The same for all.
    """
    if isinstance(kernel, Kernel) and threads > 1:
        kernel.share(threads, arguments)
    else:
        kernel(0, *arguments)


class Kernel:
    """A function that runs as C once it is called.

    Args:
        function: What Python would run.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        update_wrapper(self, function)
        self.py_func = function
        self._compiled: Any = None  # of the glue
        self._run: Callable[..., Any] = self._first
        self._refused: set[Any] = set()  # types for which it runs in plain Python
        self._variants: dict[Any, int] = {}
        self._lock = RLock()  # of what threads that call it at the same time make

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        """Run it."""
        return self._run(*arguments) if not named else self._run(*self._ordered(arguments, named))

    def __reduce__(self) -> str:
        """Name what a copy is: the function of that name in its module."""
        return self.py_func.__qualname__

    def bound(self, first: tuple[Any, ...], others: tuple[Any, ...], like: NDArray[Any] | None) -> Callable[..., Any]:
        """Return what runs it behind its first arguments, see `bound`."""
        variant = self._variant((*first, *others) if like is None else (*first, *others, like))
        if variant is None:
            return _with_new(partial(self._in_python, *first), like)
        return self._compiled.bind(variant, first, like)

    def share(self, threads: int, arguments: tuple[Any, ...]) -> None:
        """Run it in several threads, see `in_threads`."""
        compiled: Any = self._compiled
        if compiled is not None and compiled.share(threads, *arguments) is None:
            return
        usual = tuple(map(_usual, arguments))
        variant = self._variant((0, *usual))
        if variant is None:
            self.py_func(0, *usual)
        elif self._compiled.share(threads, *usual) is not None:
            self._compiled.bind(variant, ())(0, *usual)  # which says what does not fit

    def _ordered(self, arguments: tuple[Any, ...], named: dict[str, Any]) -> tuple[Any, ...]:
        bound = self._signature.bind(*arguments, **named)
        bound.apply_defaults()
        return tuple(bound.arguments.values())

    def _in_python(self, *arguments: Any) -> Any:
        """Run it in plain Python, with arguments in the order of its parameters, all of them or the first ones."""
        named = self._by_name
        if not named or len(arguments) < len(self._signature.parameters):
            return self.py_func(*arguments)
        return self.py_func(*arguments[: -len(named)], **dict(zip(named, arguments[-len(named) :], strict=True)))

    @cached_property
    def _signature(self) -> inspect.Signature:
        return inspect.signature(self.py_func)

    @cached_property
    def _by_name(self) -> list[str]:
        return [one.name for one in self._signature.parameters.values() if one.kind is one.KEYWORD_ONLY]

    def _first(self, *arguments: Any) -> Any:
        self._begin()
        return self._run(*arguments)

    def _begin(self) -> None:
        with self._lock:
            if self._run != self._first:
                return
            glue = _glue()
            if glue is None:
                self._run = self._in_python
            else:
                self._compiled = glue.Kernel(self._missing)
                self._run = self._compiled.call

    def _variant(self, arguments: tuple[Any, ...]) -> int | None:
        """Number of the variant for arguments of some types, made if there is none; None where it runs in Python."""
        if self._compiled is None and self._run == self._first:
            self._begin()
        if self._compiled is None:
            return None
        try:
            types = types_of(arguments)
        except TranslationError as error:
            self._refuse(tuple(map(type, arguments)), error)
            return None
        if types in self._refused:
            return None
        with self._lock:
            return self._variants[types] if types in self._variants else self._made(types, arguments)

    def _made(self, types: Any, arguments: tuple[Any, ...]) -> int | None:
        try:
            address, returns, finish = library.compiled(self.py_func, arguments, types, ENGINE == "checked")
        except (TranslationError, building.BuildError) as error:
            self._refuse(types, error)
            return None
        self._variants[types] = number = self._compiled.add(address, *types, returns, finish)
        return number

    def _refuse(self, types: Any, error: Exception) -> None:
        if isinstance(error, building.UnavailableError):
            self._refused.add(types)
            _say_once(str(error))
        elif types not in self._refused:
            self._refused.add(types)
            name = f"{self.__module__}.{self.py_func.__qualname__}"
            lines = str(error).splitlines()
            why = next((line for line in lines if " error: " in line), lines[0])  # of a compiler, before its command
            print(f"beltarm: {name} runs in plain Python: {why}", file=sys.stderr, flush=True)

    def _missing(self, *arguments: Any) -> Any:
        """Run a call for which there is no variant yet."""
        if len(arguments) != len(self._signature.parameters):
            arguments = self._ordered(arguments, {})
        usual = tuple(map(_usual, arguments))
        variant = self._variant(usual)
        return self._in_python(*arguments) if variant is None else self._compiled.bind(variant, ())(*usual)


@cache
def _glue() -> Any:
    """Return the module that calls compiled kernels; None without one, with a line that says why."""
    try:
        glue: Any = building.glue() or building.load_glue()  # which says why there is none
    except building.BuildError as error:
        _say_once(str(error))
        return None
    glue.know_arrays((np.zeros(3), np.zeros((2, 6), np.int64)[:, ::2], np.zeros(2, bool), np.zeros((0, 4), np.float32)))
    return glue


@cache
def _say_once(why: str) -> None:
    print(f"beltarm: kernels run in plain Python, which is slow: {why}", file=sys.stderr, flush=True)


def _usual(argument: Any) -> Any:
    """Turn a number of NumPy into Python's; float32 is one that C would compute with otherwise.

    Words are known by their identity.
    """
    if type(argument) is str:
        return sys.intern(argument)
    if isinstance(argument, np.generic) and argument.dtype.name in ("bool", "float64", "int64", "int32"):
        return argument.item()
    return argument
