"""Kernels as C, called from Python, and what the same functions give in plain Python."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beltarm_env.engine.translation import header, types
from beltarm_env.engine.translation.arrays import contiguous
from beltarm_env.engine.translation.function import Function
from beltarm_env.engine.translation.program import Program
from beltarm_env.engine.translation.tidy import without_unused
from beltarm_env.engine.translation.types import Array, Const, Group, Scalar, Value, dtype_of, parts_of
from eval.exports.compilers import SANITISED, Toolchain, native

Kernel = Callable[..., Any]
Calls = list[tuple[Any, ...]]
CTYPES = {
    **{types.REAL: ctypes.c_double, types.SINGLE: ctypes.c_float, types.INT: ctypes.c_int64, types.BOOL: ctypes.c_bool},
}
INTEGERS = np.int64  # arrays of whole numbers, as the program has them
SANITISE = "BELTARM_TEST_SANITISED"
"""Variable of the environment that asks for kernels with sanitizers."""


def compiler() -> Toolchain:
    """This machine's compiler; the test is skipped where there is none."""
    try:
        return native()
    except ValueError as error:
        pytest.skip(str(error))


def leaves(argument: Any) -> Iterator[Any]:
    if isinstance(argument, tuple):
        for part in argument:
            yield from leaves(part)
    elif argument is not None and not isinstance(argument, Const):
        yield argument


def kind_of(leaf: Any) -> str:
    return dtype_of(leaf.dtype if isinstance(leaf, np.ndarray | np.generic) else type(leaf))


def value_of(argument: Any, parameters: list[str]) -> Value:
    """An argument as a value of the translation; numbers and arrays become parameters."""
    if isinstance(argument, Const):
        return argument
    if argument is None:
        return Const(None)
    if isinstance(argument, tuple):
        names = getattr(argument, "_fields", [f"f{k}" for k in range(len(argument))])
        make = type(argument) if hasattr(argument, "_fields") else None
        parts = zip(names, argument, strict=True)
        return Group(make, tuple((name, value_of(part, parameters)) for name, part in parts))
    kind, name = kind_of(argument), f"given_{len(parameters)}"
    if isinstance(argument, np.ndarray):
        parameters.append(f"{kind} *{name}")
        return Array(kind, argument.shape, contiguous(argument.shape), name, memory=name)
    parameters.append(f"{kind} {name}")
    return Scalar(kind, name)


def results(value: Value) -> list[Scalar]:
    if isinstance(value, Const) and value.value is None:
        return []
    if isinstance(value, Scalar):
        return [value]
    return [number for part in parts_of(value) for number in results(part)]


def translate(function: Kernel, arguments: tuple[Any, ...], program: Program, name: str = "run") -> str:
    """Public function `name(arguments, double *out)` that calls a kernel, which is added to a program."""
    parameters: list[str] = []
    values = [value_of(argument, parameters) for argument in arguments]
    scope = Function(program, {}, {})
    returned = program.call(scope, getattr(function, "py_func", function), values)
    for k, number in enumerate(results(returned)):
        scope.write(f"out[{k}] = (double)({number.code});")
    lines = "\n".join(f"    {line}" for line in ["(void)out;", *without_unused(scope)])
    head = f"void {name}({', '.join([*parameters, 'double *out'])})"
    return f"extern {head};\n{head}\n{{\n{lines}\n}}"


class Translated:
    """Kernels by name, with arguments as they are called with, in a library of C that is built and loaded."""

    def __init__(self, folder: Path, kernels: dict[str, tuple[Kernel, tuple[Any, ...]]]) -> None:
        toolchain, program = compiler(), Program()
        flags = SANITISED if SANITISE in os.environ else ()
        functions = [translate(kernel, given, program, name) for name, (kernel, given) in kernels.items()]
        (folder / "arithmetic.h").write_text(header("arithmetic.h"))
        source, library = folder / "kernels.c", folder / "kernels.so"
        head = ["#include <string.h>", '#include "arithmetic.h"', *program.struct_texts, *program.used_tables()]
        source.write_text("\n\n".join([*head, *program.texts, *functions, ""]))
        toolchain.build([source], library, "-shared", "-fPIC", *flags)
        self.library = ctypes.CDLL(str(library))

    def call(self, name: str, *arguments: Any) -> list[float]:
        """Numbers that a kernel returns; arrays among the arguments are written to."""
        given, out = [], np.full(32, np.nan)
        for leaf in leaves(arguments):
            if isinstance(leaf, np.ndarray):
                assert leaf.flags.c_contiguous
                given.append(leaf.ctypes.data_as(ctypes.c_void_p))
            else:
                given.append(CTYPES[kind_of(leaf)](leaf))
        getattr(self.library, name)(*given, out.ctypes.data_as(ctypes.c_void_p))
        return list(out)


def wholes(*numbers: int) -> Any:
    return np.array(numbers, INTEGERS)


def same(a: Any, b: Any) -> bool:
    """Whether numbers are equal to the last bit, the sign of zero included; one NaN is like another."""
    a, b = np.asarray(a, np.float64).ravel(), np.asarray(b, np.float64).ravel()
    both = np.isnan(a) & np.isnan(b)
    return bool(((a.view(np.int64) == b.view(np.int64)) | both).all())


def copied(argument: Any) -> Any:
    """An argument whose arrays can be written to."""
    if isinstance(argument, tuple):
        parts = [copied(part) for part in argument]
        return type(argument)(*parts) if hasattr(argument, "_fields") else tuple(parts)
    if isinstance(argument, Const):
        return argument.value
    return argument.copy() if isinstance(argument, np.ndarray) else argument


def assert_same(library: Translated, name: str, reference: Kernel, arguments: tuple[Any, ...]) -> None:
    """Assert that a kernel returns and writes in C what it does in Python."""
    python, compiled = copied(arguments), tuple(a if isinstance(a, Const) else copied(a) for a in arguments)
    with np.errstate(all="ignore"):
        wanted = [float(leaf) for leaf in leaves((reference(*python),))]
    result = library.call(name, *compiled)[: len(wanted)]
    assert same(wanted, result), f"{name}{arguments}: {wanted} in Python, {result} in C"
    unknown = tuple(b for a, b in zip(arguments, python, strict=True) if not isinstance(a, Const))
    for a, b in zip(leaves(unknown), leaves(compiled), strict=True):
        if isinstance(a, np.ndarray):
            assert same(a, b), f"{name}{arguments} writes {a} in Python, {b} in C"


class Cases(dict[str, tuple[Kernel, Kernel, Calls]]):
    """Kernels by name, each with its reference and the arguments that it is called with."""

    def case(self, *calls: tuple[Any, ...], reference: Kernel | None = None) -> Callable[[Kernel], Kernel]:
        """Make a kernel a case, with the arguments of its calls, and what gives its results in Python if not itself."""

        def add(kernel: Kernel) -> Kernel:
            self.add(kernel, list(calls), reference)
            return kernel

        return add

    def add(self, kernel: Kernel, calls: Calls, reference: Kernel | None = None) -> None:
        self[kernel.__name__] = kernel, reference or kernel, calls

    def library(self, folder: Path) -> Translated:
        """Translate all cases for arguments as those of their first call."""
        return Translated(folder, {name: (kernel, calls[0]) for name, (kernel, _, calls) in self.items()})

    def check(self, library: Translated, name: str, folder: Path) -> None:
        """Assert that a kernel does in C what it does in Python; for other shapes of arrays it is translated anew."""
        kernel, reference, calls = self[name]
        for k, arguments in enumerate(calls):
            own = library
            if [np.shape(each) for each in leaves(arguments)] != [np.shape(each) for each in leaves(calls[0])]:
                (folder / str(k)).mkdir()
                own = Translated(folder / str(k), {name: (kernel, arguments)})
            assert_same(own, name, reference, arguments)
