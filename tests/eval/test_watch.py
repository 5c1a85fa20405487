"""`eval/watch.py`, run as a user runs it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from commands import mistake, stopped
from PIL import Image, ImageSequence

from eval import watch
from eval.report.film import require_writer

ROOT = Path(__file__).resolve().parents[2]
COMMAND = [sys.executable, str(ROOT / "eval/watch.py")]


def run(*arguments: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    clean = {key: value for key, value in os.environ.items() if "DISPLAY" not in key and key != "SDL_VIDEODRIVER"}
    return subprocess.run(
        [*COMMAND, *arguments],
        cwd=cwd,
        env=clean | environment,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


@pytest.mark.slow
def test_a_gif_of_two_arms(tmp_path: Path):
    policy = next((ROOT / "agents/policies/ppo").glob("*/policy.json")).parent
    chosen = ("--controller", "paper", "--policy", str(policy), "--speed", "2", "--scenario", "3")
    result = run(*chosen, "--out", "new/motion.gif", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "paper: tip error at most" in result.stdout
    assert "ppo: tip error at most" in result.stdout
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["motion.gif"]
    with Image.open(tmp_path / "new" / "motion.gif") as picture:
        assert picture.width == 2 * 480
        frames = [np.array(frame.convert("RGB"), np.int32) for frame in ImageSequence.Iterator(picture)]
    assert len(frames) == 18  # 1.8 s at twice the speed, 20 per second
    moved = np.abs(frames[-1] - frames[0]).sum(axis=(0, 2))
    assert moved[:480].any()
    assert moved[480:].any()


def test_an_mp4(tmp_path: Path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    chosen = ("--controller", "paper", "--speed", "2", "--out", "motion.mp4")
    assert stopped(watch.main, chosen, tmp_path) == (0, "")
    words = [ffmpeg.get_ffmpeg_exe(), "-i", "motion.mp4", "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    film = subprocess.run(words, cwd=tmp_path, capture_output=True, check=True)
    about = film.stderr.decode()
    assert "480x588" in about
    assert "30 fps" in about
    pictures = np.frombuffer(film.stdout, np.uint8).reshape(-1, 588, 480, 3).astype(np.int32)
    assert len(pictures) == 27 + 30  # 1.8 s at twice the speed, and a second's rest
    assert np.abs(pictures[26] - pictures[0]).max() > 50


def test_what_an_mp4_needs_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"m\.mp4 needs imageio-ffmpeg: pip install 'beltarm-env\[video\]'; a .gif"):
        require_writer(tmp_path / "m.mp4")


@pytest.mark.slow
def test_a_window_is_shown_until_it_is_stopped(tmp_path: Path):
    environment = {**os.environ, "SDL_VIDEODRIVER": "dummy", "PYTHONUNBUFFERED": "1"}
    command = [*COMMAND, "--controller", "paper", "--controller", "zvd", "--speed", "10"]
    process = subprocess.Popen(
        command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert [process.stdout.readline().split(":")[0] for _ in range(2)] == ["paper", "zvd"]
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(timeout=2)  # goes on playing
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=300)
    assert process.returncode == 130
    assert "Traceback" not in errors


def test_a_controller_that_exits_is_a_mistake(tmp_path: Path):
    (tmp_path / "bad.py").write_text("import sys\nclass Bad:\n    def predict(self, *_, **__):\n        sys.exit(0)\n")
    line = mistake(watch.main, ("--controller", "bad.py:Bad", "--out", "a.gif"), tmp_path)
    assert "Bad failed on scenario 0 of randomized: SystemExit: 0 (bad.py:4)" in line


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--controller", "papr"), "unknown controller 'papr'; did you mean paper?"),
        (("--controller", "none.py:Mine"), "there is no file"),
        (("--policy", "nowhere"), "no policy bundle at nowhere"),
        (("--split", "frictoin"), "unknown split 'frictoin'; did you mean friction?"),
        (("--scenario", "500"), "--scenario must lie within 0 and 499, got 500"),
        (("--speed", "0"), "--speed must lie within 0.01 and 10, got 0"),
        (("--out", "motion.avi"), "--out must end in .gif or .mp4, got motion.avi"),
        (("--out", "/dev/null/motion.gif"), "cannot write to /dev/null"),
        (("--controller", "paper") * 5, "at most 4 arms fit side by side, got 5"),
        ((), "--out motion.gif"),
    ],
)
def test_mistakes_are_one_line(arguments: tuple[str, ...], message: str, tmp_path: Path):
    line = mistake(watch.main, arguments, tmp_path)
    assert line.startswith("eval/watch.py: ") and message in line
