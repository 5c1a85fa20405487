"""What commands tell: `--help` of each, and make of mistakes and its targets."""

import os
import re
import runpy
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from commands import ROOT, is_command, started, stopped

from agents.learners.registry import ALGORITHMS
from eval.studies._frame import names

COMMANDS = [
    path.relative_to(ROOT).as_posix()
    for package in ("baselines", "eval", "train")
    for path in sorted((ROOT / package).glob("*.py"))
    if is_command(path) and path.stem not in ("study", "export")
]
COMMANDS += [f"eval/study.py {name}" for name in names()]


def help_of(command: str, capfd: pytest.CaptureFixture[str]) -> str:
    script, *words = command.split()
    assert stopped(lambda: runpy.run_path(script, run_name="__main__"), (*words, "--help"), ROOT) == (0, "")
    return capfd.readouterr().out


@pytest.mark.parametrize("command", COMMANDS)
def test_help_is_plain_and_fits(command: str, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]):
    shown = ""
    for columns in (200, 60) if command == COMMANDS[0] else (60,):
        monkeypatch.setenv("COLUMNS", str(columns))
        shown = help_of(command, capfd)
        assert max(len(line) for line in shown.splitlines() if line.startswith(("╭", "│", "╰"))) <= columns
    usage, purpose, *_ = shown.split("\n\n")
    assert usage.startswith(f"usage: {command.split()[0]}") and len(purpose.split()) > 3
    for clutter in ("None", "(default: )", "''", "True", "False", "]]", str(ROOT)):
        assert clutter not in shown, clutter
    if command in (f"train/{name}.py" for name in ALGORITHMS):
        assert re.findall(r"─ (\w+) options ─", shown) == ["basic", "algorithm", "run"]


@pytest.mark.slow
def test_help_may_be_cut_off():
    """As by `| head`, whose pipe closes before all is written."""
    with started("train/ppo.py", "--help", cwd=ROOT) as process:
        assert process.stdout is not None and process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == "" and process.wait(timeout=300) == 0


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The Makefile with an environment that is set up, and does nothing."""
    if shutil.which("make") is None:
        pytest.skip("there is no make")
    for name in ("Makefile", "pyproject.toml", "constraints.txt"):
        shutil.copy(ROOT / name, tmp_path)
    python = tmp_path / ".venv" / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.write_text('#!/bin/sh\necho ran "$@"\n')
    python.chmod(0o755)
    for stamp in (".ready-compare", ".ready"):
        (tmp_path / ".venv" / stamp).touch()
    return tmp_path


OF_MAKE = ("MAKEFLAGS", "MFLAGS", "MAKELEVEL", "MAKEOVERRIDES", "PYTHON", "VENV", "ARGS")
"""What the make that runs these tests hands down; that of a user is none's child."""


def make(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    known = {name: value for name, value in os.environ.items() if name not in OF_MAKE}
    return subprocess.run(["make", *arguments], cwd=folder, env=known, capture_output=True, text=True, check=False)


def mistake(folder: Path, *arguments: str) -> str:
    result = make(folder, *arguments)
    assert result.returncode == 2 and result.stdout == ""
    (line,) = result.stderr.splitlines()
    return line


@pytest.mark.parametrize("python", ["python3.0", "/nowhere/python", "false"])
def test_a_python_that_is_not_there_is_not_replaced_by_another(python: str, folder: Path):
    line = mistake(folder, "test", f"PYTHON={python}")
    assert python in line and "PYTHON=" in line
    assert [path.name for path in folder.glob(".venv*")] == [".venv"]


def test_what_is_set_up_runs_without_the_python_that_set_it_up(folder: Path, monkeypatch: pytest.MonkeyPatch):
    tools = folder / "tools"
    tools.mkdir()
    for name in ("make", "sh"):
        (tools / name).symlink_to(shutil.which(name) or name)
    monkeypatch.setenv("PATH", str(tools))
    monkeypatch.delenv("PYTHON", raising=False)
    result = make(folder, "test")
    assert result.returncode == 0 and "ran -m pytest" in result.stdout


def test_help_lists_every_target_and_says_where_options_of_a_command_go(folder: Path):
    """For make reads options itself, before its file, and none of it can say so."""
    (phony,) = re.findall(r"^\.PHONY: (.*)$", (folder / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    shown = make(folder, "help").stdout
    assert len(phony.split()) <= 14, "beyond the budget of the house"
    assert re.findall(r"^  make ([a-z-]+) ", shown, re.MULTILINE) == phony.split() and "ARGS=" in shown
    assert make(folder, "--dry-run", *phony.split()).returncode == 0
    result = make(folder, "compare", "ARGS=--episodes 20")
    assert "ran eval/compare.py --episodes 20" in result.stdout.splitlines()
    for goal in ("trian", "20"):
        assert goal in (line := mistake(folder, goal)) and "make help" in line


def test_documents_name_targets_and_tests_that_there_are():
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    for page in {*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")} - {ROOT / "CHANGELOG.md"}:
        text = page.read_text(encoding="utf-8")
        assert all((ROOT / name).exists() for name in re.findall(r"tests/[a-z_/]+\.py", text)), page.name
        if "results" not in page.parts:  # which name the commands of their commits
            assert set(re.findall(r"(?:`|^)make ([a-z-]+)\b", text, re.MULTILINE)) <= targets, page.name


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no such index")
@pytest.mark.parametrize(("index", "asked"), [("data:,index", True), ("file:///nowhere", False), ("", False)])
def test_torch_comes_from_its_own_index_where_that_can_be_reached(index: str, asked: bool, folder: Path):
    python = folder / ".venv" / "bin" / "python"
    python.unlink()
    python.symlink_to(sys.executable)
    result = make(folder, "setup", "--dry-run", "--what-if=pyproject.toml", f"TORCH_INDEX={index}")
    assert result.returncode == 0 and (f"--extra-index-url {index} " in result.stdout) == asked
    assert ".[dev]" in result.stdout and result.stdout.count("--extra-index-url") == asked
