"""What a kernel is made of beside its arguments: functions and values of modules, in words that tell them apart."""

from __future__ import annotations

import hashlib
import inspect
import sys
from functools import cache
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np


class Missing:
    """What a name stands for that a module does not have."""


def named(module: str, name: str) -> Any:
    """Return what a name of a module stands for, such as `Arm.speed`; `Missing` if there is none."""
    found: Any = sys.modules.get(module, Missing)
    for part in name.split("."):
        found = getattr(found, part, Missing)
    return found


def shown(value: Any, codes: bool = True) -> str:
    """Write what a kernel reads, so that two that are not the same differ in it.

    Args:
        value: A number, word or array, a function or kernel, a class, a module, or a tuple or slice of these.
        codes: Whether of functions their code counts, and not their name alone. It differs between versions of Python.

    Returns:
        Nothing for what cannot be told from others: a dict, a function that depends on a call that made it, or a
        function, class or module that its own name does not stand for any more.
    """
    value = getattr(value, "py_func", value)
    if value is None or type(value) in (str, int, float, bool) or isinstance(value, np.generic):
        return repr(value)
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape} {value.strides} {hashlib.sha256(value.tobytes()).hexdigest()}"
    if isinstance(value, slice):
        return f"slice {shown((value.start, value.stop, value.step), codes)}"
    if isinstance(value, tuple):
        parts = [shown(part, codes) for part in value]
        made = f"{type(value).__name__} {getattr(value, '_fields', ())}"
        return f"{made} ({', '.join(parts)})" if all(parts) else ""
    if isinstance(value, ModuleType):
        return value.__name__ if sys.modules.get(value.__name__) is value else ""
    if isinstance(value, BuiltinFunctionType | np.ufunc) or _is_of_numpy(value):
        return f"{type(value).__name__} {value.__name__}"  # versions of NumPy differ in their modules
    if isinstance(value, FunctionType):
        return _of_function(value, codes)
    return _of_class(value) if isinstance(value, type) else ""


def _is_of_numpy(value: Any) -> bool:
    return callable(value) and not isinstance(value, type) and (value.__module__ or "").partition(".")[0] == "numpy"


def _of_class(made: Any) -> str:
    fields, defaults = getattr(made, "_fields", ()), tuple(getattr(made, "_field_defaults", {}).items())
    of_defaults = shown(defaults) if defaults else "none"
    if named(made.__module__, made.__qualname__) is made:
        return f"{made.__module__}.{made.__qualname__} {fields} {of_defaults}" if of_defaults else ""
    return f"{fields} {of_defaults}" if fields and of_defaults else ""  # a named tuple is its fields


def _of_function(function: Any, codes: bool) -> str:
    source, known = inspect.unwrap(function), named(function.__module__ or "", function.__qualname__)
    own = function.__defaults__, tuple((function.__kwdefaults__ or {}).items()), constants_of(function)
    words = shown(own, codes)
    same = getattr(known, "py_func", known) is source and source.__code__ is function.__code__
    if function.__closure__ or not same or not words:
        return ""
    return f"{function.__module__}.{function.__qualname__} {words} {_hash(function.__code__) if codes else ''}"


def constants_of(function: Any) -> tuple[Any, ...]:
    """Return names and values of the constants that a kernel has instead of its module's, see `with_constants`."""
    return tuple(sorted((getattr(function, "constants", None) or {}).items()))


@cache
def _hash(code: CodeType) -> str:
    return hashlib.sha256(repr((code.co_firstlineno, made_of(code))).encode()).hexdigest()[:16]


def made_of(code: CodeType) -> tuple[Any, ...]:
    """Return what two codes have in common that do the same."""
    inner = [made_of(one) if isinstance(one, CodeType) else repr(one) for one in code.co_consts]
    return code.co_code, code.co_names, code.co_varnames, code.co_freevars, *inner
