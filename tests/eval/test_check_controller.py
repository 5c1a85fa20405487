"""The protocol that a controller of a user's own has to keep."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import ROOT, mistake, stopped

from baselines import CONTROLLERS
from eval.check_controller import main
from eval.comparison import check, custom
from eval.comparison.check import Finding, findings, record
from eval.comparison.methods import added_method

EXAMPLE = ROOT / "docs" / "examples" / "my_controller.py"


class Proportional:
    """A sound controller, which those below spoil."""

    def __init__(self) -> None:
        self.calls = 0

    def predict(self, observation: Any, state: Any = None, episode_start: Any = None, deterministic=True) -> Any:
        self.calls += 1
        begins = np.ones(len(observation), np.bool_) if state is None else episode_start
        before = np.zeros(len(observation)) if state is None else np.where(begins, 0.0, state)
        error = 0.5 * before + 0.5 * observation[:, 0]
        return self.changed((0.3 * error)[:, None].astype(np.float32), observation), error

    def changed(self, action: Any, observation: Any) -> Any:
        return action


class Leaks(Proportional):
    """Forgets to begin episodes afresh."""

    def predict(self, observation: Any, state: Any = None, *_: Any, **__: Any) -> Any:
        return super().predict(observation, state, np.zeros(len(observation), np.bool_))


class RemembersItself(Proportional):
    """Keeps its memory in itself, and empties it as a batch begins."""

    def predict(self, observation: Any, state: Any = None, episode_start: Any = None, deterministic=True) -> Any:
        if episode_start is not None and episode_start.any():
            self.kept = getattr(self, "kept", None) if not episode_start.all() else None
        action, self.kept = super().predict(observation, getattr(self, "kept", None), episode_start)
        return action, None


class AsksForStarts(Proportional):
    def predict(self, observation: Any, state: Any = None, episode_start: Any = None, deterministic=True) -> Any:
        return super().predict(observation, state, episode_start.copy())


class WithoutState(Proportional):
    def predict(self, *arguments: Any, **_: Any) -> Any:
        return super().predict(*arguments)[0]


class AlwaysRandom(Proportional):
    def predict(self, observation: Any, state: Any = None, episode_start: Any = None) -> Any:  # pyright: ignore
        return super().predict(observation, state, episode_start)


class Runaway(Proportional):
    """Sound, with memory, and drives its arms out of the workspace."""

    def changed(self, action: Any, observation: Any) -> Any:
        return (0.9 + 0.1 * np.tanh(action)).astype(np.float32)


class LeakyRunaway(Runaway, Leaks):
    """Takes the memory of an arm that left its workspace into that arm's next episode."""


def spoilt(change: Callable[[Any, Any, Any], Any]) -> type[Proportional]:
    """Controller whose actions are changed: by a function of controller, action and observation."""
    return type("Spoilt", (Proportional,), {"changed": change})


RANDOM = np.random.default_rng()
CASES: dict[str, tuple[type, str, str]] = {
    "state": (WithoutState, "drives", r"must return \(torques, state\).*got ndarray"),
    "arguments": (AlwaysRandom, "drives", r"must take \(observation, state, episode_start, deterministic\): .*deter"),
    "shape": (spoilt(lambda _, a, o: a[:, 0]), "drives", r"shape \(5, 1\), got float32 of shape \(5,\)"),
    "type": (spoilt(lambda _, a, o: a.astype(np.float64)), "drives", "got float64 of shape"),
    "nan": (spoilt(lambda c, a, o: a * np.float32(np.nan if c.calls == 50 else 1)), "drives", "in sample 49 .*nan"),
    "raises": (spoilt(lambda *_: {}["no gain"]), "drives", "KeyError: 'no gain'"),
    "input": (spoilt(lambda _, a, o: (a, o.fill(0))[0]), "drives", "changes the observation .* in sample 0"),
    "random": (spoilt(lambda _, a, o: a + np.float32(RANDOM.normal(0, 1e-3))), "same observations", "from sample 0 on"),
    "starts": (AsksForStarts, "same observations", "'NoneType' object has no attribute 'copy'"),
    "late": (spoilt(lambda c, a, o: a + np.float32((c.calls > 1100) * RANDOM.random())), "same obs", "sample 1100 on"),
    "mixes": (spoilt(lambda _, a, o: a + np.float32(0.01) * a.mean()), "as if alone", "torques differ from sample"),
    "leaks": (Leaks, "without memory of the last", "torques differ from sample 0 on"),
    "leaves": (LeakyRunaway, "without memory of the last", "torques differ from sample"),
    "remembers": (RemembersItself, "memory is in the state", "torques differ from sample"),
}


def failed(kind: Callable[[], Any]) -> list[Finding]:
    return [finding for finding in findings(kind) if not finding.passed]


@pytest.mark.parametrize(("kind", "check", "message"), CASES.values(), ids=CASES)
def test_each_check_notices_what_it_is_for(kind: type, check: str, message: str):
    first = failed(kind)[0]
    assert check in first.check and re.search(message, first.detail), first.detail


def test_a_late_controller_is_called_late(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(check, "action_times", lambda *_, **__: (900.0, 1501.0))
    assert [finding.late for finding in findings(Proportional)] == [False] * 5 + [True]


def test_a_sound_controller_passes_and_may_leave_the_workspace():
    assert [finding.detail for finding in findings(Proportional)][1:5] == ["bit for bit"] * 4
    assert record(Runaway()).starts[1:].any() and not failed(Runaway)


@pytest.mark.parametrize("name", CONTROLLERS)
def test_classical_controllers_keep_the_protocol(name: str):
    assert not failed(CONTROLLERS[name])


def test_the_example_passes_as_a_user_runs_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert stopped(main, (f"{EXAMPLE}:MyController",), tmp_path) == (0, "")
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 6 and all(line.startswith("ok") for line in lines)


def test_a_failure_names_its_place_and_shows_its_traceback(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "bad.py").write_text("class Bad:\n    def predict(self, *_, **__):\n        raise KeyError('gain')\n")
    (tmp_path / "worse.py").write_text("import json\nraise RuntimeError('not today')\n")
    (tmp_path / "ends.py").write_text("import os\nclass Bad:\n    def predict(self, *_, **__):\n        os._exit(0)\n")
    for spec, status, line in (("bad:Bad", 1, 'bad.py", line 3'), ("worse.py:Bad", 2, 'worse.py", line 2')):
        code, errors = stopped(main, (spec, "--traceback"), tmp_path)
        assert code == status and errors.startswith("Traceback (most recent call last):") and line in errors
    assert "KeyError: 'gain' (bad.py:3)\n" in capsys.readouterr().out
    assert stopped(main, ("ends.py:Bad",), tmp_path) == (1, "")
    assert capsys.readouterr().out.startswith("FAILED  runs to")


def test_controllers_that_cannot_be_loaded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(check, "run_isolated", lambda call, *_: call())  # a process for each takes seconds
    (tmp_path / "broken.py").write_text("class\n")
    (tmp_path / "empty.py").write_text("class Other: pass\nclass Needs:\n    def __init__(self, gain): pass\n")
    for spec, named in (
        ("nothing", "'nothing'"),
        (f"{ROOT / 'README.md'}:X", "README.md"),
        ("nowhere.py:Class", "nowhere.py"),
        ("no.such.module:Class", "'no'"),
        ("broken.py:Class", "SyntaxError"),
        ("empty.py:Class", "'Class'; its classes: Needs, Other"),
        ("empty.py:Other", "predict"),
        ("empty.py:Needs", "TypeError"),
    ):
        assert named in mistake(main, (spec,), tmp_path)


def test_identity_changes_with_every_file_of_the_users_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Also with a renamed file, and with one below a linked folder. That of a large or unreadable one is unknown."""
    own, linked = tmp_path / "own", tmp_path / "elsewhere"
    for folder in (own / "parts", own / "before" / "parts", linked):
        folder.mkdir(parents=True)
    for name in ("mine.py", "parts/gains.py", "weights.safetensors", "before/results.json"):
        (own / name).write_text(name)
    identities = [custom.identity(own, own / "out")]

    def changed(change: Callable[[], object]) -> bool:
        change()
        identities.append(custom.identity(own, own / "out"))
        return identities[-1] not in identities[:-1]

    for name in ("weights.safetensors", "parts/gains.py", "parts/table.csv", ".gains.json"):
        assert changed(lambda name=name: (own / name).write_text("other"))
    assert changed(lambda: (own / "parts" / "gains.py").rename(own / "gains.py"))
    (own / "linked").symlink_to(linked)
    assert changed(lambda: (linked / "more.csv").write_text("2"))
    for name in (".git/a", ".venv3/a", ".a_cache/b", "__pycache__/a.pyc", "before/page.md", "out/page.md", "out/a/b"):
        (own / name).parent.mkdir(parents=True, exist_ok=True)
        assert not changed(lambda name=name: (own / name).write_text("new"))
    own_is_out = [custom.identity(own, own)]
    for name in ("results.json", "answer.png", "parts/kept.safetensors", "parts/table.csv"):
        (own / name).write_text("new")
        own_is_out.append(custom.identity(own, own))
    assert len({*own_is_out[:4]}) == 1 and own_is_out[4] != own_is_out[3]
    for name in ("mine.py", "other.py"):
        (own / name).write_text("class Mine: pass")
    assert len({added_method(f"{own / name}:Mine").identity for name in ("mine.py", "other.py")}) == 2
    assert None not in identities and custom.identity(own) not in identities and custom.identity(own / "no") is None
    for limit, low in (("MOST_FILES", 3), ("MOST_BYTES", 20)):
        with monkeypatch.context() as patched:
            patched.setattr(custom, limit, low)
            assert custom.identity(own) is None
