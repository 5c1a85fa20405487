"""The study of the paper: its linear analysis, its ringing, its runs, its drives, and the words of its page."""

import math
from dataclasses import replace
from typing import Any

import control
import numpy as np
import pytest

from baselines import PaperController
from beltarm_env import CONTROL_PERIOD, ArmParams, BeltArmVectorEnv, observation, state_space
from beltarm_env.rollout import rollout
from eval.studies import paper
from eval.studies._arms import ALL, IDEAL
from eval.studies.paper import ALTERNATIVES, DRIVES, compare, linear, run_drives, runs, vary
from eval.studies.paper.linear import PAPER_ARM, TABLE_2, digital_poles, dominant_damping, locus, poles
from eval.studies.paper.runs import ANALYSED, AS_ANALYSED, MAIN, Conditions, ringing, run_moves

USUAL_MOVE = runs.PLACES[runs.STANDARD]
DEG_90 = math.pi / 2


class TestLoop:
    def test_poles_at_0_degrees(self):
        expected = [-1.34, -21.9, -11.9 - 51.7j, -11.9 + 51.7j]
        found = np.sort_complex(poles(linear.closed_loop(PAPER_ARM, 0.0, TABLE_2)))
        np.testing.assert_allclose(found, np.sort_complex(np.array(expected)), atol=0.05)

    def test_sign_printed_in_6e_makes_the_loop_unstable(self):
        found = poles(linear.closed_loop(PAPER_ARM, 0.0, TABLE_2, as_printed=True))
        assert found[found.imag.argmax()] == pytest.approx(13 + 58j, abs=0.5)
        assert dominant_damping(found) < 0

    def test_k4_locus_is_that_of_python_control(self):
        gains = np.array([0.0, 0.15, 0.5])
        a, (_, b, _) = linear.closed_loop(PAPER_ARM, DEG_90, replace(TABLE_2, k4=0.0)), state_space(PAPER_ARM, DEG_90)
        torsion_speed = control.StateSpace(a, b, np.array([[0.0, 0.0, 0.0, 1.0]]), 0)
        expected: Any = control.root_locus_map(torsion_speed, gains=gains)
        found = locus(DEG_90, TABLE_2, "k4", gains)
        np.testing.assert_allclose(np.sort_complex(found), np.sort_complex(expected.loci), atol=1e-6)

    @pytest.mark.parametrize(
        ("model", "angle", "pole"),
        [
            *(("lumped", 0.0, 1j * math.sqrt(33 / 0.01)), ("lumped", DEG_90, 1j * math.sqrt(33 / 0.07))),
            *(("lagrangian", 0.0, -0.03 + 28.8j), ("lagrangian", DEG_90, -0.61 + 28.9j)),
        ],
    )
    def test_simulated_torsion_leaves_the_mode_behind_a_held_motor(self, model: Any, angle: float, pole: complex):
        found = digital_poles(PAPER_ARM, angle, TABLE_2, model=model)
        assert np.abs(found - pole).min() < (1e-6 if model == "lumped" else 0.05)
        assert dominant_damping(found) < 0.03


def test_ringing_of_a_sinusoid():
    time, speed = (1 + np.arange(1200)) * CONTROL_PERIOD, np.zeros((1200, 3, 2))
    speed[:, 0] = np.sin(20 * time)[:, None] * [0.3, 0.4]  # acceleration of amplitude 6 along x and 8 along y
    speed[:, 1, 1] = 0.1 * time  # a drift: constant acceleration
    speed[:, 2, 0] = np.where((time > 0.8) & (time < 1.3), np.sin(20 * time), np.sin(20 * 0.8))
    found = ringing(speed, np.full(3, 0.8), np.full(3, 0.1))
    for phase in found:
        np.testing.assert_allclose(phase[:2], [10 / math.sqrt(2), 0.1], rtol=0.06)
    assert found[0, 2] == 0 and found[2, 2] == 0 and found[1, 2] > 1
    assert np.isnan(ringing(speed, np.full(3, 0.8), np.full(3, 0.4))[0]).all()


class TestRuns:
    def test_default_assumptions_are_the_papers_controller(self):
        run = run_moves(Conditions(), TABLE_2, [USUAL_MOVE])
        direct = rollout(PaperController(), 1, seed=0, options={"move": USUAL_MOVE._asdict()})
        np.testing.assert_allclose(run.state, direct.state, atol=1e-4)

    def test_true_torsion_and_measured_sign(self):
        env = BeltArmVectorEnv(3, sensors="full")
        seen, _ = env.reset(seed=1)
        for _ in range(40):
            seen, *_ = env.step(np.array([[0.5], [-0.4], [0.2]]))
        told = observation.decode(seen, "full")
        conditions = Conditions(friction_sign="measured", true_torsion=True)
        action, _ = runs.AssumedServo(conditions, TABLE_2.feedback).predict(seen, episode_start=np.ones(3, bool))
        u_1 = 88 * told["reference_acceleration"] + 20 * told["motor_speed_error"] + 25 * told["motor_angle_error"]
        torque = 6.3e-5 * u_1 + 3.5e-4 * told["motor_speed"] + 0.032 * np.sign(told["motor_speed"])
        torque -= 0.15 * told["torsion_speed"]
        np.testing.assert_allclose(action[:, 0], np.clip(torque / 0.3, -1, 1), atol=1e-6)

    def test_every_assumption_is_tried_at_other_values(self, monkeypatch: pytest.MonkeyPatch):
        assert len({tried.label for tried in ALTERNATIVES}) == len(ALTERNATIVES)
        assert len({tried.move for tried in ALTERNATIVES}) == 13, "the standard one, and no other twice"
        for tried in ALTERNATIVES:
            assert any((tried.under(base), tried.move) != (base, USUAL_MOVE) for base in MAIN.values()), tried.label
        moved = [tried for tried in ALTERNATIVES if tried.assumption == "where the move leads"]
        folded = next(tried for tried in ALTERNATIVES if tried.assumption == "how the arm folds")
        monkeypatch.setattr(paper, "ALTERNATIVES", [*moved, folded])
        for tried, row in zip(paper.ALTERNATIVES, vary({view: [{"": 1.0}] * 2 for view in MAIN}), strict=True):
            alone = runs.suppression(tried.under(ANALYSED), [tried.move])[:, :, 0]
            assert row["views"][AS_ANALYSED]["ratios"]["end"] == pytest.approx(runs.ratios(alone)[2], rel=1e-6)

    def test_an_arm_that_left_its_workspace_is_not_measured(self):
        run = run_moves(Conditions(arm=ArmParams(payload_mass=0.2)), replace(TABLE_2, k4=1.0), [USUAL_MOVE])
        shown = runs.signals_of(run)
        assert np.isinf(runs.ringing_of(run)).all() and np.isfinite(shown["radial_speed"][0])
        assert np.isnan(shown["radial_speed"][-1]) and np.isfinite(runs.summary(shown)["peak_torque"])


MOVES = list(runs.PLACES.values())


@pytest.mark.parametrize("view", MAIN)
def test_every_effect_of_a_drive_changes_the_motion(view: str):
    """But for those of Coulomb friction where there is none. The ideal drive's ringing is that of the other tables."""
    recorded = run_drives(MOVES, MAIN[view], 2)
    expected, rows = runs.suppression(MAIN[view], MOVES), compare(recorded, 2)
    for k in range(len(MOVES)):
        row, (_, stop, end) = rows[k][0], runs.ratios(expected[:, :, k])
        assert row["drive"] == IDEAL
        np.testing.assert_array_equal(row["ringing"], expected[:, 1, k])
        np.testing.assert_array_equal([row["ratios"]["stop"], row["ratios"]["end"]], [[stop] * 2, [end] * 2])
    errors = recorded[1].tip_velocity_error[:, :, 0].reshape(-1, len(MOVES), len(DRIVES), 2)
    of_friction = {"static_friction_excess", "friction_variation"}
    for k, drive in enumerate(DRIVES):
        same = np.abs(errors[:, :, k] - errors[:, :, 0]).max(axis=(0, 2)) < 1e-5
        assert (same == (drive == IDEAL or (view == AS_ANALYSED and drive in of_friction))).all(), drive
    drawn = errors[:, 0, DRIVES.index(ALL)]
    assert not np.array_equal(drawn[:, 0], drawn[:, 1])
