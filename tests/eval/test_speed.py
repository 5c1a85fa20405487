"""The measurement of speed: what it compares, and its page."""

from pathlib import Path

import numpy as np
import pytest
from commands import mistake, stopped

from eval import bench
from eval.speed import bench as study
from eval.studies import _frame


def test_a_first_try_shows_every_peer_that_is_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(study, "_TIME", 0.001)
    peer = study.STEPPERS["CartPole-v1, Gymnasium"][1]
    for name, package in (("EnvPool", "no_such_package"), ("gymnax", "gymnasium")):
        monkeypatch.setitem(study.STEPPERS, f"CartPole-v1, {name}", (package, peer))
    assert stopped(bench.main, ("--quick", "--out", "out"), tmp_path) == (0, "")
    data = _frame.read_data(tmp_path / "out")
    assert {"CartPole-v1, gymnax", "BeltArm-v0, ideal drives"} <= data["rates"].keys()
    assert "CartPole-v1, EnvPool" not in data["rates"]
    assert np.shape(data["rates"]["CartPole-v1, gymnax"]) == (len(data["sizes"]), 3)
    assert all(row["measured"] > 0 for row in data["rows"]) and len(data["rows"]) > 6
    assert (tmp_path / "out/sizes.png").read_bytes().startswith(b"\x89PNG")
    assert "--repetitions" in mistake(bench.main, ("--repetitions", "0"), tmp_path)
