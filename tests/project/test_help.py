"""Options on the command line: what `--help` shows of every command, and what is read."""

import re
import runpy

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
