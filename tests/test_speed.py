"""The measurement of speed: what it compares, and the page over the size of the batch."""

from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from eval.speed import peers, sizes
from eval.speed.timing import ratios, times_in_turns


def test_runs_take_turns_and_the_first_turn_does_not_count():
    turns: list[str] = []
    times = times_in_turns([lambda: turns.append("a"), lambda: turns.append("b")], 2)
    assert turns == ["a", "b"] * 3
    assert times.shape == (2, 2) and (times > 0).all()


def test_ratios_are_of_each_repetition():
    assert ratios(np.array([1.0, 2.0, 4.0]), np.array([2.0, 4.0, 8.0])) == ("2.00x", "2.00 to 2.00")
    assert ratios(np.array([2.0, 2.0, 2.0]), np.array([1.0, 2.0, 3.0])) == ("1.00x", "0.75 to 1.25")


def test_a_page_shows_every_peer_that_is_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(sizes, "SIZES", (1, 20))
    monkeypatch.setattr(sizes, "_TIME", 0.001)
    monkeypatch.setitem(peers.STEPPERS, "CartPole-v1, EnvPool", ("no_such_package", peers.envpool_carts))
    monkeypatch.setitem(peers.STEPPERS, "CartPole-v1, gymnax", ("gymnasium", peers.gymnasium_carts))
    sizes.save_sizes(tmp_path, 2, Console(quiet=True))
    page = (tmp_path / "sizes.md").read_text(encoding="utf-8")
    (head,) = [line for line in page.splitlines() if line.startswith("| arms")]
    assert "BeltArm-v0, ideal drives | BeltArm-v0, all effects of the drive | CartPole-v1, Gymnasium" in head
    assert "CartPole-v1, gymnax" in head and "EnvPool" not in head
    assert "\n| 1 | " in page and "\n| 20 | " in page
    assert (tmp_path / "sizes.png").read_bytes().startswith(b"\x89PNG")
