"""Tails: estimates of a distribution's end, policies that take turns, and scenarios beyond those of a set."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom

from beltarm_env.task.seeds import further_arms
from eval.comparison.methods import classical_methods, learned_methods, shipped_policies
from eval.comparison.sets import MOST, fresh_scenarios, fresh_set
from eval.comparison.splits import EPISODES, SPLITS, first_seed
from eval.studies.tails import distinguishing_parameters, paired_with, percentile, played, share_of, tail_of


def test_a_fresh_set_goes_on_where_it_ends():
    """Every split has room for the most scenarios."""
    few = fresh_set(1).splits["sensing"]
    assert fresh_scenarios(1, "sensing", range(EPISODES)).digest == few.digest
    across = fresh_scenarios(1, "sensing", range(EPISODES - 2, EPISODES + 2))
    assert np.array_equal(across.moves[:2], few.moves[-2:]) and np.array_equal(across.delays[:2], few.delays[-2:])
    alone = fresh_scenarios(1, "sensing", [EPISODES + 1])
    assert np.array_equal(alone.table[0], across.table[3]) and np.array_equal(alone.delays, across.delays[3:])
    firsts = [first_seed(name, further_arms(1), MOST) for name in SPLITS]
    assert np.diff(firsts).tolist() == [MOST] * (len(SPLITS) - 1)
    assert alone.seed == firsts[list(SPLITS).index("sensing")] + EPISODES + 1
    with pytest.raises(ValueError, match=str(MOST)):
        fresh_scenarios(1, "randomized", [MOST])


def test_policies_take_turns(tmp_path: Path):
    """Scenario i is played by policy i modulo their number, as if alone."""
    known = [*classical_methods(), *learned_methods(shipped_policies())]
    methods = [method for method in known if method.name in ("paper", "ppo")]
    split = fresh_scenarios(1, "nominal", range(6))
    values = played(methods, split, 1, tmp_path)
    for method in methods:
        for k in range(6):
            alone = split.run(method.controller(k % len(method.sources)), k)
            assert values[method.name]["cost"][k] == alone.cost[0]


def test_percentiles_are_values_and_their_intervals_cover():
    values = np.random.default_rng(0).permutation(5000).astype(float)  # value k is that of rank k + 1
    for share in (0.5, 0.9, 0.99, 0.999):
        point, low, high = percentile(values, share)
        assert point == np.quantile(values, share, method="inverted_cdf") == round(5000 * share) - 1
        assert binom.cdf(high, 5000, share) - binom.cdf(low, 5000, share) >= 0.95  # of ranks low + 1 to high
        assert binom.cdf(low, 5000, share) <= 0.025 and binom.sf(high, 5000, share) <= 0.025
    point, low, high = percentile(np.arange(500.0), 0.999)
    assert point == 499 and low < 499 and np.isnan(high), "too few values show the end"


def test_tails_of_known_values():
    values = np.random.default_rng(1).permutation(np.arange(10_000.0))
    tail = tail_of(values)
    assert tail["mean"] == tail["iqm"] == 4999.5 and tail["error"] == pytest.approx(np.std(values) / 100, rel=1e-3)
    assert tail["worst"] == 9999 and tail["worst_mean"] == np.mean(np.arange(9990, 10_000))
    share, low, high = share_of(values < 30)
    assert share == 0.003 and low < 0.003 < high < 0.005
    paired = paired_with(values, np.full(10_000, 2500.0))
    assert paired["dearer"][0] == 0.7499 and paired["most"] == 7499
    assert np.isnan(tail_of(values[:1])["mean"])


def test_parameters_that_distinguish_a_tail():
    random = np.random.default_rng(2)
    usual = {"a": random.random(5000), "b": random.random(5000)}
    (shown,) = distinguishing_parameters({"a": 0.5 + 0.5 * random.random(50), "b": random.random(50)}, usual)
    assert shown["name"] == "a" and 0.4 < shown["distance"] < 0.6 and shown["median"] > 0.6
