"""Estimates, intervals and paired tests of a comparison, beside SciPy's, the definitions, and their promised rates."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import trim_mean
from scipy.stats.mstats import trimmed_mean_ci

from eval.comparison import statistics
from eval.comparison.statistics import RESAMPLES, all_paired, estimate, estimates, holm, paired, resampled


def test_interquartile_mean_is_scipys_trimmed_one():
    for count in (2, 3, 7, 8, 50, 201):
        values = np.random.default_rng(count).normal(size=(1, count))
        assert statistics.interquartile_mean(values) == pytest.approx(trim_mean(values[0], 0.25))


def test_intervals_cover_the_truth_about_as_often_as_they_say():
    """Of a normal population; scenarios and seeds both drawn anew. With few seeds, a bootstrap is known too narrow."""
    rng = np.random.default_rng(5)
    for seeds in (1, 12):
        effects = rng.normal(0, 0.5, (60, 12, 1)) + rng.normal(0, 0.3, (60, 12, 40)) if seeds > 1 else 0.0
        tables = rng.normal(2, 1, (60, 1, 40)) + effects
        found = [estimate(table, mean=seeds > 1) for table in tables]
        hits = sum(each.low <= 2.0 <= each.high for each in found)
        assert 50 <= hits < 60  # 57 expected of 60; fewer than 50 has a probability below 1e-3
        assert estimates(tables[:4], mean=seeds > 1) == found[:4], "several together are each by itself"


@pytest.mark.parametrize("seeds", [1, 3])
def test_samples_are_those_of_a_bootstrap_by_definition(seeds: int):
    values, rng = np.random.default_rng(seeds).normal(size=(seeds, 20)), np.random.default_rng(0)
    scenarios = rng.integers(0, 20, (RESAMPLES, 20))
    runs = rng.integers(0, seeds, (RESAMPLES, seeds)) if seeds > 1 else np.zeros((RESAMPLES, 1), int)
    samples = resampled(values)
    for k in range(0, RESAMPLES, 100):
        assert samples[k] == statistics.interquartile_mean(values[runs[k]][:, scenarios[k]])


def test_paired_by_hand():
    result = paired(np.array([[1.0, 2, 3, 4], [2, 2, 2, 2]]), np.array([[2.0, 2, 2, 8], [2, 2, 2, 4]]))
    # Seeds are paired in their order, so the differences are -1, 0, 1, -4 and 0, 0, 0, -2.
    assert result.difference.iqm == pytest.approx((-1 + 0 + 0 + 0) / 4)
    assert result.win_rate.iqm == pytest.approx((3 + 4 * 0.5) / 8)
    one, five = np.arange(40.0)[None] / 20, np.arange(40.0) / 20 + np.arange(5.0)[:, None] / 20
    assert paired(one, five).p == paired(five, one).p > 0.01  # the seeds differ by as much as the methods do


def test_what_is_alike_is_not_told_apart():
    """Values that tie nearly everywhere, or are too few to compare; a constant difference is as sure as can be."""
    values, few = np.arange(40.0)[None], np.zeros((1, 1))
    tables = [(values - 1, values), (values + 1, values), (np.eye(1, 40), np.zeros((1, 40)))]
    sure, worse, tied = (paired(*pair) for pair in tables)
    assert (sure.verdict, sure.p) == ("better", pytest.approx(2 / (RESAMPLES + 1))) and worse.verdict == "worse"
    assert (tied.verdict, tied.difference.iqm, tied.p) == ("no difference shown", 0.0, 1.0)
    assert paired(few, few).verdict == "not compared"
    assert all_paired(tables) == [sure, worse, tied] and all_paired([]) == []


@pytest.mark.parametrize(("seeds", "spread"), [(1, 0.0), (2, 0.3), (5, 0.0), (5, 1.0)])
@pytest.mark.parametrize("skewed", [False, True])
def test_false_alarms_are_as_rare_as_they_should_be(seeds: int, spread: float, skewed: bool):
    """A bootstrap of five seeds alone, whose policies differ as scenarios do, shows a difference in 10 to 15 %."""
    rng = np.random.default_rng(240 + seeds)
    scenarios = rng.exponential(size=(400, 1, 24)) - 0.738 if skewed else rng.normal(size=(400, 1, 24))
    of_both = 0.5 * rng.normal(size=(400, seeds, 24)) if seeds > 1 else 0.0
    differences = scenarios + spread * rng.normal(size=(400, seeds, 1)) + of_both
    p = np.array([pair.p for pair in all_paired([(table, np.zeros((1, 24))) for table in differences])])
    assert np.mean(p < 0.05) < 0.085  # 0.05 at most; more has a probability below 2e-3


@pytest.mark.parametrize(("count", "told"), [(4, False), (19, False), (20, True), (24, True)])
def test_few_scenarios_say_nothing(count: int, told: bool):
    """Four pairs cannot have a p value below 0.125, however far apart they are."""
    result = paired(np.linspace(1.0, 2.0, count)[None] - 50, np.linspace(1.0, 2.0, count)[None] + np.eye(1, count))
    assert result.decides == (result.p < 0.05) == (result.verdict == "better") == told
    assert result.scenarios == count and result.difference.high < 0
    assert told or result.p == 1


def test_p_values_of_one_seed_are_those_of_a_trimmed_t_test_where_it_is_the_larger():
    """Where the interval of SciPy's trimmed mean just touches zero, p is 0.05, or the bootstrap's if that is larger."""
    rng, found = np.random.default_rng(11), list[float]()
    for values in rng.normal(size=(20, 1, 24)):
        ends = trimmed_mean_ci(values[0], (0.25, 0.25), alpha=0.05)
        found += [paired(values - end, np.zeros((1, 24))).p for end in ends]
    assert min(found) == pytest.approx(0.05) and np.count_nonzero(np.isclose(found, 0.05)) > len(found) / 2


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
