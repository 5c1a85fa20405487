"""Learning curves, of runs and of policies."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
from commands import mistake, stopped
from trainings import run, tiny

from agents.policy.bundle import BundleError
from eval import curves
from eval.report.curves import Curve, curves_figure, find_curves, levels


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


def made_up(method: str, base: str, scale: float, arms: int = 4) -> Curve:
    steps = np.arange(4.0)
    return Curve(method, base, 1000.0, arms, 1e6 * steps, steps, scale * np.exp(-steps))


def test_a_method_has_its_runs_and_their_median_over_the_levels():
    several = [*(made_up("a on paper", "paper", k) for k in (100, 200, 400)), made_up("b on zvd", "zvd", 300)]
    figure = curves_figure(several, {"paper": 1000.0, "zvd": 1000.0, "adaptive": 50.0})
    for axis in figure.axes:
        lines = [np.asarray(line.get_ydata()) for line in axis.lines]
        assert len([line for line in lines if len(line) == 4]) == 4
        (median,) = [line for line in lines if len(line) == 200]
        assert np.allclose(median[[0, -1]], [200, 200 * np.exp(-3)])
        assert sorted(float(line[0]) for line in lines if len(line) == 2) == [50.0, 1000.0, 1000.0]
    assert figure.axes[0].get_legend_handles_labels()[1] == ["a on paper (3 seeds)", "b on zvd"]
    plt.close(figure)
    with pytest.raises(ValueError, match="4, 8"):  # of different validations
        levels([made_up("a", "paper", 1.0), made_up("a", "paper", 1.0, arms=8)])
