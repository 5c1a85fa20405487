"""Exported C as others build it: flags, C++, several exports in one program, compilers with options."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from commands import mistake

from eval import export
from eval.deploy.building import here
from eval.deploy.controllers import loop_of
from eval.deploy.package import write
from eval.deploy.source import FAULTS

ROOT = Path(__file__).resolve().parents[2]
RIGHT = ("-std=c99", "-O2", "-ffp-contract=off")
COMPILERS = [name for name in ("gcc", "clang") if shutil.which(name)]
UNSEEN = (
    *("-U__FAST_MATH__", "-U__ASSOCIATIVE_MATH__", "-U__RECIPROCAL_MATH__", "-U__FINITE_MATH_ONLY__"),
    *("-U__NO_SIGNED_ZEROS__", "-U__FLT_EVAL_METHOD__", "-D__FLT_EVAL_METHOD__=0"),
)
"""Flags of a compiler that has no macros for what it does."""
WRONG = [
    *("-ffast-math", "-Ofast", "-funsafe-math-optimizations", "-freciprocal-math", "-ffinite-math-only"),
    *("-fno-signed-zeros", "-fassociative-math -fno-signed-zeros -fno-trapping-math", "-mfpmath=387"),
    *("-ffp-contract=fast -march=native", "-ffp-model=fast", "-fsingle-precision-constant"),
    *("-mfpmath=both", "-std=gnu99 -mfpmath=387"),
]
SEEN_ONLY = ("-fsingle-precision-constant", "-mfpmath=both")
"""Of them, what only a compiler's macros and types tell for sure."""

MAIN = """
#include <stdio.h>
#include "{name}.h"

static {name} controller;

int main(void)
{{
    const int32_t why = {name}_init(&controller, 4000);
    const {name}_move move = {{0.2, 1.2, 0.6, 0.15}};
    {name}_reset(&controller, &move, 11204);
    for (int64_t k = 0; k < 400; ++k) {{ /* about as the arm is to move */
        const int64_t count = 11204 + 56023 * (1200 * k * k - 2 * k * k * k) / 64000000;
        printf("%a\\n", (double){name}_step(&controller, (int32_t)count));
    }}
    return (int)why;
}}
"""


@pytest.fixture(autouse=True)
def compiler() -> str:
    try:
        return here().compiler[0]
    except ValueError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("exports") / "ei"
    write(folder, loop_of("ei"))
    (folder / "main.c").write_text(MAIN.format(name="ei"))
    return folder


def built(command: tuple[str, ...], folder: Path, program: Path) -> bool:
    line = [*command, f"-I{folder}", str(folder / "main.c"), str(folder / "ei.c"), "-lm", "-o", str(program)]
    return subprocess.run(line, capture_output=True, check=False).returncode == 0


def taken(compiler: str, flags: tuple[str, ...], folder: Path) -> bool:
    """Tell whether a compiler has flags, and this machine what they ask for."""
    empty = folder / "empty.c"
    empty.write_text("int main(void) { return 0; }\n")
    command = [compiler, *RIGHT, "-Werror", *flags, str(empty), "-o", str(folder / "empty")]
    return subprocess.run(command, capture_output=True, check=False).returncode == 0


def ran(program: Path) -> tuple[int, list[str]]:
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    return done.returncode, done.stdout.split()


# Flags


@pytest.mark.parametrize("name", COMPILERS)
def test_right_flags_give_the_same_torques(exported: Path, tmp_path: Path, name: str) -> None:
    assert built((name, *RIGHT), exported, tmp_path / "reference")
    why, reference = ran(tmp_path / "reference")
    assert why == 0 and len(set(reference)) > 50
    for more in ("-O0", "-O1", "-O3", "-Os", "-O3 -march=native", "-fno-math-errno", "-std=gnu11 -march=native"):
        assert built((name, *RIGHT, *more.split()), exported, tmp_path / "program"), more
        assert ran(tmp_path / "program") == (0, reference), more
    assert built((name, "-O3", "-march=native"), exported, tmp_path / "program")  # nothing said of contraction
    assert ran(tmp_path / "program") == (0, reference)


@pytest.mark.parametrize("unseen", [False, True], ids=["as they are", "without macros"])
@pytest.mark.parametrize("flags", WRONG)
@pytest.mark.parametrize("name", COMPILERS)
def test_wrong_flags_are_refused(exported: Path, tmp_path: Path, name: str, flags: str, unseen: bool) -> None:
    wrong = tuple(flags.split())
    if not taken(name, wrong, tmp_path):
        pytest.skip(f"{name} does not take {flags} here")
    if unseen and flags in SEEN_ONLY:
        pytest.skip("a macro or a type tells of it, always")
    if "fast -march" in flags and "fma" not in Path("/proc/cpuinfo").read_text():
        pytest.skip("this machine fuses nothing")
    if built((name, *RIGHT, *wrong, *(UNSEEN if unseen else ())), exported, tmp_path / "program"):
        why, torques = ran(tmp_path / "program")
        assert 2 <= why <= len(FAULTS)
        assert {float.fromhex(torque) for torque in torques} == {0.0}
    else:
        assert not unseen


def test_what_a_linker_sets_is_refused(exported: Path, tmp_path: Path) -> None:
    """Start-up code of gcc for fast mathematics takes tiny numbers as zero in all of a program."""
    if "gcc" not in COMPILERS:
        pytest.skip("gcc is not installed")
    objects = []
    for name in ("main", "ei"):
        objects.append(tmp_path / f"{name}.o")
        line = ["gcc", *RIGHT, f"-I{exported}", "-c", str(exported / f"{name}.c"), "-o", str(objects[-1])]
        subprocess.run(line, check=True)
    subprocess.run(["gcc", "-ffast-math", *objects, "-lm", "-o", tmp_path / "program"], check=True)
    why, torques = ran(tmp_path / "program")
    if why == 0:
        pytest.skip("this gcc sets nothing")
    assert why == 1 + list(FAULTS).index("tiny") and {float.fromhex(torque) for torque in torques} == {0.0}


@pytest.mark.parametrize("counts", ["0", "-4000", "2000000000"])
def test_wrong_counts_give_no_torque(exported: Path, tmp_path: Path, compiler: str, counts: str) -> None:
    shutil.copytree(exported, tmp_path / "ei")
    main = tmp_path / "ei" / "main.c"
    main.write_text(main.read_text().replace("4000", counts))
    assert built((compiler, *RIGHT), tmp_path / "ei", tmp_path / "program")
    why, torques = ran(tmp_path / "program")
    assert why == 1 + list(FAULTS).index("counts") and {float.fromhex(torque) for torque in torques} == {0.0}


# C++, and other exports


def test_header_in_cpp(exported: Path, tmp_path: Path, compiler: str) -> None:
    cpp = shutil.which("g++") or shutil.which("clang++")
    if cpp is None:
        pytest.skip("no compiler for C++")
    shutil.copy(exported / "main.c", tmp_path / "main.cpp")
    subprocess.run([compiler, *RIGHT, "-c", exported / "ei.c", "-o", tmp_path / "ei.o"], check=True)
    command = [cpp, "-std=c++17", "-Wall", "-Wextra", "-Wpedantic", "-Werror", f"-I{exported}"]
    command += [str(tmp_path / "main.cpp"), str(tmp_path / "ei.o"), "-o", str(tmp_path / "program")]
    subprocess.run(command, check=True)
    assert built((compiler, *RIGHT), exported, tmp_path / "reference")
    assert ran(tmp_path / "program") == ran(tmp_path / "reference")


def test_no_names_that_are_keywords_of_cpp(tmp_path: Path) -> None:
    """`adaptive` has a kernel with a variable `new`."""
    cpp = shutil.which("g++")
    if cpp is None:
        pytest.skip("g++ is not installed")
    write(tmp_path / "made", loop_of("adaptive"))
    line = [cpp, "-x", "c++", "-std=c++17", "-fsyntax-only", str(tmp_path / "made" / "adaptive.c")]
    subprocess.run(line, check=True)


def test_exports_in_one_program(tmp_path: Path, compiler: str) -> None:
    """Policies of two seeds and a controller, all in one folder and one program, do what each does alone."""
    sources = {
        "ppo": str(ROOT / "agents/policies/ppo/seed0"),
        "ppo_b": str(ROOT / "agents/policies/ppo/seed1"),
        "ei": "ei",
    }
    together, alone = tmp_path / "together", []
    together.mkdir()
    for name, source in sources.items():
        write(tmp_path / name, replace(loop_of(source), name=name))
        (tmp_path / name / "main.c").write_text(MAIN.format(name=name))
        for file in (f"{name}.h", f"{name}.c"):
            shutil.copy(tmp_path / name / file, together)
        parts = [str(tmp_path / name / file) for file in ("main.c", f"{name}.c")]
        line = [compiler, *RIGHT, *parts, "-lm", "-o", str(tmp_path / "one")]
        subprocess.run(line, check=True)
        alone += ran(tmp_path / "one")[1]
    assert len(set(alone)) > 300
    parts = [
        MAIN.format(name=name).replace("main(", f"run_{name}(").replace("controller", f"of_{name}") for name in sources
    ]
    calls = " | ".join(f"run_{name}()" for name in sources)
    (together / "main.c").write_text("\n".join(parts) + f"\nint main(void)\n{{\n    return {calls};\n}}\n")
    files = map(str, together.glob("*.c"))
    subprocess.run([compiler, *RIGHT, *files, "-lm", "-o", str(tmp_path / "all")], check=True)
    assert ran(tmp_path / "all") == (0, alone)


@pytest.mark.parametrize("name", ["mine", "Ab_2"])
def test_all_names_begin_with_the_exports(tmp_path: Path, compiler: str, name: str) -> None:
    tool = shutil.which("nm")
    if tool is None:
        pytest.skip("nm is not installed")
    export.export(export.Config("ei", tmp_path / "made", name=name, check=False))
    target = tmp_path / "made.o"
    subprocess.run([compiler, *RIGHT, "-c", tmp_path / "made" / f"{name}.c", "-o", target], check=True)
    listed = subprocess.run([tool, "-g", "--defined-only", target], capture_output=True, text=True, check=True).stdout
    assert {line.split()[-1] for line in listed.splitlines()} == {
        f"{name}_{part}" for part in ("init", "reset", "step")
    }
    header = (tmp_path / "made" / f"{name}.h").read_text()
    defined = re.findall(
        r"#define (\w+)|^} (\w+);|^typedef \w+ (\w+);|(\w+)\(", re.sub(r"/\*.*?\*/", "", header, flags=re.S), re.M
    )
    names = {name for found in defined for name in found if name} - {"defined"}
    assert len(names) >= 7 and all(found == name or found.startswith(f"{name}_") for found in names)


@pytest.mark.parametrize(
    "name", ["a-b", "2nd", "class", "int", "real", "_mine", "a__b", "mine_", "begin", "in_the_loop"]
)
def test_bad_names(tmp_path: Path, name: str) -> None:
    line = mistake(export.main, ("ei", "--out", "made", "--name", name, "--no-check"), tmp_path)
    assert "--name" in line and repr(name) in line
    assert not list(tmp_path.iterdir())


def test_an_fmu_has_its_name(tmp_path: Path) -> None:
    assert "--name" in mistake(export.main, ("arm", "--out", "made", "--name", "mine"), tmp_path)
    assert not list(tmp_path.iterdir())


# Compilers


def test_compiler_with_options(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, compiler: str) -> None:
    (tmp_path / "a compiler").symlink_to(compiler)
    monkeypatch.setenv("CC", f"'{tmp_path}/a compiler' -O1 -DNOTHING='1 2'")
    assert here().compiler == (f"{tmp_path}/a compiler", "-O1", "-DNOTHING=1 2")
    export.export(export.Config("ei", tmp_path / "made", name="mine", episodes=1))


@pytest.mark.parametrize("command", ["gcc '", "no-such-compiler -O2"])
def test_compiler_that_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str) -> None:
    monkeypatch.setenv("CC", command)
    line = mistake(export.main, ("ei", "--out", "made"), tmp_path)
    assert "CC" in line and repr(command) in line
    assert not list(tmp_path.iterdir())


def test_program_that_refuses_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, compiler: str) -> None:
    """The check of an export ends with why its program gives no torque."""
    wrapper = tmp_path / "cc"
    wrapper.write_text(f'#!/bin/sh\nexec {compiler} "$@" -funsafe-math-optimizations {" ".join(UNSEEN)}\n')
    wrapper.chmod(0o755)
    monkeypatch.setenv("CC", os.fspath(wrapper))
    line = mistake(export.main, ("ei", "--out", "made", "--episodes", "1"), tmp_path)
    assert "-funsafe-math-optimizations" in line
