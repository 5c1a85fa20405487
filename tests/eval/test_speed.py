"""The measurement of speed: what it compares, and its page."""

from pathlib import Path

import numpy as np
import pytest
from commands import mistake, stopped

from agents.learners.ppo import PpoConfig
from eval import bench
from eval.speed import bench as study
from eval.speed.stepping import speed, times_in_turns, training_rows
from eval.studies import _frame


def test_runs_take_turns_and_the_first_turn_does_not_count():
    turns: list[str] = []
    times = times_in_turns([lambda: turns.append("a"), lambda: turns.append("b")], 2)
    assert turns == ["a", "b"] * 3
    assert times.shape == (2, 2) and (times > 0).all()


def test_ratios_are_of_each_repetition():
    row = speed("it", 10, np.array([2.0, 2.0, 2.0]), "peer", 10, np.array([1.0, 2.0, 3.0]))
    assert (row.measured, row.of_peer, row.ratios) == (5.0, 5.0, (0.75, 1.0, 1.25))


def test_a_first_try_shows_every_peer_that_is_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(study, "_TIME", 0.001)
    monkeypatch.setitem(study.STEPPERS, "CartPole-v1, EnvPool", ("no_such_package", study._envpool))
    monkeypatch.setitem(
        study.STEPPERS, "CartPole-v1, gymnax", ("gymnasium", study.STEPPERS["CartPole-v1, Gymnasium"][1])
    )
    assert stopped(bench.main, ("--quick", "--out", "out"), tmp_path) == (0, "")
    data = _frame.read_data(tmp_path / "out")
    assert {"CartPole-v1, gymnax", "BeltArm-v0, ideal drives"} <= data["rates"].keys()
    assert "CartPole-v1, EnvPool" not in data["rates"]
    assert np.shape(data["rates"]["CartPole-v1, gymnax"]) == (len(data["sizes"]), 3)
    assert all(row["measured"] > 0 for row in data["rows"]) and len(data["rows"]) > 6
    assert (tmp_path / "out/sizes.png").read_bytes().startswith(b"\x89PNG")


def test_the_loop_of_a_training_beside_single_arms():
    tiny = PpoConfig(arms=4, rollout_steps=8, batch_size=32, hidden=(4,))
    (row,) = training_rows(1, tiny)
    assert row.measured > 0 and row.of_peer and row.ratios


def test_the_committed_page_comes_from_the_committed_data():
    folder = _frame.RESULTS / "bench"
    assert (folder / "page.md").read_text(encoding="utf-8") == _frame.page("bench", study, _frame.read_data(folder))


def test_a_number_out_of_bounds_is_a_mistake(tmp_path: Path):
    assert "--repetitions" in mistake(bench.main, ("--repetitions", "0"), tmp_path)
