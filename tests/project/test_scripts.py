"""The scripts as a user runs them, their mistakes within this process."""

import contextlib
import csv
import io
import json
import re
import shlex
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from commands import ROOT, mistake, started, stopped
from trainings import SHORT
from waiting import until

from agents.learners import ppo
from agents.runs.checkpoint import COMMAND
from agents.runs.command_line import begun_options, main
from baselines.tools.command import this_python
from baselines.tools.options import note_options, parse
from eval import scenarios
from eval.comparison.splits import EDITION, VERSION

TINY = (*SHORT, "--validation-every", "128")


def train_ppo() -> None:
    main(ppo.PpoConfig, None)


def read_csv(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("trained")
    with contextlib.redirect_stdout(io.StringIO()) as said:
        assert stopped(train_ppo, ("--out", "run", "--total-steps", "256", *TINY), folder) == (0, "")
    (hint,) = [line for line in said.getvalue().splitlines() if "eval/compare.py --policy" in line]
    assert "--scenarios development" in hint, "the test set chooses nothing"
    return folder / "run"


def test_a_command_that_is_shown_calls_the_interpreter_that_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    own = tmp_path / "a folder" / ".venv" / "bin" / "python"
    own.parent.mkdir(parents=True)
    own.symlink_to(sys.executable)
    monkeypatch.setattr(sys, "executable", str(own))
    monkeypatch.setenv("PATH", str(Path(shutil.which("env") or "/usr/bin/env").parent))
    for folder, shown in ((own.parents[2], ".venv/bin/python"), (tmp_path, "a folder/.venv/bin/python")):
        monkeypatch.chdir(folder)
        assert shlex.split(this_python()) == [shown]
    monkeypatch.chdir("/")
    assert subprocess.run(f"{this_python()} --version", shell=True, check=False).returncode == 0
    monkeypatch.setenv("PATH", str(own.parent))
    assert this_python() == "python"


def test_training_leaves_a_policy_a_checkpoint_and_logs(trained: Path) -> None:
    files = {path.name for path in trained.iterdir()}
    assert {"best", "last", "checkpoint.pkl", "config.json", "validation.csv"} <= files
    first = read_csv(trained / "progress.csv")[0]
    assert first["time/total_timesteps"] == "0" and float(first["validation/cost"]) > 0
    assert any(name.startswith("events.out.tfevents") for name in files)
    assert [row["steps"] for row in read_csv(trained / "validation.csv")] == ["0", "128", "256"]
    assert [path.name for path in trained.rglob(".*")] == [".lock"]  # no temporary files


def test_a_resumed_run_keeps_the_options_that_it_is_not_told(trained: Path, tmp_path: Path) -> None:
    """All of them: those that may be told anew, and those that would make it another run."""
    copy, again = tmp_path / "run", ("--out", "run", "--resume")
    shutil.copytree(trained, copy)
    before, curve = json.loads((copy / "config.json").read_text()), read_csv(copy / "validation.csv")
    assert stopped(train_ppo, again, tmp_path) == (0, "")
    assert read_csv(copy / "validation.csv") == curve
    after = json.loads((copy / "config.json").read_text())
    own = {"out": after["config"]["out"], "resume": after["config"]["resume"]}
    assert after["config"] == {**before["config"], **own} and after["identity"] == before["identity"]
    for words in (("--total-steps", "448"), ()):
        assert stopped(train_ppo, (*again, *words), tmp_path) == (0, "")
    assert read_csv(copy / "validation.csv")[-1]["steps"] == "448"
    assert "--arms 8, not 16" in mistake(train_ppo, (*again, "--arms", "16"), tmp_path)
    assert "448 agent steps already" in mistake(train_ppo, (*again, "--total-steps", "256"), tmp_path)
    assert stopped(train_ppo, again, tmp_path) == (0, ""), "what was refused is not noted"
    content = json.loads((copy / COMMAND).read_text())
    content["config"]["total_steps"] = "many"
    for text, named in ((json.dumps(content), "--total-steps=many"), ("{}", "command.json is damaged")):
        (copy / COMMAND).write_text(text)
        assert named in mistake(train_ppo, again, tmp_path)


@pytest.mark.parametrize("others", [{}, {"base": "paper"}, {"base": "paper", "teacher_rounds": 0, "moves": 1}])
def test_several_seeds_are_resumed_with_the_options_of_their_command(others: Any, tmp_path: Path) -> None:
    config = ppo.PpoConfig(out=tmp_path / "many", seeds=3, seed=4, total_steps=700_000, hidden=(8,), jobs=2, **others)
    note_options(config.out / COMMAND, config)
    told = ("--out", str(config.out), "--resume")
    assert parse(ppo.PpoConfig, arguments=told, begun=begun_options) == replace(config, resume=True)
    told = (*told, "--total-steps", "800000", "--hidden", "16", "16")
    expected = replace(config, resume=True, total_steps=800_000, hidden=(16, 16))
    assert parse(ppo.PpoConfig, arguments=told, begun=begun_options) == expected


@pytest.mark.parametrize("interrupt", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_interrupted_training_saves_and_says_how_to_go_on(interrupt: signal.Signals, tmp_path: Path) -> None:
    process = started(ROOT / "train/ppo.py", "--out", "run", *TINY, cwd=tmp_path)
    until((tmp_path / "run" / "validation.csv").exists, 300)
    process.send_signal(interrupt)
    output, errors = process.communicate(timeout=300)
    assert process.returncode == 130, errors
    assert all(words in output for words in ("--resume", "interrupted at", "saved in run"))
    assert (tmp_path / "run" / "checkpoint.pkl").exists()


def test_bad_training_options(trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for arguments, named in (
        (("--arms", "0"), "--arms must lie within 1 and 40000, got 0"),
        (("--seed", "-1"), "--seed"),
        (("--residual-limit", "3"), "got 3.0"),
        (("--out", "/dev/null/run"), "/dev/null/run"),
        (("--out", "nowhere", "--resume"), "nowhere"),
        (("--out", str(trained), *TINY), "already holds a run"),
        (("--out", str(trained / "best"), *TINY), "is the folder of a policy"),
    ):
        assert named in mistake(train_ppo, arguments, tmp_path)
        assert capsys.readouterr().out == "", "no progress is shown before"
    assert list(tmp_path.iterdir()) == []


def test_scenarios_are_checked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert stopped(scenarios.main, (), tmp_path) == (0, "")
    assert capsys.readouterr().out.startswith(f"development set, edition {EDITION}, version {VERSION}: sha256 ")


def readme_examples() -> list[str]:
    """As they are, but for the size of a training: one update on fewer arms tells as much."""
    text = re.sub(r"learn\(\d+_000\)", "learn(1)", (ROOT / "README.md").read_text(encoding="utf-8"))
    return [block.split("```")[0].replace("(512,", "(128,") for block in text.split("```python\n")[1:]]


@pytest.mark.filterwarnings("default", "error::UserWarning:beltarm_env")
@pytest.mark.parametrize("number", range(len(readme_examples())))
def test_examples_of_the_readme_run(number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    exec(readme_examples()[number], {"__name__": "__main__"})
