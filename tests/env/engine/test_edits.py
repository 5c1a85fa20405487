"""No kernel is run in an old form, whatever is edited, and what is not edited is not compiled again."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from beltarm_env.engine import PLAIN, building

pytestmark = pytest.mark.skipif(PLAIN or building.compiler() is None, reason="kernels run in plain Python")
HEAD = "from beltarm_env.engine import compiled, inlined\nfrom typing import NamedTuple\nimport numpy as np\n"
LAW = HEAD + "{1}\n\n@compiled\ndef law(x):\n    return {2}\n"
HELPER = HEAD + "{1}\ndef double(x):\n    return {0} * x\n"
CALLING = LAW.replace("{1}", "from . import other").replace("{2}", "other.double(x)")
ORDERED = (
    HEAD + "class Gains(NamedTuple):\n    {fields}\n\n@compiled\ndef of(gains, x):\n    return gains.a * x\n\n"
    "def law(x):\n    return of(Gains(2.0, 9.0), x)\n"
)
CLOSURE = "def made(k):\n    @compiled\n    def law(x):\n        return k * x\n    return law\n\nlaw = made({0})\n"
GIVEN = "@compiled\ndef double(x):\n    return {0} * x\n\n@compiled\ndef of(rule, x):\n    return rule(x)\n\n"
GIVEN += "def law(x):\n    return of(double, x)\n"
FIELDS = {"2.0": "a: float\n    b: float", "9.0": "b: float\n    a: float"}
MADE_OF: dict[str, dict[str, str]] = {
    "an equation": {"mine": LAW.replace("{1}", "").replace("{2}", "{0} * x")},
    "a constant": {"mine": LAW.replace("{1}", "K = {0}").replace("{2}", "K * x")},
    "an equation of another file": {"mine": CALLING, "other": HELPER.replace("{1}", "@inlined")},
    "a helper without a mark": {"mine": CALLING, "other": HELPER.replace("{1}", "")},
    "a helper of a helper": {
        "mine": CALLING.replace("other", "middle"),
        "middle": CALLING.replace("law", "double"),
        "other": HELPER.replace("{1}", "@compiled"),
    },
    "a constant of a module": {"mine": CALLING.replace("other.double(x)", "other.K * x"), "other": "K = {0}"},
    "a table": {"mine": LAW.replace("{1}", "T = np.array([1.0, {0}])").replace("{2}", "T[1] * x")},
    "a tuple": {"mine": LAW.replace("{1}", "T = (1.0, ({0}, 2))").replace("{2}", "T[1][0] * x")},
    "a closure": {"mine": HEAD + CLOSURE},
    "a kernel that is an argument": {"mine": HEAD + GIVEN},
    "a default": {"mine": HEAD + "@compiled\ndef law(x, gain={0}):\n    return gain * x\n"},
    "fields in their order": {"mine": ORDERED},
    "nothing that is edited": {"mine": LAW.replace("{1}", "K = 1.5").replace("{2}", "K * x")},
}
OWN = ("a constant", "an equation of another file", "nothing that is edited")
"""What kernels of a user's package are made of, too."""
PLACES = {"beltarm_env": MADE_OF, "users": OWN}
RUN = """
import importlib, sys
from beltarm_env.engine import building, library
done = {"translated": [], "compiled": []}
def noting(module, name, word, told):
    really = getattr(module, name)
    def call(*given):
        done[word].append(told(*given))
        return really(*given)
    setattr(module, name, call)
noting(library, "entry_of", "translated", lambda function, *_: function.__module__)
noting(building, "_compile", "compiled", lambda *given: given[3].name)
print(*[importlib.import_module(name).law(1.0) for name in sys.argv[1:]])
print(*done["translated"])
print(*done["compiled"])
"""


def write(folder: Path, gain: str) -> list[str]:
    """Write the modules of all cases; return the names of those that have the laws."""
    names = []
    for package, cases in PLACES.items():
        for k, case in enumerate(cases):
            place = folder / package / f"case_{k}"
            place.mkdir(parents=True, exist_ok=True)
            for name, text in MADE_OF[case].items():
                path = place / f"{name}.py"
                path.write_text(text.replace("{0}", gain).replace("{fields}", FIELDS[gain]))
                os.utime(path, (1e9, 1e9))  # as a checkout of another commit may leave it
            names.append(f"{package}.case_{k}.mine")
    return names


def test_no_kernel_is_run_in_an_old_form_whatever_it_is_made_of(tmp_path: Path):
    """The first processes run at the same time, with an empty cache."""
    usual, sources = building.cache_folder(), Path(building.__file__).parents[1]
    building.level()  # builds what all share
    moving = shutil.ignore_patterns("*.json", "*.pyc", "*.lock", "build-*", "zig")  # others write these
    shutil.copytree(sources, tmp_path / "beltarm_env", ignore=moving)
    own = {"PYTHONPATH": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1", "ZIG_GLOBAL_CACHE_DIR": f"{usual}/zig"}
    environment = {**os.environ, **own, "BELTARM_CACHE_DIR": str(tmp_path / "cache")}
    said, names = list[list[list[str]]](), list[str]()
    for gain, count in (("2.0", 2), ("9.0", 1), ("9.0", 1)):
        names = write(tmp_path, gain)
        command = [sys.executable, "-c", RUN, *names]
        start = {"cwd": tmp_path, "env": environment, "stdout": subprocess.PIPE, "text": True}
        running = [subprocess.Popen(command, **start) for _ in range(count)]
        said += [[line.split() for line in process.communicate(timeout=120)[0].splitlines()] for process in running]
    cases = [*MADE_OF, *OWN]
    for gain, (values, *_) in zip(("2.0", "2.0", "9.0", "9.0"), said, strict=True):
        assert values == ["1.5" if case == "nothing that is edited" else gain for case in cases]
    (_, first, compiled), (_, second, together) = said[:2]
    assert {*first, *second} == {*names}, "a process may read notes of the other one"
    assert len(compiled + together) == len(cases), "one compiles, the other waits"
    same = {f"{package}.case_{[*of].index('nothing that is edited')}.mine" for package, of in PLACES.items()}
    _, translated, compiled = said[2]
    assert {*translated} == {*names} - same
    assert len(compiled) == len([case for case in cases if case not in ("nothing that is edited", "a default")])
    _, translated, compiled = said[3]
    assert (translated, compiled) == ([f"beltarm_env.case_{[*MADE_OF].index('a closure')}.mine"], [])
