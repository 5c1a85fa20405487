"""What single studies promise: drive, guard, loops, repeated moves, observers, presliding and sensors."""

import numpy as np
import pytest

from agents.observer.network import Estimate
from agents.observer.quantities import NAMES
from baselines import CONTROLLERS, PaperController
from baselines.loops.condition import least_margins
from beltarm_env import ArmParams, BeltArmVectorEnv
from beltarm_env.arm import COLUMN, DRIVE_EFFECTS
from beltarm_env.rollout import record
from beltarm_env.task.ranges import DRIVE_RANGES
from eval.comparison.sets import development_set
from eval.studies._arms import ALL, EFFECTS, IDEAL, with_effect
from eval.studies.guard import NAN, Options, measure, worse_measures
from eval.studies.guard.faults import FaultyArms
from eval.studies.loops import NONE_LEFT, gains, scan
from eval.studies.observers import score, scores_of, watchers
from eval.studies.presliding import CLEAN, verdicts


@pytest.mark.parametrize("name", [IDEAL, *EFFECTS])
def test_arms_have_the_effects_asked_for_and_no_others(name: str):
    env = BeltArmVectorEnv(6, randomization="train")
    env.reset(seed=3)
    drawn, columns = env.params_table, {getattr(COLUMN, field): field for field in DRIVE_EFFECTS}
    np.testing.assert_array_equal(with_effect(drawn, ALL, 0.0), with_effect(drawn, IDEAL, 1.0))
    for size in (0.5, 2.0):
        arms = with_effect(drawn, name, size)
        for column, field in columns.items():
            end = size * DRIVE_RANGES[field][1] if name in (field, ALL) and field in EFFECTS else 0.0
            np.testing.assert_allclose(np.abs(arms[:, column]), end)
            assert (arms[:, column] * drawn[:, column] >= 0).all(), "signs are those drawn"
        np.testing.assert_array_equal(np.delete(arms, [*columns], 1), np.delete(drawn, [*columns], 1))
        assert all(ArmParams.from_row(row) for row in arms), "twice the ranges are within the bounds"


def test_a_faulty_arm_that_leaves_changes_nothing_for_the_others():
    arms = [FaultyArms(count, "sign error", randomization="train") for count in (2, 8)]
    few, many = (record(PaperController(), each, seed=5) for each in arms)
    assert not many.finished[2:].all()
    np.testing.assert_array_equal(few.state, many.state[:, :2])
    with pytest.raises(ValueError, match="'rust'"):
        FaultyArms(1, "rust")


def test_a_classical_controller_is_its_own_base_and_has_no_weights():
    quick = Options(controllers=("preview",), faults=("payload", NAN), splits=("nominal",), arms=1, episodes=4, jobs=1)
    (row,) = measure(quick)["rows"]
    assert row["fault"] == "payload" and row["base"] == row["without"]
    base, guarded = dict.fromkeys(("peak", "left", "energy"), 1.0), {"peak": 1.15, "left": 2.0, "energy": 1.1}
    worse = {"base": base | {"passive": 0.0}, "guarded": guarded | {"passive": 0.0}}
    assert worse_measures(row | worse) == ["peak", "left"]


def test_scores_of_errors_that_are_known():
    true = np.zeros((1, 4, len(NAMES)))
    mean = np.repeat(np.array([[0.5], [-0.5], [1.5], [-3.0]]), len(NAMES), axis=1)
    stated = score([Estimate(mean, np.ones_like(mean))], true)
    assert np.allclose(stated.rms, np.sqrt((0.25 + 0.25 + 2.25 + 9) / 4))
    assert np.all(stated.within_one == 0.5) and np.all(stated.within_two == 0.75)
    assert np.isnan(score([Estimate(mean, np.full_like(mean, np.nan))], true).within_one).all()


def test_observers_correct_the_filter_and_know_how_well():
    scores = scores_of("adaptive", watchers(), development_set().splits["shift"], 8)
    corrected, alone, known = (scores[name] for name in ("learned on the filter", "learned alone", "filter"))
    assert (corrected.rms / known.rms).max() < 1.0 and 0.62 < corrected.within_one.mean() < 0.76
    assert (alone.rms - known.rms)[NAMES.index("torsion")] > 0, "the encoder alone shows less"


def test_the_answer_follows_an_order_that_turns():
    rng = np.random.default_rng(0)
    low, high = rng.uniform(1, 2, (1, 30)), rng.uniform(3, 4, (1, 30))
    values = {("a", CLEAN): low, ("b", CLEAN): high, ("a", "1 mrad"): high, ("b", "1 mrad"): low}
    assert verdicts(values, ("a", "b"), CLEAN) == {("a", "b"): "better"}
    assert verdicts(values, ("a", "b"), "1 mrad") == {("a", "b"): "worse"}


def test_the_worst_margins_are_those_of_the_condition():
    found, least, unstable = scan(CONTROLLERS["ei"]()), least_margins(CONTROLLERS["ei"]()), scan(CONTROLLERS["paper"]())
    for name in ("modulus", "delay"):
        worst, at = found["worst"][name], getattr(least, f"{name}_at")
        assert (worst["value"], f"{worst['arm']}, {worst['degrees']:.0f}°") == (getattr(least, name), at)
    assert found["over_arms"]["modulus"].min() == found["modulus_by_arm"].min() == least.modulus
    assert not unstable["stable"] and unstable["slowest"] > 0
    assert {name: worst["value"] for name, worst in unstable["worst"].items()} == NONE_LEFT


def test_only_gains_that_were_tuned_have_a_range():
    assert [value["searched"] for value in gains("paper")["values"]] == [None] * 3
    assert all(
        value["searched"]["low"] < value["value"] < value["searched"]["high"] for value in gains("adrc")["values"]
    )
