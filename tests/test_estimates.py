from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import trim_mean

from eval.estimates import estimate, interquartile_mean, paired


def test_interquartile_mean_by_hand():
    assert interquartile_mean(np.array([[1.0, 2, 3, 4, 5, 6, 7, 800]])) == pytest.approx((3 + 4 + 5 + 6) / 4)
    assert interquartile_mean(np.array([[1.0, 100], [2, 3]])) == pytest.approx(2.5)


@pytest.mark.parametrize("count", [2, 3, 7, 8, 50, 201])
def test_interquartile_mean_is_the_trimmed_mean_of_scipy(count: int):
    values = np.random.default_rng(count).normal(size=(1, count))
    assert interquartile_mean(values) == pytest.approx(trim_mean(values[0], 0.25))


def test_equal_values_have_an_interval_of_no_width():
    result = estimate(np.full((3, 10), 4.0))
    assert (result.iqm, result.low, result.high) == (4.0, 4.0, 4.0)


def test_interval_is_reproducible_and_holds_the_estimate():
    values = np.random.default_rng(0).normal(5, 1, (3, 50))
    first, second = estimate(values), estimate(values)
    assert first == second
    assert first.low < first.iqm < first.high


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
    assert result.win_rate == pytest.approx(wins, abs=0.08)
    assert result.difference.iqm == pytest.approx(shift, abs=0.1)
