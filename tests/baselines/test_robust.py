"""Robust LQ: its loops against those of the law, its cost and slope against SciPy, its gain against LQG's."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov
from scipy.optimize import OptimizeResult

from baselines import CONTROLLERS
from baselines import design as design_command
from baselines.estimation.observer import Noise
from baselines.loops.models import closed_poles, loop_at
from baselines.models.corners import CORNERS, LOOP_FIELDS
from baselines.optimal import kept, robust
from baselines.optimal.lqg import LqgController, feedback_gains
from baselines.optimal.robust import (
    RobustController,
    RobustGains,
    arms_around,
    closed,
    least_cost_gain,
    loops_at,
    lyapunov,
    mean_cost,
    robust_gains,
)
from baselines.planning.plan import Weights
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.task.ranges import design_model

DESIGN, WEIGHTS, NOISE = design_model(), Weights(1.0, 10.0, 20.0), Noise(5e-3, 0.3, 1e-3)
WRONG = Noise(0.014, 1.7, 0.01)
"""Noise of a filter with which LQG does not hold all arms."""


class TestArms:
    def test_those_around_the_design_model_are_the_corners(self):
        arms = arms_around(DESIGN)
        for name, corner in CORNERS.items():
            near = [
                all(np.isclose(getattr(arm, field), getattr(corner, field), rtol=1e-9) for field in LOOP_FIELDS)
                for arm in arms
            ]
            assert any(near), name

    def test_late_ones_come_with_a_sample_more_too(self):
        latencies = sorted({round(arm.command_latency / CONTROL_PERIOD, 6) for arm in arms_around(DESIGN)})
        assert latencies == [0.0, 0.75, 1.5, 2.5]

    def test_those_around_another_arm_are_arms(self):
        for arm in arms_around(ArmParams()):
            assert arm.gear_ratio == 88.0 and arm.command_latency >= 0


class TestLoops:
    @pytest.mark.parametrize("k", [0, 20, 45])
    def test_they_have_the_poles_of_the_law_on_each_arm(self, k: int):
        controller = RobustController()
        g = controller.gains
        loops = loops_at(DESIGN, k, g.weights(), g.noise(), 0.1)
        matrices = closed(controller.feedback[k], loops)
        for arm, matrix in zip(arms_around(DESIGN), matrices, strict=True):
            expected = closed_poles(loop_at(controller, k, arm))
            found = np.linalg.eigvals(matrix)
            for pole in expected[np.abs(expected) > 0.05]:
                assert np.abs(found - pole).min() < 1e-6

    def test_lyapunovs_equation_is_solved_as_scipy_does(self):
        loops = loops_at(DESIGN, 20, WEIGHTS, NOISE, 0.1)
        a = closed(feedback_gains(DESIGN, WEIGHTS)[20], loops)
        found = lyapunov(a, loops.noise)
        assert found is not None
        for one, matrix, noise in zip(found, a, loops.noise, strict=True):
            expected = solve_discrete_lyapunov(matrix, noise)
            scale = np.sqrt(np.outer(expected.diagonal(), expected.diagonal())) + 1e-30
            assert (np.abs(one - expected) / scale).max() < 1e-6

    def test_there_is_no_solution_for_an_unstable_loop(self):
        assert lyapunov(np.array([[[1.001, 0.0], [0.0, 0.5]]]), np.eye(2)[None]) is None
        assert mean_cost(-feedback_gains(DESIGN, WEIGHTS)[20], loops_at(DESIGN, 20, WEIGHTS, NOISE, 0.1))[0] == np.inf

    @pytest.mark.parametrize("shrunk", [1.0, 0.99])
    def test_slope_is_that_of_the_cost(self, shrunk: float):
        loops, gain = loops_at(DESIGN, 12, WEIGHTS, NOISE, 0.1), feedback_gains(DESIGN, WEIGHTS)[12]
        _, slope = mean_cost(gain, loops, shrunk)
        for i, step in enumerate(1e-5 * np.diag(np.abs(gain))):
            after, before = (mean_cost(gain + sign * step, loops, shrunk)[0] for sign in (1, -1))
            assert (after - before) / (2 * step[i]) == pytest.approx(slope[i], rel=1e-3)


class TestGain:
    @pytest.mark.parametrize("k", [0, 20, 45])
    def test_costs_less_over_the_corners_than_lqgs_and_no_step_aside_costs_less(self, k: int):
        loops, start = loops_at(DESIGN, k, WEIGHTS, NOISE, 0.1), feedback_gains(DESIGN, WEIGHTS)[k]
        gain = least_cost_gain(start, loops)
        cost = mean_cost(gain, loops)[0]
        assert cost < 0.99 * mean_cost(start, loops)[0]
        for step in 0.1 * np.diag(start):
            assert all(mean_cost(gain + sign * step, loops)[0] > 0.999 * cost for sign in (1, -1))

    def test_does_not_depend_on_where_the_descent_begins_nor_then_on_how_a_processor_rounds(self):
        loops, start = loops_at(DESIGN, 45, WEIGHTS, NOISE, 0.1), feedback_gains(DESIGN, WEIGHTS)[45]
        gain, other = least_cost_gain(start, loops), least_cost_gain(1.01 * start, loops)
        assert other == pytest.approx(gain, rel=1e-7)

    def test_a_slope_of_zero_where_loops_are_unstable_ends_no_descent(self, monkeypatch: pytest.MonkeyPatch):
        loops, start = loops_at(DESIGN, 45, WEIGHTS, NOISE, 0.1), feedback_gains(DESIGN, WEIGHTS)[45]
        monkeypatch.setattr(robust, "root", lambda *_, **__: OptimizeResult(x=np.full(5, 1e6), success=True))
        assert np.isfinite(mean_cost(least_cost_gain(start, loops), loops)[0])

    def test_is_found_from_one_that_does_not_hold_all_arms(self):
        loops, start = loops_at(DESIGN, 45, WEIGHTS, WRONG, 0.1), feedback_gains(DESIGN, WEIGHTS)[45]
        assert mean_cost(start, loops)[0] == np.inf
        assert np.isfinite(mean_cost(least_cost_gain(start, loops), loops)[0])

    def test_holds_every_corner_at_every_angle_where_lqg_with_the_same_weights_does_not(self):
        weights = {"velocity_weight": 1.0, "torque_weight": 10.0, "change_weight": 20.0}
        noise = {f"{name.name}_noise": getattr(WRONG, name.name) for name in fields(WRONG)}
        worst = {}
        for kind in (RobustController, LqgController):
            controller = kind(RobustGains(**weights, **noise))
            loops = [loop_at(controller, k, arm) for k in (0, 23, 45) for arm in CORNERS.values()]
            worst[kind] = max(float(np.abs(closed_poles(loop)).max()) for loop in loops)
        assert worst[RobustController] < 1 < worst[LqgController]


class TestKept:
    def test_they_are_what_the_design_finds(self, tmp_path: Path):
        design, anew = CONTROLLERS["robust"]().design, tmp_path / "robust.json"
        design_command.run(design_command.Config(anew))
        found, expected = (kept.kept_gains(design.content(), path) for path in (anew, kept.FILE))
        assert expected is not None, "robust.json is of another design: run `python baselines/design.py`"
        assert found == pytest.approx(expected, rel=1e-6), "run `python baselines/design.py`"

    def test_they_are_of_one_design_alone(self):
        design = CONTROLLERS["robust"]().design
        others = [
            design._replace(params=replace(design.params, payload_mass=0.11)),
            design._replace(weights=design.weights._replace(change=201.0)),
            design._replace(noise=replace(design.noise, torque=0.011)),
            design._replace(stopped=0.2),
        ]
        assert all(kept.kept_gains(other.content()) is None for other in others)

    def test_what_is_not_kept_is_designed(self, monkeypatch: pytest.MonkeyPatch):
        monkeypatch.setattr(robust.Design, "gains", lambda design: np.full((10, 5), design.stopped))
        assert np.all(robust_gains(CONTROLLERS["robust"]().design._replace(stopped=0.123)) == 0.123)

    def test_what_is_written_is_read_bit_for_bit(self, tmp_path: Path):
        gains = np.random.default_rng(0).normal(size=(3, 5)) / 3
        kept.keep({"stopped": 0.1}, gains, tmp_path / "robust.json")
        found = kept.kept_gains({"stopped": 0.1}, tmp_path / "robust.json")
        assert found is not None and np.array_equal(found, gains)

    @pytest.mark.parametrize(
        "content", ["", "[]", "{}", '{"design": {}, "gains": [[1, 2]]}', '{"design": {}, "gains": [[1, 2, 3, 4, NaN]]}']
    )
    def test_a_damaged_file_is_named_with_a_remedy(self, content: str, tmp_path: Path):
        (tmp_path / "robust.json").write_text(content)
        with pytest.raises(ValueError, match=r"robust\.json is damaged .*: restore it, or remove it"):
            kept.kept_gains({}, tmp_path / "robust.json")
