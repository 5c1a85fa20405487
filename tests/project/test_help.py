"""Options on the command line: what `--help` shows of every command, and what is read."""

from __future__ import annotations

import re
import runpy
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import pytest
import tyro
from commands import stopped

from baselines.tools.options import Groups, parse
from eval.studies._frame import names

ROOT = Path(__file__).resolve().parents[2]
COMMANDS = [
    path.relative_to(ROOT).as_posix()
    for package in ("baselines", "eval", "train")
    for path in sorted((ROOT / package).glob("*.py"))
    if '__name__ == "__main__"' in path.read_text(encoding="utf-8") and path.stem not in ("study", "export")
]
COMMANDS += [f"eval/study.py {name}" for name in names()]
TRAININGS = [f"train/{name}.py" for name in ("ppo", "recurrent_ppo", "rma", "sac", "student")]


def help_of(command: str, capsys: pytest.CaptureFixture[str]) -> str:
    """What `--help` prints, within this process."""
    script, *words = command.split()
    assert stopped(lambda: runpy.run_path(script, run_name="__main__"), (*words, "--help"), ROOT) == (0, "")
    return capsys.readouterr().out


@pytest.mark.parametrize("command", COMMANDS)
def test_help_is_plain_and_narrow(command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    shown = ""
    for columns in ("200", "60") if command == COMMANDS[0] else ("60",):
        monkeypatch.setenv("COLUMNS", columns)
        shown = help_of(command, capsys)
        longest = max(shown.splitlines(), key=len)
        assert len(longest) <= min(80, int(columns)), longest
    usage, purpose, *_ = shown.split("\n\n")
    assert usage.startswith(f"usage: {command.split()[0]}") and len(purpose.split()) > 3
    for clutter in ("None", "(default: )", "''", "True", "False", "]]", str(ROOT)):
        assert clutter not in shown, clutter


def test_trainings_sort_their_options(capsys: pytest.CaptureFixture[str]):
    for command in TRAININGS:
        boxes = re.split(r"─ (\w+) options ─", help_of(command, capsys))
        groups = {
            name: {*re.findall(r"│ (--[a-z-]+)", box)} for name, box in zip(boxes[1::2], boxes[2::2], strict=True)
        }
        assert list(groups) == ["basic", "algorithm", "run"]
        assert {"--out", "--base", "--seed", "--seeds", "--resume", "--overwrite"} <= groups["basic"]
        assert {"--knowledge", "--learning-rate", "--hold", "--arms"} <= groups["algorithm"]
        assert {"--jobs", "--validation-arms", "--device"} <= groups["run"]


@pytest.mark.slow
def test_help_may_be_cut_off():
    """As by `| head`, whose pipe closes before all is written."""
    process = subprocess.Popen(
        [sys.executable, "train/ppo.py", "--help"], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None and process.stderr is not None
    process.stdout.close()
    assert process.stderr.read() == "" and process.wait(timeout=300) == 0
    process.stderr.close()


@dataclass(frozen=True)
class Start:
    """Options that others share."""

    place: Path
    """Where
    it is."""
    count: int | None = None
    """How many."""


@dataclass(frozen=True)
class Options(Start):
    """Options of all kinds."""

    groups: ClassVar[Groups] = {"basic": ("names", "count", "place"), "other": (), "gone": ("absent",)}

    names: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[NAME ...]")] = ()
    """Who."""
    sizes: tuple[float, ...] = (1.0, 2.0)
    """How large."""
    added: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """What else."""
    kind: Literal["one", "two"] | None = None
    """Which."""
    quick: bool = False
    """Soon."""
    margins: bool = True
    """Without them."""


def test_options_are_read_into_the_flat_dataclass():
    assert parse(Options, arguments=["--place", "here"]) == Options(Path("here"))
    words = "anna bert --place here --count 3 --sizes 0.5 4 --added x --added y --kind two --quick --no-margins"
    expected = Options(Path("here"), 3, ("anna", "bert"), (0.5, 4.0), ("x", "y"), "two", True, False)
    assert parse(Options, arguments=words.split()) == expected


def test_help_shows_options_in_their_groups_with_plain_defaults(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit) as end:
        parse(Options, "Do this: now.\n\nWith care,\nand with", ["--help"])
    assert end.value.code == 0
    shown = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert "] Do this: now. With care, and with ╭─" in shown
    assert "─ gone" not in shown
    positional, _, rest = shown.partition("─ basic options ")
    basic, _, other = rest.partition("─ other options ")
    assert "[NAME ...] Who." in positional
    assert re.search(r"--count INT How many\. --place PATH Where it is\. \(required\)", basic), basic
    assert "--sizes FLOAT ... How large. (default: 1.0 2.0)" in other
    assert "--added STR What else. --kind {one,two} Which. --quick Soon. --no-margins Without them. ╰" in other


def test_unknown_options_are_refused(capsys: pytest.CaptureFixture[str]):
    for words in (["--place", "here", "--cuont", "3"], [], ["--place", "here", "--count", "None"]):
        with pytest.raises(SystemExit) as end:
            parse(Options, arguments=words)
        assert end.value.code == 2
        shown = capsys.readouterr()
        assert shown.out == "" and shown.err
