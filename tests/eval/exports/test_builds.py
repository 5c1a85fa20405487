"""Exported C as others build it: flags, C++, several exports in one program."""

import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
from commands import stopped

from eval import export
from eval.exports.source import FAULTS

RIGHT = ("-std=c99", "-O2", "-ffp-contract=off")
COMPILERS = [name for name in ("gcc", "clang") if shutil.which(name)]
UNSEEN = (
    *("-U__FAST_MATH__", "-U__ASSOCIATIVE_MATH__", "-U__RECIPROCAL_MATH__", "-U__FINITE_MATH_ONLY__"),
    *("-U__NO_SIGNED_ZEROS__", "-U__FLT_EVAL_METHOD__", "-D__FLT_EVAL_METHOD__=0"),
)
"""Flags that make a compiler one without macros for what it does."""
SEEN_ONLY = ("-fsingle-precision-constant", "-mfpmath=both")
"""Flags that only a compiler's macros and types tell of for sure."""
WRONG = [
    *("-ffast-math", "-Ofast", "-funsafe-math-optimizations", "-freciprocal-math", "-ffinite-math-only"),
    *("-fno-signed-zeros", "-fassociative-math -fno-signed-zeros -fno-trapping-math", "-mfpmath=387"),
    *("-ffp-contract=fast -march=native", "-ffp-model=fast", *SEEN_ONLY),
]
MAIN = """
#include <stdio.h>
#include "{name}.h"

static {name} controller;

int main(void)
{{
    const int32_t why = {name}_init(&controller, 4000);
    const {name}_move move = {{0.2, 1.2, 0.6, 0.15, true}};
    {name}_reset(&controller, &move, 11204);
    for (int64_t k = 0; k < 400; ++k) {{ /* about as the arm is to move */
        const int64_t count = 11204 + 56023 * (1200 * k * k - 2 * k * k * k) / 64000000;
        printf("%a\\n", (double){name}_step(&controller, (int32_t)count));
    }}
    return (int)why;
}}
"""


@pytest.fixture(scope="module")
def exported(exports: Any) -> Path:
    folder = exports.of("ei").folder
    (folder / "main.c").write_text(MAIN.format(name="ei"))
    return folder


def built(command: tuple[str, ...], folder: Path, program: Path) -> bool:
    line = [*command, f"-I{folder}", str(folder / "main.c"), str(folder / "ei.c"), "-lm", "-o", str(program)]
    return subprocess.run(line, capture_output=True, check=False).returncode == 0


def ran(program: Path) -> tuple[int, list[float]]:
    """Exit status of a program, which is the fault of its controller, and its torques."""
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    return done.returncode, [float.fromhex(word) for word in done.stdout.split()]


@pytest.mark.parametrize("name", COMPILERS)
def test_right_flags_give_the_same_torques(exported: Path, tmp_path: Path, name: str):
    program, expected = tmp_path / "program", None
    right = [(*RIGHT, *more.split()) for more in ("-O0", "-Os -fno-math-errno", "-std=gnu11", "-O3 -march=native")]
    for flags in (*right, ("-O3", "-march=native")):  # the last without -ffp-contract
        assert built((name, *flags), exported, program)
        fault, torques = ran(program)
        expected = expected or torques
        assert fault == 0 and torques == expected and len(set(torques)) > 50, flags
    if cpp := shutil.which({"gcc": "g++"}.get(name, "clang++")):
        shutil.copy(exported / "main.c", tmp_path / "main.cpp")
        subprocess.run([name, *RIGHT, "-c", exported / "ei.c", "-o", tmp_path / "ei.o"], check=True)
        command = [cpp, "-std=c++17", "-Wall", "-Wextra", "-Wpedantic", "-Werror", f"-I{exported}"]
        subprocess.run([*command, tmp_path / "main.cpp", tmp_path / "ei.o", "-o", program], check=True)
        assert ran(program) == (0, expected)


@pytest.mark.parametrize(
    ("flags", "unseen"), [*((flags, False) for flags in WRONG), *((flags, True) for flags in WRONG[: -len(SEEN_ONLY)])]
)
@pytest.mark.parametrize("name", COMPILERS)
def test_wrong_flags_are_refused(exported: Path, tmp_path: Path, name: str, flags: str, unseen: bool):
    wrong, empty = tuple(flags.split()), tmp_path / "empty.c"
    empty.write_text("int main(void) { return 0; }\n")
    command = [name, *RIGHT, "-Werror", *wrong, str(empty), "-o", str(tmp_path / "empty")]
    if subprocess.run(command, capture_output=True, check=False).returncode:
        pytest.skip(f"{name} does not take {flags} here")
    if "fast -march" in flags and "fma" not in Path("/proc/cpuinfo").read_text():
        pytest.skip("this machine fuses nothing")
    if built((name, *RIGHT, *wrong, *(UNSEEN if unseen else ())), exported, tmp_path / "program"):
        fault, torques = ran(tmp_path / "program")
        assert 2 <= fault <= len(FAULTS) and set(torques) == {0.0}
    else:
        assert not unseen


@pytest.mark.skipif("gcc" not in COMPILERS, reason="gcc is not installed")
def test_a_mode_that_the_linker_sets_is_refused(exported: Path, tmp_path: Path):
    """Start-up code of gcc for fast mathematics takes tiny numbers as zero in all of a program."""
    objects = [tmp_path / f"{name}.o" for name in ("main", "ei")]
    for target in objects:
        subprocess.run(["gcc", *RIGHT, f"-I{exported}", "-c", exported / f"{target.stem}.c", "-o", target], check=True)
    subprocess.run(["gcc", "-ffast-math", *objects, "-lm", "-o", tmp_path / "program"], check=True)
    fault, torques = ran(tmp_path / "program")
    if fault == 0:
        pytest.skip("this gcc sets nothing")
    assert fault == 1 + list(FAULTS).index("tiny") and set(torques) == {0.0}


def test_wrong_counts_and_no_move_give_no_torque(exported: Path, tmp_path: Path, compiler: tuple[str, ...]):
    shutil.copytree(exported, tmp_path / "ei")
    wrong = 1 + list(FAULTS).index("counts")
    changes = [("4000", counts, wrong) for counts in ("0", "-4000", "2000000000")]
    for before, after, why in (*changes, ("ei_reset(&controller", "ei_next(&controller", 0)):
        (tmp_path / "ei" / "main.c").write_text(MAIN.format(name="ei").replace(before, after))
        assert built((*compiler, *RIGHT), tmp_path / "ei", tmp_path / "program")
        fault, torques = ran(tmp_path / "program")
        assert fault == why and set(torques) == {0.0}


@pytest.mark.skipif(shutil.which("nm") is None, reason="nm is not installed")
def test_all_names_begin_with_the_exports(tmp_path: Path, compiler: tuple[str, ...]):
    name, target = "Ab_2", tmp_path / "made.o"
    assert stopped(export.main, ("c", "ei", "--out", "made", "--name", name, "--no-check"), tmp_path) == (0, "")
    subprocess.run([*compiler, *RIGHT, "-c", tmp_path / "made" / f"{name}.c", "-o", target], check=True)
    listed = subprocess.run(["nm", "-g", "--defined-only", target], capture_output=True, text=True, check=True).stdout
    parts = ("init", "reset", "next", "step")
    assert {line.split()[-1] for line in listed.splitlines()} == {f"{name}_{part}" for part in parts}
    code = re.sub(r"/\*.*?\*/", "", (tmp_path / "made" / f"{name}.h").read_text(), flags=re.S)
    defined = re.findall(r"#define (\w+)|^} (\w+);|^typedef \w+ (\w+);|(\w+)\(", code, re.M)
    names = {each for groups in defined for each in groups if each} - {"defined"}
    assert len(names) >= 7 and all(each == name or each.startswith(f"{name}_") for each in names)


def test_why_a_program_refuses_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, compiler: tuple[str, ...]):
    monkeypatch.setenv("CC", " ".join([compiler[0], "-funsafe-math-optimizations", *UNSEEN]))
    code, errors = stopped(export.main, ("c", "ei", "--out", "made", "--episodes", "1"), tmp_path)
    assert code == 2 and "-funsafe-math-optimizations" in errors
