"""What a kernel is made of beside its arguments: functions and values of modules, in words that tell them apart."""

from __future__ import annotations

import hashlib
import inspect
import sys
from functools import cache
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np


def named(module: str, name: str) -> Any:
    """Return what a name of a module stands for, such as `Arm.speed`; None if there is none."""
    found: Any = sys.modules.get(module)
    for part in name.split("."):
        found = getattr(found, part, None)
    return found


def shown(value: Any, codes: bool = True) -> str:
    """Write what a kernel reads, so that two that are not the same differ in it.

    Args:
        value: A number, word or array, a function or kernel, a class, a module, or a tuple of these.
        codes: Whether of functions their code counts, and not their name alone. It differs between versions of Python.

    Returns:
        Nothing for what cannot be told from others, such as a dict, or a function that depends on a call that made it.
    """
    value = getattr(value, "py_func", value)
    if value is None or isinstance(value, str | int | float | np.generic):
        return repr(value)
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape} {hashlib.sha256(value.tobytes()).hexdigest()}"
    if isinstance(value, tuple):
        parts = [shown(part, codes) for part in value]
        return f"{type(value).__name__}({', '.join(parts)})" if all(parts) else ""
    if isinstance(value, ModuleType):
        return value.__name__
    if isinstance(value, FunctionType) and not value.__module__.startswith("numpy."):
        return _of_function(value, codes)
    if isinstance(value, type):
        fields = getattr(value, "_fields", ()), getattr(value, "_field_defaults", {})
        return "" if "<" in value.__qualname__ else f"{value.__module__}.{value.__qualname__} {fields}"
    return getattr(value, "__name__", "") if callable(value) else ""  # versions of NumPy differ in their modules


def _of_function(function: FunctionType, codes: bool) -> str:
    defaults = shown((function.__defaults__, tuple((function.__kwdefaults__ or {}).items())), codes)
    wrapped = inspect.unwrap(function).__code__ is not function.__code__
    if "<" in function.__qualname__ or function.__closure__ or wrapped or not defaults:
        return ""
    return f"{function.__module__}.{function.__qualname__} {defaults} {_hash(function.__code__) if codes else ''}"


@cache
def _hash(code: CodeType) -> str:
    return hashlib.sha256(repr((code.co_firstlineno, made_of(code))).encode()).hexdigest()[:16]


def made_of(code: CodeType) -> tuple[Any, ...]:
    """Return what two codes have in common that do the same."""
    inner = [made_of(one) if isinstance(one, CodeType) else repr(one) for one in code.co_consts]
    return code.co_code, code.co_names, code.co_varnames, code.co_freevars, *inner
