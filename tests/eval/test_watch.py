"""`eval/watch.py`, run as a user runs it."""

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import mistake, stopped
from PIL import Image, ImageSequence

from eval import watch

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
def test_a_gif_of_two_arms(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    policy = next((ROOT / "agents/policies/ppo").glob("*/policy.safetensors")).parent
    chosen = ("--controller", "paper", "--policy", str(policy), "--speed", "2", "--scenario", "3")
    assert stopped(watch.main, (*chosen, "--out", "new/motion.gif"), tmp_path) == (0, "")
    assert [line.split(":")[0] for line in capsys.readouterr().out.splitlines()[:2]] == ["paper", "ppo"]
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["motion.gif"]
    with Image.open(tmp_path / "new" / "motion.gif") as picture:
        assert picture.width == 2 * 480
        frames = [np.array(frame.convert("RGB"), np.int32) for frame in ImageSequence.Iterator(picture)]
    assert len(frames) == 18  # 1.8 s at twice the speed, 20 per second
    moved = np.abs(frames[-1] - frames[0]).sum(axis=(0, 2))
    assert moved[:480].any() and moved[480:].any()


def test_an_mp4(tmp_path: Path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    chosen = ("--controller", "paper", "--speed", "4", "--out", "motion.mp4")
    assert stopped(watch.main, chosen, tmp_path) == (0, "")
    words = [ffmpeg.get_ffmpeg_exe(), "-i", "motion.mp4", "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    film = subprocess.run(words, cwd=tmp_path, capture_output=True, check=True)
    assert "480x588" in film.stderr.decode() and "30 fps" in film.stderr.decode()
    pictures = np.frombuffer(film.stdout, np.uint8).reshape(-1, 588, 480, 3).astype(np.int32)
    assert len(pictures) == 14 + 30  # 1.8 s at four times the speed, and a second's rest
    assert np.abs(pictures[13] - pictures[0]).max() > 50


def test_what_an_mp4_needs_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert "beltarm-env[video]" in mistake(watch.main, ("--controller", "paper", "--out", "m.mp4"), tmp_path)


@pytest.mark.slow
def test_a_window_is_shown_until_it_is_stopped(tmp_path: Path):
    environment = {**os.environ, "SDL_VIDEODRIVER": "dummy", "PYTHONUNBUFFERED": "1"}
    command = [sys.executable, str(ROOT / "eval/watch.py"), "--controller", "paper", "--speed", "10"]
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen(command, cwd=tmp_path, env=environment, **pipes)
    assert process.stdout is not None and process.stdout.readline().startswith("paper:")
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(timeout=2)  # goes on playing
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=300)
    assert process.returncode == 130 and "Traceback" not in errors


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("--controller", "papr"), "did you mean paper?"),
        (("--controller", "none.py:Mine"), "none.py"),
        (("--policy", "nowhere"), "nowhere"),
        (("--split", "frictoin"), "did you mean friction?"),
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
