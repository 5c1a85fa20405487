"""Controllers as C: the command as a user runs it, and programs whose torques are those of Python, to the last bit."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from commands import mistake

from baselines import CONTROLLERS
from eval import export
from eval.comparison.sets import development_set
from eval.deploy import package
from eval.deploy.building import FLAGS, SANITISED, Toolchain, emulated, here, processor
from eval.deploy.check import compare
from eval.deploy.controllers import controller_of, loop_of
from eval.deploy.package import FORMAT, MANIFEST, write
from eval.deploy.sizes import PROCESSORS, footprint
from eval.deploy.source import Loop

ROOT = Path(__file__).resolve().parents[2]
STUDENT, PPO = (str(ROOT / "agents" / "policies" / name / "seed0") for name in ("student", "ppo"))
SPLITS = list(development_set().splits)
NAMES = [name for name in CONTROLLERS if name != "mpc"]
SOURCES = [
    source if source in ("paper", "ei", PPO) else pytest.param(source, marks=pytest.mark.slow)
    for source in (*NAMES, PPO, STUDENT)
]
EXACT = {"sqrt", "floor", "ceil", "fmod", "fabs"}
"""Of the maths library, what programs may call: functions that are exact, or correctly rounded, everywhere."""


@dataclass(frozen=True)
class Once(Toolchain):
    """A compiler that compiles what it is given once, and then copies it."""

    made: dict[Any, Path] = field(default_factory=dict, compare=False)

    def build(self, sources: list[Path], program: Path, *flags: str) -> None:
        key = (*sources, *flags)
        if key not in self.made:
            kept = sources[0].with_name(f"{program.name}-{len(self.made)}")
            super().build(sources, kept, *flags)
            self.made[key] = kept
        shutil.copy(self.made[key], program)


@dataclass(frozen=True)
class Exported:
    """Sources of a loop in a folder."""

    folder: Path
    loop: Loop
    toolchain: Toolchain


class Exports:
    """Controllers that have been exported, each once."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.made: dict[tuple[str, bool], Exported] = {}

    def of(self, source: str, guard: bool = False) -> Exported:
        try:
            compiler = here().compiler
        except ValueError as error:
            pytest.skip(str(error))
        if (source, guard) not in self.made:
            loop = loop_of(source, guard)
            folder = self.folder / f"{loop.name}-{guard}"
            write(folder, loop)
            self.made[source, guard] = Exported(folder, loop, Once(compiler))
        return self.made[source, guard]


@pytest.fixture(scope="module")
def exports(tmp_path_factory: pytest.TempPathFactory) -> Exports:
    return Exports(tmp_path_factory.mktemp("exports"))


@cache
def in_python(source: str, guard: bool) -> Any:
    """The controller in Python, made once."""
    return controller_of(source, guard)


def assert_equal(
    made: Exported,
    source: str,
    guard: bool,
    split: str,
    toolchain: Toolchain | None = None,
    flags: tuple[str, ...] = (),
) -> None:
    """Assert that program and controller ask for the same torques on a development scenario."""
    scenarios = development_set().splits[split]
    found = compare(made.folder, made.loop, in_python(source, guard), scenarios, 1, toolchain or made.toolchain, flags)
    assert found.samples > 1000
    assert found.equal == found.samples, f"{split}: {found.samples - found.equal} differ, by {found.largest} at most"
    assert found.costs[0] == found.costs[1]


# Programs


@pytest.mark.parametrize("source", SOURCES, ids=lambda source: Path(source).parent.name or source)
def test_program_is_the_controller(exports: Exports, source: str) -> None:
    sources = [*NAMES, PPO, STUDENT]
    guard = source in ("ei", "adaptive", STUDENT)
    made = exports.of(source, guard)
    first = sources.index(source)
    for k in range(len(SPLITS) if guard else 2):  # others on two splits each, by turns
        assert_equal(made, source, guard, SPLITS[(first * 2 + k) % len(SPLITS)])


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@pytest.mark.parametrize("source", ["ei", STUDENT], ids=["ei", "student"])
def test_program_of_another_compiler(exports: Exports, compiler: str, source: str) -> None:
    found, made = shutil.which(compiler), exports.of(source, True)
    if found is None:
        pytest.skip(f"{compiler} is not installed")
    if Path(found).resolve() == Path(made.toolchain.compiler[0]).resolve():
        pytest.skip(f"{compiler} is that of the other tests")
    assert_equal(made, source, True, "randomized", Toolchain((found,)))


def test_compilers_are_as_strict_as_they_can_be() -> None:
    assert {"-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror"} <= set(FLAGS)


@pytest.mark.slow
@pytest.mark.parametrize("flags", [("-O0",), ("-O3", "-Wshadow=local")], ids=" ".join)
def test_program_of_each_optimisation(exports: Exports, flags: tuple[str, ...]) -> None:
    compiler = shutil.which("gcc")
    if compiler is None:
        pytest.skip("gcc is not installed")
    assert_equal(exports.of("adaptive", True), "adaptive", True, "payload", Toolchain((compiler,)), flags)


@pytest.mark.slow
def test_program_stays_within_its_memory(exports: Exports) -> None:
    """A program that reads or writes beyond an array, or overflows, stops; a student's holds `adaptive`."""
    assert_equal(exports.of(STUDENT, True), STUDENT, True, "drive", flags=(*SANITISED, "-O1"))


@pytest.mark.parametrize("machine", ["aarch64", "arm"])
def test_program_on_another_machine(exports: Exports, machine: str) -> None:
    toolchain = emulated(machine)
    if toolchain is None:
        pytest.skip(f"no compiler and emulator for {machine}")
    assert_equal(exports.of("ei", True), "ei", True, "randomized", toolchain)


@pytest.mark.parametrize("core", PROCESSORS)
def test_footprint(exports: Exports, core: str) -> None:
    if processor(core) is None:
        pytest.skip(f"no compiler for {core}")
    made = exports.of("ei")
    taken = footprint(made.folder, made.loop.name, core)
    assert taken is not None
    assert 1000 < taken.flash < 30_000
    assert 100 < taken.memory < 10_000
    assert 50 < taken.stack < 10_000


@pytest.mark.parametrize("source", ["adaptive", STUDENT], ids=["adaptive", "student"])
def test_program_calls_nothing_but_exact_functions(exports: Exports, source: str, tmp_path: Path) -> None:
    made, tool = exports.of(source, True), shutil.which("nm")
    if tool is None:
        pytest.skip("nm is not installed")
    target = tmp_path / "controller.o"
    here().build([made.folder / f"{made.loop.name}.c"], target, "-c", "-O0")
    listed = subprocess.run([tool, "-u", str(target)], capture_output=True, text=True, check=True).stdout
    called = {line.split()[-1].lstrip("_") for line in listed.splitlines() if line.strip()}
    assert called <= EXACT | {"memset", "memcpy", "memcmp", "stack_chk_fail", "GLOBAL_OFFSET_TABLE_"}
    text = (made.folder / f"{made.loop.name}.c").read_text()
    assert not re.search(r"^static [a-z_0-9]+ \w+(\[\d+\])?;", text, re.MULTILINE)  # no memory but the struct


# The command


def run(*arguments: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(ROOT / "eval" / "export.py"), *arguments]
    environment = {**os.environ, **environment}
    return subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=300, check=False)


def exporting(*arguments: str, cwd: Path) -> str:
    """The one line with which the command refuses these arguments."""
    line = mistake(export.main, arguments, cwd)
    assert line.startswith("eval/export.py: ")
    return line


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.slow
def test_command(tmp_path: Path) -> None:
    try:
        here()
    except ValueError as error:
        pytest.skip(str(error))
    done = run("ei", "--out", "made", "--episodes", "1", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "written to made: ei.h, ei.c" in done.stdout
    assert re.search(r"(\d+) of \1 torques are equal to the last bit", done.stdout)
    files = contents(tmp_path / "made")
    assert {"ei.c", "ei.h", "in_the_loop.c", "README.md", MANIFEST} == set(files)
    manifest = json.loads(files.pop(MANIFEST))
    assert manifest["format"] == FORMAT and manifest["name"] == "ei"
    assert manifest["sha256"] == {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}
    assert "ei_init" in files["README.md"].decode() and "-ffp-contract=off" in files["README.md"].decode()
    assert [path.name for path in tmp_path.iterdir()] == ["made"]  # no temporary folder


def test_policy_by_its_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    export.export(export.Config(PPO, tmp_path / "made", check=False))
    assert "ppo.h, ppo.c" in capsys.readouterr().out
    manifest = json.loads((tmp_path / "made" / MANIFEST).read_text())
    assert "content hash" in manifest["title"] and "behind the guard" in manifest["title"]


def test_same_sources_every_time(exports: Exports, tmp_path: Path) -> None:
    made = exports.of("adaptive", True)
    write(tmp_path / "again", loop_of("adaptive", True))
    first, second = (contents(folder)["adaptive.c"] for folder in (made.folder, tmp_path / "again"))
    assert first == second


def test_earlier_export_is_replaced(tmp_path: Path) -> None:
    for guard in (True, False):
        export.export(export.Config("paper", tmp_path / "made", guard=guard, check=False))
    assert "guard" not in json.loads((tmp_path / "made" / MANIFEST).read_text())["title"]
    assert [path.name for path in tmp_path.iterdir()] == ["made"]


def test_folder_in_use(tmp_path: Path) -> None:
    (tmp_path / "work").mkdir()
    (tmp_path / "work" / "thesis.tex").touch()
    line = exporting("ei", "--out", "work", cwd=tmp_path)
    assert "work holds other files" in line and "--out" in line
    assert [path.name for path in (tmp_path / "work").iterdir()] == ["thesis.tex"]


def test_file_in_place_of_the_folder(tmp_path: Path) -> None:
    (tmp_path / "made").write_text("mine")
    assert "made is a file" in exporting("ei", "--out", "made", cwd=tmp_path)
    assert (tmp_path / "made").read_text() == "mine"
    assert "made" in exporting("ei", "--out", "made/below", cwd=tmp_path)


def test_folder_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(package.os, "access", lambda *_: False)
    assert "cannot write to" in exporting("ei", "--out", "made", cwd=tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("adaptiv", ("'adaptiv'", "did you mean 'adaptive'?")),
        ("Ei", ("'Ei'", "did you mean 'ei'?")),
        ("warp", ("'warp'", "neither a classical controller nor the folder of a policy")),
        ("mpc", ("'mpc'", "cannot be exported", "these can: paper", "adaptive")),
    ],
)
def test_what_cannot_be_exported(tmp_path: Path, source: str, words: tuple[str, ...]) -> None:
    line = exporting(source, "--out", "made", cwd=tmp_path)
    assert all(word in line for word in words), line
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (("--episodes", "0"), "--episodes must lie within 1 and 200, got 0"),
        (("--plan-samples", "20"), "--plan-samples must lie within 1 and 19, got 20"),
        (("--onnx",), "policy"),
    ],
)
def test_bad_options(tmp_path: Path, arguments: tuple[str, ...], word: str) -> None:
    assert word in exporting("ei", "--out", "made", *arguments, cwd=tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("name", "value"), [("PATH", ""), ("CC", "no-such-compiler")])
def test_no_compiler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, value: str) -> None:
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv(name, value)
    line = exporting("ei", "--out", "made", cwd=tmp_path)
    assert "no C compiler" in line and "--no-check" in line and value in line
    assert not list(tmp_path.iterdir())
    export.export(export.Config("ei", tmp_path / "made", check=False))
    assert (tmp_path / "made" / "ei.c").is_file()


def test_compiler_that_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "false")
    line = exporting("ei", "--out", "made", "--episodes", "1", cwd=tmp_path)
    assert "false" in line and "failed" in line


@pytest.mark.parametrize(
    ("damage", "word"),
    [
        (lambda folder: (folder / "policy.json").write_text("{"), "policy.json"),
        (lambda folder: next(folder.glob("*.safetensors")).write_bytes(b"0" * 100), "safetensors"),
        (lambda folder: next(folder.glob("*.safetensors")).unlink(), "safetensors"),
    ],
    ids=["manifest", "weights", "no weights"],
)
def test_damaged_policy(tmp_path: Path, damage: Any, word: str) -> None:
    shutil.copytree(PPO, tmp_path / "policy")
    damage(tmp_path / "policy")
    assert word in exporting("policy", "--out", "made", cwd=tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["policy"]


def test_interrupted_write_leaves_the_earlier_export(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, loop = tmp_path / "made", loop_of("paper", False)
    write(folder, loop)
    before = contents(folder)
    written, write_bytes = [], Path.write_bytes

    def stops(self: Path, content: bytes) -> int:
        written.append(self.name)
        if len(written) == 3:
            raise KeyboardInterrupt
        return write_bytes(self, content)

    monkeypatch.setattr(Path, "write_bytes", stops)
    with pytest.raises(KeyboardInterrupt):
        write(folder, loop_of("rigid", False))
    assert contents(folder) == before
    assert [path.name for path in tmp_path.iterdir()] == ["made"]


def test_failed_rename_leaves_the_earlier_export(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "made"
    write(folder, loop_of("paper", False))
    before, rename = contents(folder), Path.rename

    def fails(self: Path, target: Path) -> Path:
        if target == folder and not self.name.endswith("-replaced"):
            raise OSError("disk full")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", fails)
    with pytest.raises(OSError, match="disk full"):
        write(folder, loop_of("rigid", False))
    assert contents(folder) == before
    assert [path.name for path in tmp_path.iterdir()] == ["made"]
