"""Compiled kernels are those of the sources, wherever the cache lies."""

import os
import subprocess
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import pytest
from toys import done, package

from beltarm_env.jit import ANNOUNCEMENT
from beltarm_env.jit.cache import SignatureFiles
from beltarm_env.sources import sources_digest

EQUATION = "from beltarm_env.jit import inlined\n\n@inlined\ndef friction(speed):\n    return {factor} * speed\n"
KERNEL = "from beltarm_env.jit import compiled\nfrom toy.laws.law import friction\n\n@compiled\ndef torque(speed):\n    return friction(speed)\n"  # noqa: E501
RUN = "from toy.kernel import torque; print(torque(2.0), len(torque.stats.cache_hits))"


@pytest.fixture
def toy(tmp_path: Path) -> Path:
    """A package of a user with a kernel that inlines an equation from a sub-folder."""
    folder = package(tmp_path / "toy")
    (package(folder / "laws") / "law.py").write_text(EQUATION.format(factor=1.0))
    (folder / "kernel.py").write_text(KERNEL)
    return folder


def run(toy: Path, **environment: str) -> list[str]:
    """What the kernel returns, and how often its compiled form was found in the cache."""
    return done(toy, RUN, **environment).stdout.split()


CACHES = {
    "pycache": {},
    "cache-dir": {"NUMBA_CACHE_DIR": "cache"},
    "generic": {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""},
}


@pytest.mark.parametrize("setting", CACHES)
def test_an_edited_equation_is_never_run_in_its_old_form(
    setting: str, toy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    environment = CACHES[setting]
    assert run(toy, **environment) == ["2.0", "0"]
    assert run(toy, **environment) == ["2.0", "1"]  # from the cache
    law = toy / "laws" / "law.py"
    before = law.stat()
    law.write_text(EQUATION.format(factor=3.0))
    os.utime(law, ns=(before.st_atime_ns, before.st_mtime_ns))  # as a checkout of another commit may leave it
    assert run(toy, **environment) == ["6.0", "0"]
    assert len(list(tmp_path.rglob("*.nbc"))) == 1, "the kernel of the old sources is gone"


TWICE = "from toy.kernel import torque; torque(2.0); torque(2)"  # two types, two compilations
PLAIN = "from toy.kernel import torque; print(torque(2.0))"
WORKER = """
import multiprocessing, sys
from toy.kernel import torque
if __name__ == "__main__":
    worker = multiprocessing.get_context("fork").Process(target=torque, args=(2.0,))
    worker.start()
    worker.join()
    sys.exit(worker.exitcode)
"""


def test_compilation_is_announced_once_and_by_no_worker(toy: Path):
    assert done(toy, PLAIN, NUMBA_DISABLE_JIT="1").stderr == ""
    assert done(toy, WORKER, NUMBA_CACHE_DIR=str(toy / "other")).stderr == ""
    assert done(toy, TWICE).stderr == f"{ANNOUNCEMENT}\n"
    assert done(toy, TWICE).stderr == ""


def test_the_digest_sees_contents_names_and_sub_folders(tmp_path: Path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "a.py").write_text("1")
    first = sources_digest(tmp_path)
    (tmp_path / "sub" / "a.py").write_text("2")
    second = sources_digest(tmp_path)
    (tmp_path / "sub" / "a.py").rename(tmp_path / "a.py")
    assert len({first, second, sources_digest(tmp_path)}) == 3
    assert sources_digest(tmp_path) == sources_digest(tmp_path)


def test_a_cached_kernel_is_loaded_without_the_compiler(toy: Path):
    code = f"import sys; {PLAIN}; print('numba.np.arraymath' in sys.modules)"
    assert [done(toy, code).stdout.split() for _ in range(2)] == [["2.0", "True"], ["2.0", "False"]]


def test_compiling_leaves_the_collector_of_garbage_as_it_was(toy: Path):
    code = """
import gc; gc.set_threshold(321, 5, 6)
from contextlib import suppress
from numba.core.errors import NumbaError
from toy.kernel import torque
for speed in (2.0, "fast"):
    with suppress(NumbaError):
        torque(speed)
    print(*gc.get_threshold())
"""
    assert done(toy, code).stdout == "321 5 6\n" * 2


REFUSING = "from beltarm_env.jit import allocating\n\n@allocating\ndef friction(speed):\n    if speed < 0.0:\n        raise ValueError('backwards', speed)\n    return speed\n"  # noqa: E501
TRIED = """
from toy.kernel import torque
from toy.laws.law import friction
for called in (torque, friction):
    try:
        called(-2.0)
    except ValueError as error:
        print(*error.args)
"""


def test_what_a_part_raises_arrives_compiled_and_from_the_cache(toy: Path):
    (toy / "laws" / "law.py").write_text(REFUSING)
    (toy / "kernel.py").write_text(KERNEL.replace("compiled", "allocating"))  # an exception with values needs memory
    assert [done(toy, TRIED).stdout for _ in range(2)] == ["backwards -2.0\n" * 2] * 2


def test_processes_that_compile_at_a_time_do_not_overwrite_their_kernels(tmp_path: Path):
    one, other = (SignatureFiles(tmp_path, "law") for _ in range(2))
    one.save(("float64", "0"), "code for float64")
    other.save(("int64", "0"), "code for int64")
    assert one.load(("int64", "0")) == "code for int64" and other.load(("float64", "0")) == "code for float64"
    assert one.load(("float32", "0")) is None


WANTING = """
import os, time
from pathlib import Path
from toy.kernel import torque
try:
    torque("not a number")
except Exception:
    pass
Path(f"ready{os.getpid()}").touch()
while len(list(Path().glob("ready*"))) < 3:
    time.sleep(0.01)
print(torque(2.0), sum(torque.stats.cache_misses.values()))
"""


@pytest.mark.slow
def test_of_processes_that_want_a_kernel_one_compiles_it(toy: Path, monkeypatch: pytest.MonkeyPatch):
    """The others wait and load it, whatever any of them failed to compile before."""
    monkeypatch.chdir(toy.parent)
    with ThreadPoolExecutor() as threads:
        told = [process.stdout.split() for process in threads.map(partial(done, toy), [WANTING] * 3)]
    assert [value for value, _ in told] == ["2.0"] * 3
    assert sum(int(misses) for _, misses in told) == 3 + 1, "each its own failure, and one of them the kernel"
    assert not list(toy.rglob("*.lock"))


def test_a_kernel_of_another_signature_is_not_taken_for_ones_own(tmp_path: Path):
    class Twin(str):
        def __eq__(self, other: object) -> bool:
            return self is other

        __hash__ = str.__hash__

    files = SignatureFiles(tmp_path, "law")
    files.save(("float64", "0"), "code")
    assert files.load((Twin("float64"), "0")) is None


def test_equations_and_kernels_are_sent_to_other_processes(toy: Path):
    code = "import pickle; from toy.kernel import torque, friction; print(*[pickle.loads(pickle.dumps(f))(2.0) for f in (torque, friction)])"  # noqa: E501
    assert done(toy, code).stdout == "2.0 2.0\n"


def test_kernels_ask_for_the_widest_vectors(toy: Path):
    """LLVM would use half of those that some processors have."""
    code = "from toy.kernel import torque; torque(2.0); print(*torque.inspect_llvm().values())"
    llvm = done(toy, code).stdout
    asked = [line for line in llvm.splitlines() if line.startswith("attributes #") and "prefer-vector-width" in line]
    assert asked and all('"prefer-vector-width"="512"' in line for line in asked)


VIEWS = """
import numpy as np
from beltarm_env.jit import allocating, compiled, inlined

@compiled
def total(rows):
    result = 0.0
    for k in range(len(rows)):
        row = rows[k]
        for i in range(len(row)):
            result += row[i]
    return result

@compiled
def mean(rows):
    return total(rows) / len(rows)

@inlined
def halves(rows):
    middle = len(rows) // 2
    return rows[:middle], rows[middle:]

@allocating
def doubled(rows):
    both = np.empty((2 * len(rows), rows.shape[1]))
    for k in range(len(both)):
        for i in range(rows.shape[1]):
            both[k, i] = rows[k % len(rows), i]
    return both, total(both)

@allocating
def copied(rows):
    return halves(doubled(rows)[0])[0]

@compiled
def forgetful(rows):
    return total(np.empty(rows.shape))
"""


def test_kernels_that_make_no_arrays_do_not_count_who_refers_to_one(toy: Path):
    (toy / "kernel.py").write_text(VIEWS)
    code = "import numpy as np; from toy.kernel import mean, doubled; a = np.ones((3, 2)); both, total = doubled(a)"
    code += (
        "; print(mean(a), both.shape, total, *['NRT_' in ''.join(f.inspect_asm().values()) for f in (mean, doubled)])"
    )
    assert done(toy, code).stdout == "2.0 (6, 2) 12.0 False True\n"


def test_parts_that_return_no_array_are_the_same_in_kernels_that_make_arrays(toy: Path):
    (toy / "kernel.py").write_text(VIEWS)
    code = """
import gc
import numpy as np
from toy.kernel import copied, halves, mean, total
found = [copied(np.full((100, 3), float(k))) for k in range(50)]
gc.collect()
print(all((array == k).all() and array.shape == (100, 3) for k, array in enumerate(found)), mean(found[7]))
for part in (total, halves):
    counting, other = (part._parts._part(counts).overloads for counts in (True, False))
    print(counting == other)
"""
    assert done(toy, code).stdout.split() == ["True", "21.0", "True", "False"]


def test_a_kernel_that_makes_arrays_without_saying_so_is_refused(toy: Path):
    (toy / "kernel.py").write_text(VIEWS)
    with pytest.raises(subprocess.CalledProcessError) as raised:
        done(toy, "import numpy as np; from toy.kernel import forgetful; forgetful(np.ones((3, 2)))")
    assert "makes arrays, or raises exceptions with values, is marked `allocating`." in raised.value.stderr
