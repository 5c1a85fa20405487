"""Commands of a page each: learning curves of runs and policies, and speed beside that of peers."""

from pathlib import Path

import numpy as np
import pytest
from commands import mistake, stopped
from trainings import run, tiny

from agents.policy.bundle import BundleError
from eval import bench, curves
from eval.report.curves import find_curves
from eval.speed import bench as study
from eval.studies import _frame


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "ppo"
    for seed in range(2):
        run(tiny("ppo", folder / f"seed{seed}", seed=seed, total_steps=64, validation_every=64))
    return folder


def test_curves_of_runs_and_of_bundles_are_the_same(runs: Path, tmp_path: Path):
    of_all = find_curves([runs])
    assert [curve.method for curve in of_all] == ["ppo on paper"] * 2
    for curve, seed in zip(of_all, range(2), strict=True):
        assert curve.steps.tolist() == [0, 64 * 40]
        assert curve.arms == 4 and (np.diff(curve.minutes) >= 0).all()
        for folder in (f"seed{seed}", f"seed{seed}/best", f"seed{seed}/last"):
            (alone,) = find_curves([runs / folder])
            assert np.allclose(alone.cost, curve.cost) and alone.base_cost == curve.base_cost
    assert of_all[0].cost[0] != of_all[1].cost[0]
    with pytest.raises(BundleError, match="no run and no policy"):
        find_curves([runs, tmp_path])


def test_the_command_draws(runs: Path, tmp_path: Path):
    assert stopped(curves.main, ("--runs", str(runs), "--out", "out"), tmp_path) == (0, "")
    assert (tmp_path / "out/curves.png").read_bytes().startswith(b"\x89PNG")
    assert "nowhere" in mistake(curves.main, ("--runs", "nowhere", "--out", "out"), tmp_path)


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
