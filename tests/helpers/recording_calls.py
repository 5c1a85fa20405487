"""Calls of kernels, recorded with what they return and write, and made again in plain Python."""

import io
import pickle
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beltarm_env.engine import with_constants
from beltarm_env.engine.entries import types_of
from beltarm_env.engine.kernels import Kernel, _usual, _with_new


def part_of(memory: Any, start: int, shape: tuple[int, ...], strides: tuple[int, ...], dtype: str, free: bool) -> Any:
    """Make a view: arrays that share memory share it also where a call is made again."""
    view = np.ndarray(shape, dtype, memory, start, strides)
    view.flags.writeable = free and view.flags.writeable
    return view


class _Pickler(pickle.Pickler):
    def __init__(self, file: io.BytesIO) -> None:
        super().__init__(file, protocol=5)
        self.memories: dict[int, bytearray] = {}  # of what is no array, by its identity

    def reducer_override(self, obj: Any) -> Any:
        """Keep the layout of arrays, and the memory that they share."""
        if not isinstance(obj, np.ndarray):
            return NotImplemented
        root: Any = obj
        while isinstance(root, np.ndarray) and root.base is not None:
            root = root.base
        while isinstance(root, memoryview):
            root = root.obj
        if root is obj and obj.flags.writeable:
            return NotImplemented
        if root is obj:
            return part_of, (obj.copy(), 0, obj.shape, obj.strides, obj.dtype.str, False)
        start = obj.__array_interface__["data"][0] - np.frombuffer(root, np.uint8).__array_interface__["data"][0]
        memory = root if isinstance(root, np.ndarray) else self.memories.setdefault(id(root), bytearray(root))
        return part_of, (memory, start, obj.shape, obj.strides, obj.dtype.str, obj.flags.writeable)


def _pickled(value: Any) -> bytes:
    file = io.BytesIO()
    _Pickler(file).dump(value)
    return file.getvalue()


def copied(value: Any) -> Any:
    """Copy arguments, with the layout of arrays and the memory that they share."""
    return pickle.loads(_pickled(value))


def contents(value: Any) -> Any:
    """Numbers and bytes of arrays, in tuples: what has to be equal bit for bit."""
    if isinstance(value, tuple):
        return tuple(map(contents, value))
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, float | np.floating):
        return np.float64(value).tobytes()
    if callable(value):
        return getattr(value, "py_func", value).__qualname__
    return int(value) if isinstance(value, np.integer) else value if isinstance(value, int | None) else repr(value)


@dataclass
class Calls:
    """Recorded calls: the first and the twentieth of each kernel for one choice of types."""

    made: list[tuple[str, Any, bytes, Any]] = field(default_factory=list)
    kernels: dict[str, Kernel] = field(default_factory=dict)
    _counts: Counter[Any] = field(default_factory=Counter)

    def count_anew(self) -> None:
        self._counts.clear()

    def recorded(self, kernel: Kernel, run: Callable[..., Any]) -> Callable[..., Any]:
        name = f"{kernel.__module__}:{kernel.py_func.__qualname__}"
        constants = getattr(kernel.py_func, "constants", {})

        def call(*arguments: Any, **named: Any) -> Any:
            self.kernels[name] = kernel
            key = name, *constants.values(), *types_of(tuple(map(_usual, (*arguments, *named.values()))))
            self._counts[key] += 1
            if self._counts[key] not in (1, 20):
                return run(*arguments, **named)
            before = _pickled((arguments, named))
            result = run(*arguments, **named)
            self.made.append((name, constants, before, contents((result, arguments, tuple(named.values())))))
            return result

        return call


@contextmanager
def recorded_calls() -> Iterator[Calls]:
    calls, call, bound = Calls(), Kernel.__call__, Kernel.bound

    def recorded_too(kernel: Kernel, first: tuple[Any, ...], others: tuple[Any, ...], like: Any) -> Callable[..., Any]:
        run = bound(kernel, first, others if like is None else (*others, like), None)
        call = calls.recorded(kernel, lambda *arguments: run(*arguments[len(first) :]))
        return _with_new(partial(call, *first), like)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Kernel, "__call__", lambda self, *a, **n: calls.recorded(self, call.__get__(self))(*a, **n))
        patch.setattr(Kernel, "bound", recorded_too)
        yield calls


def differing(path: Path) -> list[str]:
    """Make calls of a file again, in this process; return the names of kernels that give something else."""
    found = []
    for name, constants, before, wanted in pickle.loads(path.read_bytes()):
        module, _, function = name.partition(":")
        arguments, named = pickle.loads(before)
        kernel = getattr(import_module(module), function)
        with np.errstate(all="ignore"):
            result = (with_constants(kernel, **constants) if constants else kernel)(*arguments, **named)
        if contents((result, arguments, tuple(named.values()))) != wanted:
            found.append(name)
    return found
