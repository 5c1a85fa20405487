"""Kernels run as C beside the same functions in plain Python."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from recording_calls import copied

from beltarm_env.engine import compiled
from eval.exports.compilers import Toolchain, native

Kernel = Callable[..., Any]
Calls = list[tuple[Any, ...]]


def compiler() -> Toolchain:
    try:
        return native()
    except ValueError as error:
        pytest.skip(str(error))


def leaves(value: Any) -> Iterator[Any]:
    if isinstance(value, tuple):
        for part in value:
            yield from leaves(part)
    elif value is not None:
        yield value


def same(a: Any, b: Any) -> bool:
    """Whether numbers are equal to the last bit, the sign of zero included; one NaN is like another."""
    a, b = np.asarray(a, np.float64).ravel(), np.asarray(b, np.float64).ravel()
    both = np.isnan(a) & np.isnan(b)
    return len(a) == len(b) and bool(((a.view(np.int64) == b.view(np.int64)) | both).all())


class Cases(dict[str, tuple[Kernel, Kernel, Calls]]):
    """Kernels by name, each with its reference and the arguments that it is called with."""

    def case(self, *calls: tuple[Any, ...], reference: Kernel | None = None) -> Callable[[Kernel], Kernel]:
        """Make a kernel a case, with the arguments of its calls, and what gives its results in Python if not itself."""

        def add(kernel: Kernel) -> Kernel:
            self[kernel.__name__] = kernel, reference or kernel, list(calls)
            return kernel

        return add

    def check(self, name: str) -> None:
        """Assert that a kernel returns and writes in C what it does in Python."""
        kernel, reference, calls = self[name]
        in_c: Any = compiled(kernel)
        for arguments in calls:
            given, python = copied(arguments), copied(arguments)
            with np.errstate(all="ignore"):
                wanted = reference(*python)
            pairs = zip(leaves((in_c(*given), given)), leaves((wanted, python)), strict=True)
            assert all(same(a, b) for a, b in pairs), (
                f"{name}{arguments}: {wanted} in Python, {in_c(*copied(arguments))}"
            )
        assert not in_c._refused, "it does not run as C"
