"""What kernels are kept for, and what becomes of a run where none can be kept."""

import os
import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from toys import done, package

from beltarm_env.jit.cache import SignatureFiles

MARKS = "from beltarm_env.jit import compiled, inlined, shared\n"
LAW = MARKS + "K = {0}\n\n@compiled\ndef law(x):\n    return K * x\n"
HELPER = MARKS + "@{1}\ndef double(x):\n    return {0} * x\n"
CALLING = MARKS + "{1}\n\n@compiled\ndef law(x):\n    return {2}\n"
MADE_OF: dict[str, dict[str, str]] = {
    "a constant": {"mine.py": LAW},
    "a constant of a file": {
        "mine.py": LAW.replace("{0}", "float(open(__file__[:-7] + 'gain.txt').read())"),
        "gain.txt": "{0}",
    },
    "a helper in the file": {
        "mine.py": HELPER.format("{0}", "inlined") + "@compiled\ndef law(x):\n    return double(x)\n"
    },
    "a helper of another file": {
        "mine.py": CALLING.format("", "from other import double", "double(x)"),
        "other.py": HELPER.replace("{1}", "inlined"),
    },
    "a shared helper of another file": {
        "mine.py": CALLING.format("", "from other import double", "double(x)"),
        "other.py": HELPER.replace("{1}", "shared"),
    },
    "a helper of a helper": {
        "mine.py": CALLING.format("", "from middle import twice", "twice(x)"),
        "middle.py": MARKS + "from other import double\n\n@compiled\ndef twice(x):\n    return double(x)\n",
        "other.py": HELPER.replace("{1}", "compiled"),
    },
    "a helper of numba's": {
        "mine.py": CALLING.format("", "from other import double", "double(x)"),
        "other.py": "import numba\n" + HELPER.replace("{1}", "numba.njit"),
    },
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
}
FIELDS = {"2.0": "a: float\n    b: float", "9.0": "b: float\n    a: float"}


@pytest.mark.parametrize("case", MADE_OF)
def test_no_kernel_is_run_in_an_old_form_whatever_it_is_made_of(case: str, tmp_path: Path):
    """One-file modules, which are in no package, and what they take from others."""
    printed = []
    for gain in ("2.0", "9.0", "9.0"):
        for name, text in MADE_OF[case].items():
            (tmp_path / name).write_text(text.replace("{0}", gain).replace("{fields}", FIELDS[gain]))
            os.utime(tmp_path / name, (1e9, 1e9))  # as a checkout of another commit may leave it
        printed.append(done(tmp_path / "mine.py", "from mine import law; print(law(1.0))").stdout)
    assert printed == ["2.0\n", "9.0\n", "9.0\n"]


def test_of_an_edited_kernel_the_newest_form_is_kept_alone(tmp_path: Path):
    for gain in (2.0, 9.0):
        (tmp_path / "mine.py").write_text("\n" * int(gain) + LAW.format(gain))  # lines move, too
        done(tmp_path / "mine.py", "from mine import law; law(1.0)")
    (kept,) = tmp_path.rglob("*.nbc")
    done(tmp_path / "mine.py", "from mine import law; law(1.0); assert len(law.stats.cache_hits) == 1")
    assert list(tmp_path.rglob("*.nbc")) == [kept]


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


def test_all_kernels_of_the_project_can_be_kept():
    """What one of them would need to be compiled in each process is found here, and not by its user's patience."""
    code = """
import importlib, pkgutil
import agents, baselines, beltarm_env
from beltarm_env.jit.fingerprint import fingerprint
kernels = 0
for package in (beltarm_env, baselines, agents):
    for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        if "mujoco" not in module.name:
            for value in vars(importlib.import_module(module.name)).values():
                if hasattr(value, "py_func"):
                    fingerprint(value.py_func, ())
                    kernels += 1
print(kernels)
"""
    assert int(done(Path(__file__).parent, code).stdout) > 300


def unwritable(folder: Path) -> dict[str, str]:
    """Leave no folder for kernels: where one would be made there is a file, which stops an administrator, too."""
    (folder / "__pycache__").write_text("")
    return {"HOME": "/dev/null", "XDG_CACHE_HOME": "/dev/null/none"}


def test_where_no_folder_can_be_written_kernels_are_compiled_and_a_line_says_so(tmp_path: Path):
    folder = package(tmp_path / "toy")
    (folder / "kernel.py").write_text(LAW.format(2.0))
    code = "from toy.kernel import law; print(law(1.0), law(2))"
    for _ in range(2):
        ran = done(folder, code, **unwritable(folder))
        assert ran.stdout == "2.0 4.0\n"
        assert sum("NUMBA_CACHE_DIR" in line for line in ran.stderr.splitlines()) == 1


def test_what_is_typed_in_has_kernels_too(tmp_path: Path):
    code = "exec('''" + LAW.format(2.0) + "'''); print(law(1.0))"
    assert done(tmp_path / "none.py", code).stdout == "2.0\n"


def test_where_there_is_no_room_kernels_are_compiled_and_a_line_says_so(tmp_path: Path):
    (tmp_path / "mine.py").write_text(LAW.format(2.0))
    ran = subprocess.run(
        [sys.executable, "-c", "from mine import law; print(law(1.0), law(2))"],
        env={**os.environ, "PYTHONPATH": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0)),
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert ran.stdout == "2.0 4.0\n", ran.stderr
    assert sum("NUMBA_CACHE_DIR" in line for line in ran.stderr.splitlines()) == 1
    assert not [path for path in tmp_path.rglob("*") if path.is_file() and path.name != "mine.py"]


def test_a_damaged_kernel_is_not_run(tmp_path: Path):
    files = SignatureFiles(tmp_path, "law")
    files.save(("float64", "0"), np.arange(100.0))
    (kept,) = tmp_path.iterdir()
    content = bytearray(kept.read_bytes())
    content[-20] ^= 1  # within the numbers
    kept.write_bytes(content)
    assert files.load(("float64", "0")) is None
