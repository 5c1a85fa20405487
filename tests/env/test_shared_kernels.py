"""Kernels that several others call: compiled once, found from the cache, and refused where they cannot be."""

import subprocess
import sys
from pathlib import Path

import pytest
from toys import done, package


@pytest.fixture
def toy(tmp_path: Path) -> Path:
    """A package of a user."""
    return package(tmp_path / "toy")


SHARING = """
import numpy as np
from beltarm_env.jit import allocating, compiled, inlined, shared

@shared
def total(row, factor):
    result = 0.0
    for value in row:
        result += factor * np.exp(value)
    return result

@inlined
def half(row):
    return total(row, 0.5)

@compiled
def mean(row):
    return total(row, 1.0) / len(row) + half(row)

@allocating
def normed(row):
    both = np.empty(len(row))
    for i in range(len(row)):
        both[i] = 1.0 / total(row, 1.0)
    return both

@shared
def same(row):
    return row

@allocating
def copied(row):
    return same(row).copy()
"""
USING = "import numpy as np; from toy.kernel import mean, normed, total; row = np.zeros(4); "
SHARED = USING + "print(mean(row), *normed(row), total(row, 2.0), *[len(f.stats.cache_misses) for f in (total, mean)])"


def test_a_shared_kernel_is_compiled_once_and_called_by_the_others(toy: Path):
    (toy / "kernel.py").write_text(SHARING)
    code = f"{SHARED}; print(*[b'exp' in f.overloads[f.signatures[0]].library._get_compiled_object() for f in (total, mean)])"  # noqa: E501
    ran = done(toy, code).stdout.splitlines()
    assert ran == ["3.0 0.25 0.25 0.25 0.25 8.0 1 1", "True False"]
    assert len(list(toy.rglob("kernel.total-*.nbc"))) == 1
    assert done(toy, SHARED).stdout == "3.0 0.25 0.25 0.25 0.25 8.0 0 0\n", "from the cache"
    plain = USING + "print(mean(row), *normed(row), total(row, 2.0))"
    assert done(toy, plain, NUMBA_DISABLE_JIT="1").stdout == "3.0 0.25 0.25 0.25 0.25 8.0\n"


def test_a_kernel_from_the_cache_finds_the_shared_one_whatever_became_of_its_file(toy: Path):
    (toy / "kernel.py").write_text(SHARING)
    code = USING + "print(mean(row), *[sum(f.stats.cache_misses.values()) for f in (total, mean)])"
    assert done(toy, code).stdout == "3.0 1 1\n"
    (kept,) = toy.rglob("kernel.total-*.nbc")
    kept.unlink()
    assert done(toy, code).stdout == "3.0 1 0\n"
    kept.write_bytes(b"damaged")
    assert done(toy, code).stdout == "3.0 1 0\n"
    assert done(toy, code).stdout == "3.0 0 0\n"


ALIKE = """
from typing import NamedTuple
from beltarm_env.jit import compiled, shared

def pairs(*names):
    return NamedTuple("Pair", [(name, float) for name in names])

One, Other = pairs("x", "y"), pairs("y", "x")

@shared
def digits(pair):
    return 10.0 * pair.x + pair.y

@compiled
def both(one, other):
    return digits(one), digits(other)

@compiled
def last(other):
    return digits(other)
"""


def test_types_of_the_same_name_have_their_own_machine_code(toy: Path):
    (toy / "kernel.py").write_text(ALIKE)
    code = "from toy.kernel import *; print(*both(One(1.0, 2.0), Other(2.0, 1.0)), last(Other(4.0, 3.0)))"
    assert [done(toy, code).stdout for _ in range(2)] == ["12.0 12.0 34.0\n"] * 2


SCRIPT = """
import multiprocessing
from beltarm_env.jit import compiled, shared

@shared
def größe(x):
    return 3.0 * x

@compiled
def twice(x):
    return größe(x) + größe(x)

if __name__ == "__main__":
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        print(twice(1.0), pool.apply(twice, (1.0,)))
"""
IMPORTING = """
from beltarm_env.jit import shared
from script import twice

@shared
def größe(x):
    return -x

print(twice(1.0), größe(1.0))
"""


def test_a_script_has_the_shared_kernels_that_it_has_as_a_module(toy: Path):
    (toy / "script.py").write_text(SCRIPT)
    (toy / "other.py").write_text(IMPORTING)
    for name, printed in (("script", "6.0 6.0\n"), ("other", "6.0 -1.0\n")):
        ran = subprocess.run([sys.executable, toy / f"{name}.py"], capture_output=True, text=True, timeout=300)
        assert ran.stdout == printed, ran.stderr


REFUSED = """
import numba
import numpy as np
from beltarm_env.jit import compiled, shared

@shared
def factorial(n):
    return 1 if n < 2 else n * factorial(n - 1)

def scaling(factor):
    @shared
    def scaled(x):
        return factor * x
    return scaled

double = scaling(2.0)

@compiled
def doubled(x):
    return double(x)

@shared
def total(row):
    result = 0.0
    for value in row:
        result += value
    return result

@numba.njit
def foreign(row):
    return total(row)
"""


@pytest.mark.parametrize(
    ("call", "message"),
    [
        ("factorial(3)", "factorial calls itself, and so cannot be `shared`"),
        ("doubled(1.0)", "scaling.<locals>.scaled is not what its module has by that name: mark it `compiled`"),
        (
            "foreign(np.ones(3))",
            "a kernel that is `shared` is called by those of beltarm_env.jit, not by others of numba's",
        ),
    ],
)
def test_calls_of_shared_kernels_that_cannot_be_are_refused(call: str, message: str, toy: Path):
    (toy / "kernel.py").write_text(REFUSED)
    for _ in range(2):
        with pytest.raises(subprocess.CalledProcessError) as raised:
            done(toy, f"from toy.kernel import *; {call}")
        assert message in raised.value.stderr
    assert not list(toy.rglob("*.lock"))


def test_a_shared_kernel_is_strict_whoever_calls_it_first(toy: Path):
    """A caller that lets sums be reordered must not leave such a kernel in the cache."""
    (toy / "kernel.py").write_text(REFUSED.replace("@numba.njit", "@numba.njit(fastmath=True)"))
    code = "from contextlib import suppress\nfrom toy.kernel import *\nwith suppress(TypeError): foreign(np.ones(3))\n"
    code += "print(any('fast' in text for text in total.inspect_llvm().values()), total.signatures != [])"
    assert done(toy, code).stdout == "False True\n"


def test_a_shared_kernel_that_returns_an_array_is_refused(toy: Path):
    (toy / "kernel.py").write_text(SHARING)
    with pytest.raises(subprocess.CalledProcessError) as raised:
        done(toy, "import numpy as np; from toy.kernel import copied; copied(np.ones(3))")
    assert "same returns an array: mark it `allocating`, not `shared`" in raised.value.stderr
