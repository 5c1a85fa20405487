from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import trim_mean
from scipy.stats.mstats import trimmed_mean_ci

from eval.comparison import statistics
from eval.comparison.statistics import (
    RESAMPLES,
    all_paired,
    estimate,
    estimates,
    holm,
    interquartile_mean,
    paired,
    resampled,
)


def test_interquartile_mean_by_hand():
    assert interquartile_mean(np.array([[1.0, 2, 3, 4, 5, 6, 7, 800]])) == pytest.approx((3 + 4 + 5 + 6) / 4)
    for count in (2, 3, 7, 8, 50, 201):
        values = np.random.default_rng(count).normal(size=(1, count))
        assert interquartile_mean(values) == pytest.approx(trim_mean(values[0], 0.25))


def test_equal_values_have_an_interval_of_no_width():
    result = estimate(np.full((3, 10), 4.0))
    assert (result.iqm, result.low, result.high) == (4.0, 4.0, 4.0)


def test_intervals_cover_the_truth_about_as_often_as_they_say():
    # A normal population has its interquartile mean at its mean.
    rng = np.random.default_rng(1)
    hits = 0
    for _ in range(60):
        result = estimate(rng.normal(2.0, 1.0, (1, 60)))
        hits += result.low <= 2.0 <= result.high
    assert 50 <= hits <= 60  # 57 expected of 60; fewer than 50 has a probability below 1e-3


def test_seeds_that_differ_widen_the_interval():
    scenarios = np.random.default_rng(2).normal(10, 1, 80)
    alike = np.tile(scenarios, (5, 1))
    different = alike + np.array([-3.0, -1.5, 0.0, 1.5, 3.0])[:, None]
    narrow, wide = estimate(alike), estimate(different)
    assert wide.high - wide.low > 2 * (narrow.high - narrow.low)


def test_one_episode_has_no_interval():
    with pytest.raises(ValueError, match="at least 2 episodes, got 1"):
        estimate(np.ones((1, 1)))


@pytest.mark.parametrize(
    ("shift", "verdict", "wins"), [(-1.0, "better", 1.0), (1.0, "worse", 0.0), (0.0, "no difference shown", 0.5)]
)
def test_paired_differences(shift: float, verdict: str, wins: float):
    rng = np.random.default_rng(3)
    other = rng.normal(10, 5, (1, 400))  # scenarios differ far more than the methods do
    noise = rng.normal(0, 0.5, (1, 400)) if shift == 0 else rng.normal(0, 0.1, (2, 400))
    result = paired(other + shift + noise, other)
    assert result.verdict == verdict
    assert result.win_rate.iqm == pytest.approx(wins, abs=0.08)
    assert (result.p < 0.05) == (verdict != "no difference shown")
    assert result.difference.iqm == pytest.approx(shift, abs=0.1)


# Bootstrap samples


def test_there_are_as_many_as_the_protocol_says():
    protocol = Path(__file__).resolve().parents[2] / "docs" / "benchmark" / "protocol.md"
    assert f"interval of {RESAMPLES} resamples" in protocol.read_text(encoding="utf-8")


def test_intervals_over_seeds_cover_the_truth():
    """Scenarios and seeds both drawn anew, twelve seeds; with few, a bootstrap is known to be too narrow."""
    rng = np.random.default_rng(5)
    hits = 0
    for _ in range(60):
        values = rng.normal(2, 1, (1, 40)) + rng.normal(0, 0.5, (12, 1)) + rng.normal(0, 0.3, (12, 40))
        result = estimate(values, mean=True)
        hits += result.low <= 2.0 <= result.high
    assert hits >= 50  # 57 expected of 60; fewer than 50 has a probability below 1e-3


@pytest.mark.parametrize(("seeds", "mean"), [(1, False), (3, False), (1, True), (3, True)])
def test_several_tables_are_estimated_as_each_is_by_itself(seeds: int, mean: bool):
    tables = np.random.default_rng(seeds).normal(size=(4, seeds, 30))
    tables[2] = 1.5
    before = tables.copy()
    assert estimates(tables, mean) == [estimate(table, mean) for table in tables]
    assert np.array_equal(resampled(tables, mean)[1], resampled(tables[1], mean))
    assert np.array_equal(tables, before), "nothing is sorted in its place"


@pytest.mark.parametrize("seeds", [1, 3])
def test_samples_are_those_of_a_bootstrap_by_definition(seeds: int):
    values, rng = np.random.default_rng(seeds).normal(size=(seeds, 20)), np.random.default_rng(0)
    scenarios = rng.integers(0, 20, (RESAMPLES, 20))
    runs = rng.integers(0, seeds, (RESAMPLES, seeds)) if seeds > 1 else np.zeros((RESAMPLES, 1), int)
    for k in range(0, RESAMPLES, 100):
        assert resampled(values)[k] == interquartile_mean(values[runs[k]][:, scenarios[k]])


# Paired comparisons


def test_several_pairs_are_compared_as_each_is_by_itself():
    rng = np.random.default_rng(8)
    tables = [(rng.normal(size=(seeds, 25)), rng.normal(size=(1, 25))) for seeds in (2, 1, 1, 2)]
    tables.insert(1, (tables[1][1], tables[1][1]))
    assert all_paired(tables) == [paired(*both) for both in tables]
    assert all_paired([]) == []


def test_paired_by_hand():
    result = paired(np.array([[1.0, 2, 3, 4], [2, 2, 2, 2]]), np.array([[2.0, 2, 2, 8], [2, 2, 2, 4]]))
    # The other's mean is 2, 2, 2, 6, so the differences are -1, 0, 1, -2 and 0, 0, 0, -4.
    assert result.difference.iqm == pytest.approx((-1 + 0 + 0 + 0) / 4)
    assert result.win_rate.iqm == pytest.approx((3 + 4 * 0.5) / 8)


def test_a_constant_difference_is_as_sure_as_can_be():
    values = np.arange(30.0)[None]
    assert paired(values - 1, values).p == pytest.approx(2 / (RESAMPLES + 1))
    assert paired(values - 1, values).verdict == "better"
    same = paired(values, values)
    assert (same.difference.iqm, same.win_rate.iqm, same.p) == (0.0, 0.5, 1.0)


@pytest.mark.parametrize("odd", [-1.0, 1.0])
def test_methods_that_tie_nearly_everywhere_are_not_told_apart(odd: float):
    result = paired(np.array([[odd] + 39 * [0.0]]), np.zeros((1, 40)))
    assert (result.difference.iqm, result.p) == (0.0, 1.0)
    assert result.verdict == "no difference shown"


@pytest.mark.parametrize("count", [20, 24, 50])
@pytest.mark.parametrize(("seeds", "spread"), [(1, 0.0), (5, 0.0), (5, 1.0)])
@pytest.mark.parametrize("skewed", [False, True])
def test_false_alarms_are_as_rare_as_they_should_be(count: int, seeds: int, spread: float, skewed: bool):
    """A bootstrap of five seeds alone, whose policies differ as scenarios do, shows a difference in 10 to 15 %."""
    rng = np.random.default_rng(10 * count + seeds)
    scenarios = rng.exponential(size=(400, 1, count)) - 0.738 if skewed else rng.normal(size=(400, 1, count))
    of_both = 0.5 * rng.normal(size=(400, seeds, count)) if seeds > 1 else 0.0
    differences = scenarios + spread * rng.normal(size=(400, seeds, 1)) + of_both
    p = np.array([pair.p for pair in all_paired([(table, np.zeros((1, count))) for table in differences])])
    assert np.mean(p < 0.05) < 0.085  # 0.05 at most; more has a probability below 2e-3


@pytest.mark.parametrize(("count", "told"), [(4, False), (19, False), (20, True), (24, True)])
def test_few_scenarios_say_nothing(count: int, told: bool):
    """Four pairs cannot have a p value below 0.125, however far apart they are."""
    result = paired(np.linspace(1.0, 2.0, count)[None] - 50, np.linspace(1.0, 2.0, count)[None] + np.eye(1, count))
    assert result.decides == (result.p < 0.05) == (result.verdict == "better") == told
    assert result.scenarios == count and result.difference.high < 0
    assert told or result.p == 1


def test_p_values_of_one_seed_are_those_of_a_trimmed_t_test_where_it_is_the_larger():
    """Where the interval of SciPy's trimmed mean just touches zero, p is 0.05."""
    rng = np.random.default_rng(11)
    for _ in range(20):
        values = rng.normal(size=(1, 24))
        low, high = trimmed_mean_ci(values[0], (0.25, 0.25), alpha=0.05)
        assert paired(values - low, np.zeros((1, 24))).p >= 0.05 - 1e-9
        assert paired(values - high, np.zeros((1, 24))).p >= 0.05 - 1e-9


def test_nothing_to_compare_is_no_difference():
    assert paired(np.zeros((1, 0)), np.zeros((1, 0))).verdict == "not compared"
    assert paired(np.zeros((1, 1)), np.zeros((1, 1))).verdict == "not compared"


def test_holm_by_hand():
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.4, 0.5]) == pytest.approx([0.8, 0.8])
    assert holm([0.7]) == [0.7]
    assert holm([]) == []


def rejected(p_values: list[float], level: float) -> set[int]:
    """Holm's procedure as he wrote it: step down until the first that is too large."""
    indices: set[int] = set()
    for k, index in enumerate(sorted(range(len(p_values)), key=lambda i: p_values[i])):
        if p_values[index] > level / (len(p_values) - k):
            break
        indices.add(index)
    return indices


@given(st.lists(st.integers(1, 4000), min_size=1, max_size=12), st.sampled_from([0.01, 0.05, 0.1]))
def test_holm_rejects_what_the_procedure_does(thousands: list[int], level: float):
    p_values = [(p + 0.3) / 4001 for p in thousands]  # never just at a bound
    assert {k for k, p in enumerate(holm(p_values)) if p <= level} == rejected(p_values, level)


def test_holm_keeps_false_findings_rare():
    rng = np.random.default_rng(8)
    families = rng.uniform(size=(2000, 10))
    assert np.mean([min(holm(family.tolist())) < 0.05 for family in families]) == pytest.approx(0.05, abs=0.02)
    assert np.mean(families.min(axis=1) < 0.05) > 0.35  # without it


def test_many_scenarios_are_resampled_in_batches(monkeypatch: pytest.MonkeyPatch):
    """Samples of one seed are the same; memory is that of a batch."""
    values = np.random.default_rng(0).random((1, 501))
    before = resampled(values)
    monkeypatch.setattr(statistics, "_AT_ONCE", 501 * 100)
    assert np.array_equal(resampled(values), before)
