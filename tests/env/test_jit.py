"""Kernels: compiled once, kept for their contents, never run in an old form, and refused where they cannot be."""

import importlib
import os
import pkgutil
import re
import resource
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from toys import done, package

import agents
import baselines
import beltarm_env
from beltarm_env.jit import ANNOUNCEMENT, PLAIN
from beltarm_env.jit.cache import SignatureFiles
from beltarm_env.jit.fingerprint import fingerprint
from beltarm_env.sources import sources_digest

MARKS = "from beltarm_env.jit import compiled, inlined, shared\n"
LAW = MARKS + "K = {0}\n\n@compiled\ndef law(x):\n    return K * x\n"
HELPER = MARKS + "@{1}\ndef double(x):\n    return {0} * x\n"
CALLING = MARKS + "{1}\n\n@compiled\ndef law(x):\n    return {2}\n"
USING = CALLING.format("", "from other import double", "double(x)")
MADE_OF: dict[str, dict[str, str]] = {
    "a constant": {"mine.py": LAW},
    "a constant of a file": {
        "mine.py": LAW.replace("{0}", "float(open(__file__ + '.txt').read())"),
        "mine.py.txt": "{0}",
    },
    "a helper in the file": {
        "mine.py": HELPER.format("{0}", "inlined") + "@compiled\ndef law(x):\n    return double(x)\n"
    },
    "a helper of another file": {"mine.py": USING, "other.py": HELPER.replace("{1}", "inlined")},
    "a shared helper of another file": {"mine.py": USING, "other.py": HELPER.replace("{1}", "shared")},
    "a helper of a helper": {
        "mine.py": CALLING.format("", "from middle import twice", "twice(x)"),
        "middle.py": MARKS + "from other import double\n\n@compiled\ndef twice(x):\n    return double(x)\n",
        "other.py": HELPER.replace("{1}", "compiled"),
    },
    "a helper of numba's": {"mine.py": USING, "other.py": "import numba\n" + HELPER.replace("{1}", "numba.njit")},
    "a constant of a module": {"mine.py": CALLING.format("", "import other", "other.K * x"), "other.py": "K = {0}"},
    "a helper of a module": {
        "mine.py": CALLING.format("", "import other", "other.double(x)"),
        "other.py": HELPER.replace("{1}", "inlined"),
    },
    "a table": {"mine.py": CALLING.format("", "import numpy as np\nT = np.array([1.0, {0}])", "T[1] * x")},
    "a tuple": {"mine.py": CALLING.format("", "T = (1.0, ({0}, 2))", "T[1][0] * x")},
    "a closure": {
        "mine.py": MARKS
        + "def made(gain):\n    @compiled\n    def law(x):\n        return gain * x\n    return law\nlaw = made({0})\n"
    },
    "a default": {"mine.py": MARKS + "@compiled\ndef law(x, gain={0}):\n    return gain * x\n"},
    "fields in their order": {
        "mine.py": MARKS + "from typing import NamedTuple\n\nclass Gains(NamedTuple):\n    {fields}\n\n"
        "@compiled\ndef of(gains, x):\n    return gains.a * x\n\ndef law(x):\n    return of(Gains(2.0, 9.0), x)\n"
    },
    "an equation in a sub-folder of a package": {
        "mine.py": "from mine_toy.kernel import law\n",
        "mine_toy/__init__.py": "",
        "mine_toy/laws/__init__.py": "",
        "mine_toy/laws/law.py": HELPER.replace("{1}", "inlined"),
        "mine_toy/kernel.py": CALLING.format("", "from mine_toy.laws.law import double", "double(x)"),
    },
}
FIELDS = {"2.0": "a: float\n    b: float", "9.0": "b: float\n    a: float"}
CACHES = {
    "pycache": {},
    "folder of generic code": {"NUMBA_CACHE_DIR": "cache", "NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""},
}
RUN_ALL = """
import importlib, sys
for k in range({count}):
    sys.path.insert(0, f"case_{{k}}")
    law = importlib.import_module(f"mine_{{k}}").law
    print(law(1.0), len(law.stats.cache_hits) if hasattr(law, "stats") else "-")
"""


@pytest.mark.parametrize("setting", CACHES)
def test_no_kernel_is_run_in_an_old_form_whatever_it_is_made_of(
    setting: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    printed, kept = [], []
    for gain in ("2.0", "9.0", "9.0"):
        for k, files in enumerate(MADE_OF.values()):
            for name, text in files.items():
                name, text = (re.sub(r"\b(mine|other|middle)(?=\b|_)", rf"\1_{k}", each) for each in (name, text))
                path = tmp_path / f"case_{k}" / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(text.replace("{0}", gain).replace("{fields}", FIELDS[gain]))
                os.utime(path, (1e9, 1e9))  # as a checkout of another commit may leave it
        printed.append(done(tmp_path / "none", RUN_ALL.format(count=len(MADE_OF)), **CACHES[setting]).stdout)
        kept.append(sorted(path.name for path in tmp_path.rglob("*.nbc")))
    hits = [line.split()[1] for line in printed[0].splitlines()]
    lines = [[f"{gain} {'-' if hit == '-' else number}" for hit in hits] for gain, number in (("2.0", 0), ("9.0", 0))]
    assert [text.splitlines() for text in printed[:2]] == lines
    assert printed[2] == printed[1].replace(" 0\n", " 1\n"), "from the cache"
    assert kept[1] == kept[2]
    assert all(sum(name.startswith("mine_0.law-") for name in names) == 1 for names in kept), "the old kernel is gone"


UNKNOWN = """
import numba.extending
from beltarm_env.jit import compiled

def double(x):
    return x

@numba.extending.overload(double)
def _double(x):
    return lambda x: {gain} * x

@compiled
def law(x):
    return double(x)
"""


def test_a_kernel_of_unknown_parts_is_not_kept_and_says_so(tmp_path: Path):
    for gain in (2.0, 9.0):
        (tmp_path / "mine.py").write_text(UNKNOWN.format(gain=gain))
        ran = done(tmp_path / "mine.py", "from mine import law; print(law(1.0))")
        assert ran.stdout == f"{gain}\n"
        assert sum("law uses double" in line for line in ran.stderr.splitlines()) == 1
    assert not list(tmp_path.rglob("*.nbc"))


@pytest.mark.skipif(PLAIN, reason="kernels that are not compiled are not kept")
def test_all_kernels_of_the_project_can_be_kept():
    """A kernel that would be compiled in each process is noticed here, and not by its user's patience."""
    kernels = 0
    for folder in (beltarm_env, baselines, agents):
        for module in pkgutil.walk_packages(folder.__path__, f"{folder.__name__}."):
            if "mujoco" not in module.name:
                for value in vars(importlib.import_module(module.name)).values():
                    if hasattr(value, "py_func"):
                        fingerprint(value.py_func, ())
                        kernels += 1
    assert kernels > 300


@pytest.mark.parametrize("obstacle", ["no folder", "no room"])
def test_where_no_kernel_can_be_written_it_is_compiled_and_a_line_says_so(obstacle: str, tmp_path: Path):
    (tmp_path / "mine.py").write_text(LAW.format(2.0))
    environment = {"PYTHONPATH": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"}
    if obstacle == "no folder":  # a file is there, which stops an administrator, too
        (tmp_path / "__pycache__").write_text("")
        environment |= {"HOME": "/dev/null", "XDG_CACHE_HOME": "/dev/null/none"}
    ran = subprocess.run(
        [sys.executable, "-c", "from mine import law; print(law(1.0), law(2))"],
        env={**os.environ, **environment},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0)) if obstacle == "no room" else None,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert ran.stdout == "2.0 4.0\n", ran.stderr
    assert sum("NUMBA_CACHE_DIR" in line for line in ran.stderr.splitlines()) == 1
    assert {path.name for path in tmp_path.rglob("*") if path.is_file()} <= {"mine.py", "__pycache__"}


class Twin(str):
    """A signature of the same text as another."""

    def __eq__(self, other: object) -> bool:
        return self is other

    __hash__ = str.__hash__


def test_files_of_signatures(tmp_path: Path):
    """Processes that compile at a time do not overwrite their kernels; a damaged one is not run."""
    first, second = (SignatureFiles(tmp_path, "law") for _ in range(2))
    first.save(("float64", "0"), "code for float64")
    second.save(("int64", "0"), "code for int64")
    assert first.load(("int64", "0")) == "code for int64" and second.load(("float64", "0")) == "code for float64"
    assert first.load(("float32", "0")) is None and first.load((Twin("float64"), "0")) is None
    damaged = SignatureFiles(tmp_path, "other")
    before = {*tmp_path.iterdir()}
    damaged.save(("float64", "0"), np.arange(100.0))
    (kept,) = {*tmp_path.iterdir()} - before
    content = bytearray(kept.read_bytes())
    content[-20] ^= 1  # within the numbers
    kept.write_bytes(content)
    assert damaged.load(("float64", "0")) is None


def test_the_digest_sees_contents_names_and_sub_folders(tmp_path: Path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "a.py").write_text("1")
    first = sources_digest(tmp_path)
    (tmp_path / "sub" / "a.py").write_text("2")
    second = sources_digest(tmp_path)
    (tmp_path / "sub" / "a.py").rename(tmp_path / "a.py")
    assert len({first, second, sources_digest(tmp_path)}) == 3
    assert sources_digest(tmp_path) == sources_digest(tmp_path)


TOY = """
from typing import NamedTuple
import numpy as np
from beltarm_env.jit import allocating, compiled, inlined, shared

@shared
def total(row, factor):
    result = 0.0
    for value in row:
        result += factor * np.exp(value)
    return result

@inlined
def halves(row):
    middle = len(row) // 2
    return row[:middle], row[middle:]

@compiled
def mean(row):
    return total(row, 1.0) / len(row) + total(halves(row)[0], 0.5)

@allocating
def normed(row):
    both = np.empty(len(row))
    for i in range(len(row)):
        both[i] = row[i] / total(row, 1.0)
    return halves(both)[0]

@allocating
def refusing(x):
    if x < 0.0:
        raise ValueError("backwards", x)
    return x

@allocating
def calling(x):
    return refusing(x)

def pairs(*names):
    return NamedTuple("Pair", [(name, float) for name in names])

One, Other = pairs("x", "y"), pairs("y", "x")  # types of the same name

@shared
def digits(pair):
    return 10.0 * pair.x + pair.y

@compiled
def both(one, other):
    return digits(one), digits(other)
"""
USE = """
import gc, pickle, sys
gc.set_threshold(321, 5, 6)
import numpy as np
from toy.kernel import calling, mean, normed, total
row = np.zeros(4)
print(mean(row), pickle.loads(pickle.dumps(mean))(row), total(row, 2.0), total(row, 2), *normed(row))
arrays = [normed(np.full(100, float(k))) for k in range(50)]
gc.collect()
print(all(np.allclose(array, k / (100 * np.exp(k))) for k, array in enumerate(arrays)))
try:
    calling(-2.0)
except ValueError as error:
    print(*error.args)
print(*gc.get_threshold())
"""
MISSES = "\nprint(*[sum(f.stats.cache_misses.values()) for f in (total, mean)], 'numba.np.arraymath' in sys.modules)"
WORKER = """
import multiprocessing, sys
from toy.kernel import refusing
if __name__ == "__main__":
    worker = multiprocessing.get_context("fork").Process(target=refusing, args=(2.0,))
    worker.start()
    worker.join()
    sys.exit(worker.exitcode)
"""


@pytest.fixture
def toy(tmp_path: Path) -> Path:
    """A package of a user."""
    folder = package(tmp_path / "toy")
    (folder / "kernel.py").write_text(TOY)
    return folder


def test_kernels_are_compiled_once_kept_and_as_plain_python(toy: Path):
    plain = done(toy, USE, NUMBA_DISABLE_JIT="1")
    assert plain.stderr == "" and done(toy, WORKER, NUMBA_CACHE_DIR=str(toy / "other")).stderr == ""
    assert plain.stdout.splitlines()[1:] == ["True", "backwards -2.0", "321 5 6"]
    compiling = done(toy, USE + MISSES)
    assert compiling.stderr == f"{ANNOUNCEMENT}\n", "once, and by no worker"
    assert compiling.stdout == plain.stdout + "2 1 True\n"
    loading = done(toy, USE + MISSES)
    assert (loading.stdout, loading.stderr) == (plain.stdout + "0 0 False\n", ""), "without the compiler"
    kept = next(toy.rglob("kernel.total-*.nbc"))
    for spoil in (lambda: kept.write_bytes(b"damaged"), kept.unlink):
        spoil()
        assert done(toy, USE + MISSES).stdout == plain.stdout + "1 0 True\n", "whatever became of the shared kernel"


def test_types_of_the_same_name_have_their_own_machine_code(toy: Path):
    code = "from toy.kernel import One, Other, both; print(*both(One(1.0, 2.0), Other(2.0, 1.0)))"
    assert [done(toy, code).stdout for _ in range(2)] == ["12.0 12.0\n"] * 2


def test_kernels_can_be_typed_in(toy: Path):
    assert done(toy, f"exec({LAW.format(3.0)!r}); print(law(1.0))").stdout == "3.0\n"


WANTING = """
import os, time
from pathlib import Path
from toy.kernel import refusing
try:
    refusing("not a number")
except Exception:
    pass
Path(f"ready{os.getpid()}").touch()
while len(list(Path().glob("ready*"))) < 3:
    time.sleep(0.01)
print(refusing(2.0), sum(refusing.stats.cache_misses.values()))
"""


@pytest.mark.slow
def test_of_processes_that_want_a_kernel_one_compiles_it(toy: Path, monkeypatch: pytest.MonkeyPatch):
    """The others wait and load it, whatever any of them failed to compile before."""
    monkeypatch.chdir(toy.parent)
    with ThreadPoolExecutor() as threads:
        said = [process.stdout.split() for process in threads.map(partial(done, toy), [WANTING] * 3)]
    assert [value for value, _ in said] == ["2.0"] * 3
    assert sum(int(misses) for _, misses in said) == 3 + 1, "each its own failure, and one of them the kernel"
    assert not list(toy.rglob("*.lock"))


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
from beltarm_env.jit import allocating, compiled, shared

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

@numba.njit(fastmath=True)
def foreign(row):
    return total(row)

@shared
def same(row):
    return row

@allocating
def copied(row):
    return same(row).copy()

@compiled
def forgetful(row):
    return total(np.empty(row.shape))
"""
CALLS = """
import traceback
import numpy as np
from toy.kernel import copied, doubled, factorial, foreign, forgetful, total
row = np.ones(3)
for call, argument in ((factorial, 3), (doubled, 1.0), (foreign, row), (copied, row), (forgetful, row)):
    try:
        call(argument)
    except Exception as error:
        print(*" ".join(traceback.format_exception_only(error)).split())
print(any("fast" in text for text in total.inspect_llvm().values()), total.signatures != [])
"""


def test_kernels_that_cannot_be_are_refused(toy: Path):
    (toy / "kernel.py").write_text(REFUSED)
    for _ in range(2):
        *refusals, strict = done(toy, CALLS).stdout.splitlines()
        words = [("factorial", "calls itself"), ("scaled", "`compiled`"), ("`shared`", "numba's")]
        words += [("same", "`allocating`"), ("makes arrays", "`allocating`")]
        for refusal, expected in zip(refusals, words, strict=True):
            assert all(word in refusal for word in expected), refusal
        assert strict == "False True", "a caller that lets sums be reordered leaves no such kernel in the cache"
    assert not list(toy.rglob("*.lock"))
