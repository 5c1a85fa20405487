"""`eval/watch.py`, run as a user runs it."""

import os
import signal
import subprocess
from pathlib import Path

import numpy as np
import pytest
from commands import ROOT, mistake, started, stopped

from eval import watch

FRAMES = {"motion.gif": (20, 9 + 19), "motion.mp4": (30, 14 + 30)}
"""Per second, and in all: of 1.8 s at four times the speed, and of a second's rest."""


@pytest.mark.parametrize("name", [pytest.param("motion.gif", marks=pytest.mark.slow), "motion.mp4"])
def test_a_film_of_two_arms(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    chosen = ("--controller", "paper", "--policy", str(ROOT / "agents/policies/ppo/seed0"), "--speed", "4")
    assert stopped(watch.main, (*chosen, "--scenario", "3", "--out", f"new/{name}"), tmp_path) == (0, "")
    assert [line.split(":")[0] for line in capsys.readouterr().out.splitlines()[:2]] == ["paper", "ppo"]
    assert [path.name for path in (tmp_path / "new").iterdir()] == [name]
    words = [ffmpeg.get_ffmpeg_exe(), "-i", name, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    film = subprocess.run(words, cwd=tmp_path / "new", capture_output=True, check=True)
    assert "960x588" in film.stderr.decode() and f"{FRAMES[name][0]} fps" in film.stderr.decode()
    pictures = np.frombuffer(film.stdout, np.uint8).reshape(-1, 588, 960, 3).astype(np.int32)
    assert len(pictures) == FRAMES[name][1]
    moved = np.abs(pictures[8] - pictures[0]).max(axis=(0, 2))
    assert moved[:480].max() > 50 and moved[480:].max() > 50


def test_what_an_mp4_needs_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert "beltarm-env[video]" in mistake(watch.main, ("--controller", "paper", "--out", "m.mp4"), tmp_path)


@pytest.mark.slow
def test_a_window_is_shown_until_it_is_stopped(tmp_path: Path):
    environment = {**os.environ, "SDL_VIDEODRIVER": "dummy", "PYTHONUNBUFFERED": "1"}
    words = (ROOT / "eval/watch.py", "--controller", "paper", "--speed", "10")
    process = started(*words, cwd=tmp_path, env=environment)
    assert process.stdout is not None and process.stdout.readline().startswith("paper:")
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(timeout=2)  # goes on playing
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=300)
    assert process.returncode == 130 and "Traceback" not in errors


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("--controller", "papr"), "did you mean 'paper'?"),
        (("--controller", "none.py:Mine"), "none.py"),
        (("--policy", "nowhere"), "nowhere"),
        (("--split", "frictoin"), "did you mean 'friction'?"),
        (("--scenario", "500"), "--scenario"),
        (("--speed", "0"), "--speed"),
        (("--out", "motion.avi"), "--out"),
        (("--out", "/dev/null/motion.gif"), "/dev/null"),
        (("--controller", "paper") * 5, "got 5"),
        ((), "--out"),
        pytest.param(("--controller", "bad.py:Bad", "--out", "a.gif"), "(bad.py:4)", marks=pytest.mark.slow),
    ],
)
def test_mistakes_are_one_line(arguments: tuple[str, ...], named: str, tmp_path: Path):
    (tmp_path / "bad.py").write_text("import sys\nclass Bad:\n    def predict(self, *_, **__):\n        sys.exit(0)\n")
    assert named in mistake(watch.main, arguments, tmp_path)
