"""Controllers as C: programs whose torques are those of Python, to the last bit, and the command that writes them."""

import hashlib
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from commands import ROOT, mistake, python, stopped
from refusals import refused

from baselines import CONTROLLERS
from baselines.guard.guard import LEVEL
from beltarm_env.engine.translation.types import TranslationError
from beltarm_env.kernels.layout import LANES, Rows
from eval import export
from eval.exports.compilers import FLAGS, PROCESSORS, SANITISED, Toolchain, footprint, native
from eval.exports.folder import FORMAT, MANIFEST
from eval.exports.program import exportable, loop_of, write_program
from eval.exports.source import for_one_lane

EXAMPLES = ROOT / "docs" / "examples"
PAGE = (ROOT / "docs/guide/export.md").read_text(encoding="utf-8")
STUDENT, PPO = (str(ROOT / "agents" / "policies" / name / "seed0") for name in ("student", "ppo"))
SOURCES = [*(name for name in CONTROLLERS if name != "mpc"), PPO, STUDENT]
EXACT = {"sqrt", "floor", "ceil", "fmod", "fabs"}
"""Functions of the maths library that are exact, or correctly rounded, everywhere."""


def identity(source: object) -> str | None:
    return Path(source).parent.name or source if isinstance(source, str) else None


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize(
    "source",
    [each if each in ("ei", "adaptive", PPO) else pytest.param(each, marks=pytest.mark.slow) for each in SOURCES],
    ids=identity,
)
def test_the_program_is_the_controller(exports: Any, source: str):
    made = exports.of(source, guard=source in ("ei", "adaptive", STUDENT))
    made.assert_equal("nominal")
    made.assert_equal("randomized", moves=2)


@pytest.mark.parametrize("source", ["ei", pytest.param(STUDENT, marks=pytest.mark.slow)], ids=identity)
def test_the_program_of_another_compiler_and_with_sanitizers(exports: Any, source: str):
    """With sanitizers it stops where it reads or writes beyond an array, or overflows."""
    exports.of(source).assert_equal("drive", flags=(*SANITISED, "-O1"))
    for path in [Path(path) for name in ("gcc", "clang") if (path := shutil.which(name))]:
        if path.resolve() != Path(exports.toolchain.compiler[0]).resolve():
            exports.of(source).assert_equal("randomized", Toolchain((str(path),)))


@pytest.mark.parametrize("source", ["adaptive", pytest.param(STUDENT, marks=pytest.mark.slow)], ids=identity)
def test_the_program_calls_nothing_but_exact_functions(exports: Any, source: str, tmp_path: Path):
    made, tool = exports.of(source), shutil.which("nm")
    if tool is None:
        pytest.skip("nm is not installed")
    native().build([made.folder / f"{made.loop.name}.c"], tmp_path / "made.o", "-c", "-O0")
    listed = subprocess.run([tool, "-u", tmp_path / "made.o"], capture_output=True, text=True, check=True).stdout
    called = {line.split()[-1].lstrip("_") for line in listed.splitlines() if line.strip()}
    assert called <= EXACT | {"memset", "memcpy", "memcmp", "stack_chk_fail", "GLOBAL_OFFSET_TABLE_"}
    assert not re.search(r"^static [a-z_0-9]+ \w+(\[\d+\])?;", made.text, re.MULTILINE)  # no memory but the struct


def test_sources_are_the_same_every_time_and_others_where_plans_are_spread(exports: Any, tmp_path: Path):
    for name, source, samples in (("again", "ei", 1), ("spread", "adaptive", 8)):
        write_program(tmp_path / name, loop_of(source, plan_samples=samples))
        assert ((tmp_path / name / f"{source}.c").read_text() == exports.of(source).text) == (samples == 1)
    refused(ValueError, ("--plan-samples 8",), lambda: loop_of("preview", plan_samples=8))


class Room(NamedTuple):
    anything: Rows
    block: Any
    nothing: Any = None


def test_memory_has_one_lane_where_it_is_declared_to_have_rows_of_lanes():
    block = np.ones(7)
    found = for_one_lane(Room(np.ones((2, 3 * LANES)), block))
    assert found.anything.shape == (2, 3) and found.block is block and found.nothing is None
    for room, words in (
        (Room(np.ones(LANES + 1), block), ("Room.anything", f"{LANES + 1} numbers")),
        (Room(np.ones(LANES), np.ones(2 * LANES)), ("Room.block", "declare it as Rows")),
    ):
        refused(TranslationError, words, lambda room=room: for_one_lane(room))


@pytest.mark.parametrize("core", PROCESSORS)
def test_footprint(exports: Any, core: str):
    taken = footprint(exports.of("ei").folder, "ei", core)
    if taken is None:
        pytest.skip(f"no compiler for {core}")
    assert 1000 < taken.flash < 30_000 and 100 < taken.memory < 10_000 and 50 < taken.stack < 10_000


@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(blocks("python"))))
def test_python_on_the_page_runs(compiler: Any, number: int, tmp_path: Path):
    for extra in ("fmpy", "onnx"):
        if re.search(rf"(import|from) {extra}\b", blocks("python")[number]):
            pytest.importorskip(extra)
    python("-c", blocks("python")[number], cwd=tmp_path, path=(ROOT,))


def test_the_main_loop_on_the_page_compiles(exports: Any, tmp_path: Path):
    (program,), made = blocks("c"), exports.of("adaptive")
    (tmp_path / "main.c").write_text(program, encoding="utf-8")
    native().build([tmp_path / "main.c"], tmp_path / "main.o", "-I", str(made.folder), "-c")
    header = (made.folder / "adaptive.h").read_text(encoding="utf-8")
    assert all(name in header and name in PAGE for name in ("memory_guard_row", "memory_own_belief_tracks_surprise"))
    assert f"memory_guard_row[{LEVEL}]" in PAGE
    assert {"-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror"} <= set(FLAGS)


def write(*arguments: str, cwd: Path) -> dict[str, Any]:
    assert stopped(export.main, ("c", *arguments, "--out", "made"), cwd) == (0, "")
    return json.loads((cwd / "made" / MANIFEST).read_text())


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_the_command(compiler: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    manifest = write("ei", "--episodes", "1", cwd=tmp_path)
    assert re.search(r"(\d+) of \1 torques", capsys.readouterr().out)
    files = contents(tmp_path / "made")
    del files[MANIFEST]
    assert set(files) == {"ei.c", "ei.h", "in_the_loop.c", "README.md"}
    assert manifest["format"] == FORMAT and manifest["name"] == "ei"
    assert manifest["sha256"] == {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}
    assert b"ei_init" in files["README.md"] and b"-ffp-contract=off" in files["README.md"]
    (own := tmp_path / "made" / "main.c").touch()
    assert "main.c" in stopped(export.main, ("c", PPO, "--no-check", "--out", "made"), tmp_path)[1] and own.exists()
    own.unlink()
    title = write(PPO, "--no-check", cwd=tmp_path)["title"]
    assert "SHA-256" in title and "guard" in title
    manifest = write(f"{EXAMPLES / 'my_servo.py'}:MyServo", "--episodes", "1", "--no-guard", cwd=tmp_path)
    assert re.search(r"(\d+) of \1 torques", capsys.readouterr().out)
    assert manifest["name"] == "my_servo" and "guard" not in manifest["title"]
    assert "k_my_law" in (tmp_path / "made" / "my_servo.c").read_text()
    assert {path.name for path in (tmp_path / "made").glob("*.[ch]")} == {"my_servo.c", "my_servo.h", "in_the_loop.c"}
    assert [path.name for path in tmp_path.iterdir()] == ["made"]


def test_what_no_program_is(compiler: Any, tmp_path: Path):
    """Another law from its second move on, another shape of the reference, an arm that observations do not show."""
    own = "class Tired(MyServo):\n    def predict(self, observation, state=None, *more, **named):\n"
    own += "        self.calls = 0 if state is None else self.calls + 1\n"
    own += "        action, state = super().predict(observation, state, *more, **named)\n"
    own += "        return action * (1.0 if self.calls < 1200 else 0.5), state\n"
    own += "class Quintic(MyServo):\n    profile = 'quintic'\n"
    own += "class Geared(MyServo):\n    def __init__(self):\n        super().__init__()\n"
    own += "        self.params = type(self.params)(gear_ratio=120.0)\n"
    (tmp_path / "own.py").write_text(f"{(EXAMPLES / 'my_servo.py').read_text()}\n\n{own}")
    for name, word in {"Quintic": "'trapezoid'", "Geared": "gear_ratio 120.0"}.items():
        assert word in mistake(export.main, ("c", f"own.py:{name}", "--no-check", "--out", "made"), tmp_path)
    assert "differ" in mistake(export.main, ("c", "own.py:Tired", "--episodes", "1", "--out", "made"), tmp_path)
    assert not (tmp_path / "made").exists()


def test_users_files_are_not_replaced(tmp_path: Path):
    (tmp_path / "work").mkdir()
    for file in (tmp_path / "work" / "thesis.tex", tmp_path / "file"):
        file.write_text("mine")
    for out in ("work", "file", "file/below"):
        assert out.split("/")[0] in mistake(export.main, ("c", "ei", "--out", out), tmp_path)
    assert (tmp_path / "work" / "thesis.tex").read_text() == (tmp_path / "file").read_text() == "mine"
    assert {path.name for path in tmp_path.iterdir()} == {"work", "file"}


def test_what_cannot_be_exported(tmp_path: Path):
    for arguments, words in (
        (("adaptiv",), ("'adaptiv'", "'adaptive'")),
        (("warp",), ("'warp'",)),
        (("mpc",), ("'mpc'", *exportable())),
        ((f"{EXAMPLES / 'my_controller.py'}:MyController",), ("MyController", "kernel()")),
        (("warp.py:Servo",), ("warp.py",)),
        (("ei", "--episodes", "0"), ("--episodes", "200")),
        (("ei", "--plan-samples", "20"), ("--plan-samples", "19")),
        *((("ei", "--name", name), ("--name", repr(name))) for name in ("a-b", "class", "real", "a__b", "begin")),
    ):
        line = mistake(export.main, ("c", *arguments, "--out", "made", "--no-check"), tmp_path)
        assert all(word in line for word in words), line
        assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("name", "value"), [("PATH", ""), ("CC", "no-such-compiler -O2"), ("CC", "gcc '")])
def test_no_compiler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, value: str):
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv(name, value)
    assert value in mistake(export.main, ("c", "ei", "--out", "made"), tmp_path) and not list(tmp_path.iterdir())
    write("ei", "--no-check", cwd=tmp_path)
    assert (tmp_path / "made" / "ei.c").is_file()


def test_compilers_with_options_and_such_that_fail(compiler: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "a compiler").symlink_to(compiler[0])
    monkeypatch.setenv("CC", f"'{tmp_path}/a compiler' -O1 -DNOTHING='1 2'")
    assert native().compiler == (f"{tmp_path}/a compiler", "-O1", "-DNOTHING=1 2")
    write("ei", "--name", "mine", "--episodes", "1", cwd=tmp_path)
    monkeypatch.setenv("CC", "false")
    code, errors = stopped(export.main, ("c", "ei", "--out", "made", "--episodes", "1"), tmp_path)
    assert code == 2 and "false" in errors


def test_a_failed_export_leaves_the_earlier_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    folder = tmp_path / "made"
    write_program(folder, loop_of("paper", False))
    before, rename, write, written = contents(folder), Path.rename, Path.write_bytes, iter([True, True, False])

    def stops(self: Path, content: bytes) -> int:
        if next(written):
            return write(self, content)
        raise KeyboardInterrupt

    def fails(self: Path, target: Path) -> Path:
        if target == folder and not self.name.endswith("-replaced"):
            raise OSError("disk full")
        return rename(self, target)

    for function, replacement in (("rename", fails), ("write_bytes", stops)):
        with monkeypatch.context() as patch, pytest.raises((KeyboardInterrupt, OSError)):
            patch.setattr(Path, function, replacement)
            write_program(folder, loop_of("rigid", False))
        assert contents(folder) == before and [path.name for path in tmp_path.iterdir()] == ["made"]


def test_onnx(tmp_path: Path):
    onnx = pytest.importorskip("onnx")
    assert stopped(export.main, ("onnx", PPO, "--out", "made/policy.onnx"), tmp_path) == (0, "")
    assert onnx.load(tmp_path / "made" / "policy.onnx").graph.output[0].name == "residual"
    assert "--out" in mistake(export.main, ("onnx", PPO, "--out", "policy.txt"), tmp_path)
    for name in ("c", "onnx"):
        assert "nowhere" in mistake(export.main, (name, "nowhere", "--out", "x.onnx"), tmp_path)
    assert "'adaptive'" in mistake(export.main, ("adaptive", "--out", "made"), tmp_path)
