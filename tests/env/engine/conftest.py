"""Entries of C, behind the glue that calls them."""

import ctypes
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beltarm_env.engine import building

ENTRIES = r"""
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#if defined(_WIN32)
#define ENTRY __declspec(dllexport) const char *
#else
#define ENTRY __attribute__((visibility("default"))) const char *
#endif
typedef union { double d; int64_t n; void *p; } Slot;
#define GIVEN void *const *p, const double *r, const int64_t *n, Slot *out

ENTRY nothing(GIVEN) { (void)p, (void)r, (void)n, (void)out; return NULL; }
ENTRY scalars(GIVEN) { (void)p; out[0].d = r[0]; out[1].n = n[0]; out[2].n = n[1]; out[3].n = -1; return NULL; }
ENTRY numbers(GIVEN) { (void)p, (void)r; for (int k = 0; k < 4; ++k) out[k].n = n[k]; return NULL; }
ENTRY wrong(GIVEN) { (void)p, (void)r, (void)n, (void)out; return "100% wrong"; }
ENTRY wrong_elsewhere(GIVEN) { (void)p, (void)r, (void)out; return n[0] == 2 ? "wrong in the third" : NULL; }

static _Thread_local int own;
ENTRY mark(GIVEN) /* how often each share was done, and by which thread */
{
    (void)r, (void)out;
    __atomic_fetch_add((int64_t *)p[0] + n[0], 1, __ATOMIC_SEQ_CST);
    ((int64_t *)p[1])[n[0]] = (int64_t)(intptr_t)&own;
    return NULL;
}
ENTRY hold(GIVEN) /* begun, until it is let go */
{
    (void)r, (void)out;
    __atomic_store_n((int64_t *)p[0] + n[0], 1, __ATOMIC_SEQ_CST);
    while (__atomic_load_n((int64_t *)p[1], __ATOMIC_SEQ_CST) == 0) { }
    return NULL;
}
"""


@pytest.fixture(scope="session")
def glue() -> Any:
    module = building.load_glue()
    samples = np.zeros(3), np.zeros((2, 6), np.int64)[:, ::2], np.zeros(2, bool), np.zeros((0, 4), np.float32)
    assert module.know_arrays(samples)
    return module


@pytest.fixture(scope="session")
def entries() -> Path:
    return building.build(ENTRIES, "entries")


@pytest.fixture(scope="session")
def at(entries: Path) -> Callable[[str], int]:
    library = building.load(entries)

    def address(name: str) -> int:
        found = ctypes.cast(getattr(library, name), ctypes.c_void_p).value
        assert found is not None
        return found

    return address


@pytest.fixture
def kernel(glue: Any, at: Callable[[str], int]) -> Callable[..., Any]:
    """Make a kernel with one variant, that tells by a tuple which arguments it does not take."""

    def new(entry: str, spec: str, constants: tuple[Any, ...] = (), returns: str = "0", finish: Any = None) -> Any:
        made = glue.Kernel(lambda *arguments: ("missing", arguments))
        made.add(at(entry), spec, constants, returns, finish)
        return made

    return new
