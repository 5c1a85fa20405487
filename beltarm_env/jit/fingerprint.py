"""Fingerprint of a kernel: a hash of all that its machine code is made of.

numba takes a cached kernel for fresh as long as one file is unchanged. But a kernel is also made of the functions that
it calls, in whatever module they are, and of the values that their globals have when it is compiled. A fingerprint
holds the byte code and constants of all these functions, and these values. numba's own index has no such key: of a
helper that is edited in another file it runs the old form (numba, "Caching limitations").

What is neither a marked function nor a plain value has no fingerprint, and a kernel that uses it is not kept.
"""

from __future__ import annotations

import dis
import hashlib
from collections.abc import Iterable, Iterator
from enum import Enum
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np
from numba import types

_PLAIN = (type(None), type(Ellipsis), bool, int, float, complex, str, bytes)
_TYPES = (types.Number, types.Boolean, types.Array, types.NoneType, types.UnicodeType, types.Omitted)
_FIXED = ("builtins", "math", "cmath", "operator", "numpy", "numba", "llvmlite", "typing")
"""Packages that change with the versions of numba and NumPy alone, which the cache's key holds."""

_described: dict[FunctionType, tuple[bytes, tuple[FunctionType, ...]]] = {}


class UnknownError(Exception):
    """A kernel uses something whose contents are unknown."""


def fingerprint(kernel: FunctionType, arguments: Iterable[Any]) -> str:
    """SHA-256 of all that a kernel is made of.

    Args:
        kernel: What Python would run.
        arguments: Their types, as numba has them.

    Raises:
        UnknownError: If it uses something whose contents are unknown; names it.
    """
    total = hashlib.sha256()
    for argument in arguments:
        total.update(_of_type(argument))
    reached, left = {kernel}, [kernel]
    while left:
        description, called = _of_function(left.pop())
        total.update(hashlib.sha256(description).digest())
        new = [function for function in called if function not in reached]
        reached.update(new)
        left += dict.fromkeys(new)
    return total.hexdigest()


def _of_type(argument: Any) -> bytes:
    if isinstance(argument, types.BaseTuple):
        parts: Any = argument
        made = _of_value(parts.instance_class, [], set()) if isinstance(argument, types.BaseNamedTuple) else b""
        return b"(%b%b)" % (made, b"".join(map(_of_type, parts)))
    if not isinstance(argument, _TYPES):
        raise UnknownError(f"an argument of the type {argument}")
    return f"{argument!s};".encode()


def _of_function(function: FunctionType) -> tuple[bytes, tuple[FunctionType, ...]]:
    """Byte code, constants, defaults and globals of one function, and the functions that it calls."""
    if function not in _described:
        code, called = function.__code__, list[FunctionType]()
        names = set(_names(code))
        around = [cell.cell_contents for cell in function.__closure__ or ()]
        parts = [_of_code(code), *(_of_value(value, called, names) for value in (function.__defaults__, *around))]
        for name in sorted(names & function.__globals__.keys()):
            try:
                parts.append(name.encode() + _of_value(function.__globals__[name], called, names))
            except UnknownError:
                if name in _global_names(code):  # not only the name of a field, too
                    raise
        _described[function] = b"\0".join(parts), tuple(called)
    return _described[function]


def _names(code: CodeType) -> Iterator[str]:
    """Names of globals and of fields, of a function and of those within it."""
    yield from code.co_names
    for inside in _codes(code):
        yield from _names(inside)


def _global_names(code: CodeType) -> set[str]:
    found = {step.argval for step in dis.get_instructions(code) if step.opname in ("LOAD_GLOBAL", "LOAD_NAME")}
    return found.union(*map(_global_names, _codes(code)))


def _codes(code: CodeType) -> Iterator[CodeType]:
    return (constant for constant in code.co_consts if isinstance(constant, CodeType))


def _of_code(code: CodeType) -> bytes:
    constants = [_of_code(one) if isinstance(one, CodeType) else _of_constant(one) for one in code.co_consts]
    rest = code.co_names, code.co_varnames, code.co_freevars, code.co_argcount, code.co_kwonlyargcount, code.co_flags
    return b"\0".join([code.co_code, repr(rest).encode(), *constants])


def _of_constant(constant: Any) -> bytes:
    shown = sorted(map(repr, constant)) if isinstance(constant, frozenset) else constant
    return f"{type(constant).__name__} {shown!r}".encode()


def _of_value(value: Any, called: list[FunctionType], names: set[str]) -> bytes:
    """Contents of a value that a function uses; functions are added to those that it calls.

    Args:
        value: Of a global, a default, or a variable around the function.
        called: Functions, to be extended.
        names: All names in the function, among them those that it looks up in modules.
    """
    kind = f"{type(value).__module__}.{type(value).__qualname__} "
    if isinstance(value, _PLAIN):
        return f"{kind}{value!r}".encode()
    if isinstance(value, Enum):
        return f"{kind}{value.name} {value.value!r}".encode()
    if isinstance(value, tuple):
        fields = getattr(value, "_fields", ())
        return f"{kind}{fields!r}".encode() + b"".join(_of_value(part, called, names) for part in value)
    if isinstance(value, np.ndarray | np.generic) and not value.dtype.hasobject:
        return f"{kind}{value.dtype.descr!r} {value.shape!r} ".encode() + value.tobytes()
    marked = getattr(value, "py_func", None)
    if isinstance(marked, FunctionType):
        called.append(marked)
        return kind.encode()
    if isinstance(value, ModuleType):
        return _of_module(value, called, names)
    if isinstance(value, type) and issubclass(value, tuple) and hasattr(value, "_fields"):
        return f"{value.__module__}.{value.__qualname__} {getattr(value, '_fields', ())!r}".encode()
    if _is_fixed(value):
        return f"{kind}{getattr(value, '__qualname__', value)!s}".encode()
    raise UnknownError(f"{getattr(value, '__qualname__', kind.strip())!s}")


def _of_module(module: ModuleType, called: list[FunctionType], names: set[str]) -> bytes:
    """Contents of what a function may look up in a module."""
    found = module.__name__.encode()
    if not _is_within(module.__name__, *_FIXED):
        for name in sorted(names & vars(module).keys()):
            # Less this name, so that modules that hold each other come to an end.
            found += name.encode() + _of_value(vars(module)[name], called, names - {name})
    return found


def _is_fixed(value: Any) -> bool:
    """Whether a function, type or operation changes with a version or with this package's sources alone."""
    home = getattr(value, "__module__", None) or type(value).__module__
    if _is_within(home, *_FIXED):
        return True
    own = __name__.partition(".")[0]
    return _is_within(home, own) and not isinstance(value, type | BuiltinFunctionType)


def _is_within(module: str, *packages: str) -> bool:
    return module.partition(".")[0] in packages
