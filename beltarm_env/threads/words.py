"""Words of memory that several threads read and write, and how a thread waits for one that another writes.

In kernels no other thread comes between an operation's parts. Plain Python has one thread, and needs `add` and `look`.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, overload
from numpy.typing import NDArray

from beltarm_env.jit import compiled

Integers = NDArray[np.int64]

WORD = ir.IntType(64)
_POLITE = 50
"""Times after which one that waits lets another thread have its core: it may be the one that it waits for."""


def operation(define: Callable[..., Any]) -> Callable[..., Any]:
    """Make an operation that kernels call without the first of its arguments, which is numba's."""
    return intrinsic(define)


def add(words: Integers, index: int, more: int) -> int:
    """Add to a word, and return what it was before."""
    words[index] += more
    return int(words[index] - more)


def look(words: Integers, index: int) -> int:
    """Return a word that other threads write."""
    return int(words[index])


@compiled
def wait(looks: int) -> int:
    """Wait for a moment, and return how often this was done."""
    _pause()
    if looks % _POLITE == _POLITE - 1:
        _yield_core()
    return looks + 1


@operation
def _add_atomically(_: Any, words: Any, index: Any, more: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        where = _where(context, builder, signature, values)
        return builder.atomic_rmw("add", where, values[2], "seq_cst")

    return types.int64(words, types.intp, types.int64), generate


@operation
def _look_anew(_: Any, words: Any, index: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.load_atomic(_where(context, builder, signature, values), "acquire", align=8)

    return types.int64(words, types.intp), generate


@overload(add, inline="always")
def _add_compiled(words: Any, index: Any, more: Any) -> Any:
    def add(words: Any, index: Any, more: Any) -> Any:
        return _add_atomically(words, index, more)

    return add


@overload(look, inline="always")
def _look_compiled(words: Any, index: Any) -> Any:
    def look(words: Any, index: Any) -> Any:
        return _look_anew(words, index)

    return look


@operation
def exchange(_: Any, words: Any, index: Any, before: Any, after: Any) -> Any:
    """Write a word if it is still what it was before, and return whether it was."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        where = _where(context, builder, signature, values)
        return builder.extract_value(builder.cmpxchg(where, values[2], values[3], "seq_cst", "seq_cst"), 1)

    return types.boolean(words, types.intp, types.int64, types.int64), generate


@operation
def address(_: Any, words: Any, index: Any) -> Any:
    """Return the address of a word."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.ptrtoint(_where(context, builder, signature, values), WORD)

    return types.int64(words, types.intp), generate


@operation
def write(_: Any, address: Any, value: Any) -> Any:
    """Write a word for other threads to see, and all that was written before."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        where = builder.inttoptr(values[0], WORD.as_pointer())
        builder.store_atomic(values[1], where, "seq_cst", align=8)
        return context.get_dummy_value()

    return types.void(types.int64, types.int64), generate


@operation
def _pause(_: Any) -> Any:
    """Leave what two threads have of one core to the other, where processors know how."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        if platform.machine().lower() in ("x86_64", "amd64"):
            kind = ir.FunctionType(ir.VoidType(), [])
            builder.call(cgutils.get_or_insert_function(builder.module, kind, "llvm.x86.sse2.pause"), [])
        return context.get_dummy_value()

    return types.void(), generate


@operation
def _yield_core(_: Any) -> Any:
    """Let another thread have the core, if one wants it."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        name = "SwitchToThread" if os.name == "nt" else "sched_yield"
        kind = ir.FunctionType(ir.IntType(32), [])
        builder.call(cgutils.get_or_insert_function(builder.module, kind, name), [])
        return context.get_dummy_value()

    return types.void(), generate


def _where(context: Any, builder: Any, signature: Any, values: Any) -> Any:
    of = signature.args[0]
    array = context.make_array(of)(context, builder, values[0])
    return cgutils.get_item_pointer(context, builder, of, array, [values[1]])
