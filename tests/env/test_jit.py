"""Kernels: compiled once, kept, and never run in an old form, whatever is edited, damaged or cannot be written."""

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

import pytest

import agents
import baselines
import beltarm_env
from beltarm_env.jit import ANNOUNCEMENT, PLAIN
from beltarm_env.jit.fingerprint import fingerprint
from beltarm_env.sources import sources_digest


def done(folder: Path, *words: str, room: bool = True, **options: str) -> subprocess.CompletedProcess[str]:
    """A process of Python in a folder, whose modules it can import; `options` are added to its environment."""
    known = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA")}
    own = {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}  # *.pyc have a time too
    return subprocess.run(
        [sys.executable, *words],
        cwd=folder,
        env={**known, **own, **options},
        preexec_fn=None if room else lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0)),
        capture_output=True,
        text=True,
        check=True,
        timeout=300,
    )


MARKS = "from beltarm_env.jit import compiled, inlined, shared\nfrom typing import NamedTuple\nimport numpy as np\n"
LAW = MARKS + "K = {0}\n\n@compiled\ndef law(x):\n    return K * x\n"
HELPER = MARKS + "@{1}\ndef double(x):\n    return {0} * x\n"
CALLING = MARKS + "{1}\n\n@compiled\ndef law(x):\n    return {2}\n"
USING = CALLING.format("", "from other import double", "double(x)")
ORDERED = (
    MARKS + "class Gains(NamedTuple):\n    {fields}\n\n@compiled\ndef of(gains, x):\n    return gains.a * x\n\n"
    "def law(x):\n    return of(Gains(2.0, 9.0), x)\n"
)
MADE_OF: dict[str, dict[str, str]] = {
    "a constant": {"mine.py": LAW},
    "a helper of another file": {"mine.py": USING, "other.py": HELPER.replace("{1}", "inlined")},
    "a shared helper": {"mine.py": USING, "other.py": HELPER.replace("{1}", "shared")},
    "a helper of a helper": {
        "mine.py": CALLING.format("", "from middle import twice", "twice(x)"),
        "middle.py": MARKS + "from other import double\n\n@compiled\ndef twice(x):\n    return double(x)\n",
        "other.py": HELPER.replace("{1}", "compiled"),
    },
    "a helper of numba's": {"mine.py": USING, "other.py": "import numba\n" + HELPER.replace("{1}", "numba.njit")},
    "a constant of a module": {"mine.py": CALLING.format("", "import other", "other.K * x"), "other.py": "K = {0}"},
    "a table": {"mine.py": CALLING.format("", "T = np.array([1.0, {0}])", "T[1] * x")},
    "a tuple": {"mine.py": CALLING.format("", "T = (1.0, ({0}, 2))", "T[1][0] * x")},
    "a closure": {
        "mine.py": MARKS + "def made(gain):\n    @compiled\n    def law(x):\n        return gain * x\n    return law\n"
        "law = made({0})\n"
    },
    "a default": {"mine.py": MARKS + "@compiled\ndef law(x, gain={0}):\n    return gain * x\n"},
    "fields in their order": {"mine.py": ORDERED},
}
FIELDS = {"2.0": "a: float\n    b: float", "9.0": "b: float\n    a: float"}
RUN_ALL = """
import importlib, sys
for k in range({count}):
    sys.path.insert(0, f"case_{{k}}")
    law = importlib.import_module(f"mine_{{k}}").law
    print(law(1.0), len(law.stats.cache_hits) if hasattr(law, "stats") else "-")
"""


def test_no_kernel_is_run_in_an_old_form_whatever_it_is_made_of(tmp_path: Path):
    printed, kept = [], []
    for gain in ("2.0", "9.0", "9.0"):
        for k, files in enumerate(MADE_OF.values()):
            for name, text in files.items():
                name, text = (re.sub(r"\b(mine|other|middle)\b", rf"\1_{k}", each) for each in (name, text))
                path = tmp_path / f"case_{k}" / name
                path.parent.mkdir(exist_ok=True)
                path.write_text(text.replace("{0}", gain).replace("{fields}", FIELDS[gain]))
                os.utime(path, (1e9, 1e9))  # as a checkout of another commit may leave it
        printed.append(done(tmp_path, "-c", RUN_ALL.format(count=len(MADE_OF))).stdout)
        kept.append(sorted(path.name for path in tmp_path.rglob("*.nbc")))
    hits = [line.split()[1] for line in printed[0].splitlines()]
    lines = [[f"{gain} {'-' if hit == '-' else 0}" for hit in hits] for gain in ("2.0", "9.0")]
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
    return lambda x: {0} * x

@compiled
def law(x):
    return double(x)
"""


@pytest.mark.parametrize("obstacle", ["no folder", "no room", "unknown parts"])
def test_a_kernel_that_cannot_be_kept_is_compiled_and_a_line_says_so(obstacle: str, tmp_path: Path):
    environment = {}
    if obstacle == "no folder":  # a file is there, which stops an administrator, too
        (tmp_path / "__pycache__").touch()
        environment = {"HOME": "/dev/null", "XDG_CACHE_HOME": "/dev/null/none"}
    for gain in ("2.0", "9.0") if obstacle == "unknown parts" else ("2.0",):
        (tmp_path / "mine.py").write_text((UNKNOWN if obstacle == "unknown parts" else LAW).replace("{0}", gain))
        code = "from mine import law; print(law(1.0), law(2))"
        ran = done(tmp_path, "-c", code, room=obstacle != "no room", **environment)
        assert ran.stdout == f"{gain} {2 * float(gain)}\n"
        words = "law uses double" if obstacle == "unknown parts" else "NUMBA_CACHE_DIR"
        assert sum(words in line for line in ran.stderr.splitlines()) == 1
    assert not list(tmp_path.rglob("*.nbc*"))


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


def test_the_digest_sees_contents_names_and_sub_folders(tmp_path: Path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "a.py").write_text("1")
    first = sources_digest(tmp_path)
    (tmp_path / "sub" / "a.py").write_text("2")
    second = sources_digest(tmp_path)
    (tmp_path / "sub" / "a.py").rename(tmp_path / "a.py")
    assert len({first, second, sources_digest(tmp_path)}) == 3


TOY = """
import numpy as np
from beltarm_env.jit import allocating, compiled, shared

@shared
def total(row, factor):
    result = 0.0
    for value in row:
        result += factor * np.exp(value)
    return result

@compiled
def mean(row):
    return total(row, 1.0) / len(row) + total(row[:2], 0.5)

@allocating
def normed(row):
    if row[0] < 0.0:
        raise ValueError("backwards", row[0])
    return np.array([value / total(row, 1.0) for value in row])[:2]
"""
USE = """
import pickle, sys
import numpy as np
from toy import mean, normed, total
row = np.zeros(4)
print(mean(row), pickle.loads(pickle.dumps(mean))(row), total(row, 2.0), total(row, 2), *normed(row))
arrays = [normed(np.full(100, float(k))) for k in range(50)]
print(all(np.allclose(array, k / (100 * np.exp(k))) for k, array in enumerate(arrays)))
try:
    normed(row - 2.0)
except ValueError as error:
    print(*error.args)
"""
MISSES = "\nprint(*[sum(f.stats.cache_misses.values()) for f in (total, mean)], 'numba.np.arraymath' in sys.modules)"


@pytest.fixture
def toy(tmp_path: Path) -> Path:
    """Folder with a module of a user."""
    (tmp_path / "toy.py").write_text(TOY)
    return tmp_path


def test_kernels_are_compiled_once_kept_and_as_plain_python(toy: Path):
    plain = done(toy, "-c", USE, NUMBA_DISABLE_JIT="1")
    assert plain.stderr == "" and plain.stdout.splitlines()[1:] == ["True", "backwards -2.0"]
    compiling, loading = (done(toy, "-c", USE + MISSES) for _ in range(2))
    assert (compiling.stdout, compiling.stderr) == (plain.stdout + "2 1 True\n", f"{ANNOUNCEMENT}\n")
    assert (loading.stdout, loading.stderr) == (plain.stdout + "0 0 False\n", ""), "without the compiler"
    kept = sorted(toy.rglob("toy.*.nbc"))
    for path in kept:
        content = bytearray(path.read_bytes())
        content[-20] ^= 1
        path.write_bytes(content)
    assert done(toy, "-c", USE + MISSES).stdout == compiling.stdout, "a damaged kernel is none"
    for path in toy.rglob("toy.total-*.nbc"):
        path.unlink()
    assert done(toy, "-c", USE + MISSES).stdout == plain.stdout + "2 0 True\n", "others are without what they call"


WANTING = """
import os, time
from pathlib import Path
import numpy as np
from toy import normed
try:
    normed("not an array")
except Exception:
    pass
Path(f"ready{os.getpid()}").touch()
while len(list(Path().glob("ready*"))) < 3:
    time.sleep(0.01)
print(*normed(np.ones(2)), sum(normed.stats.cache_misses.values()))
"""


@pytest.mark.slow
def test_of_processes_that_want_a_kernel_one_compiles_it(toy: Path):
    """The others wait and load it, whatever any of them failed to compile before."""
    with ThreadPoolExecutor() as threads:
        said = [process.stdout.split() for process in threads.map(partial(done, toy, "-c"), [WANTING] * 3)]
    assert len({(first, second) for first, second, _ in said}) == 1
    assert sum(int(misses) for *_, misses in said) == 3 + 1, "each its own failure, and one of them the kernel"
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
    exec(TYPED_IN)
    print(law(1.0))
"""


def test_kernels_of_a_script_and_of_a_prompt(tmp_path: Path):
    (tmp_path / "script.py").write_text(SCRIPT.replace("TYPED_IN", repr(LAW.format(3.0))))
    assert done(tmp_path, "script.py").stdout == "6.0 6.0\n3.0\n"
