"""Tails from many scenarios: shards, what becomes of them when something breaks off, estimates, and the page."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from commands import mistake, stopped
from scipy.stats import binom

from beltarm_env.metrics import NOT_ARRIVED
from beltarm_env.task.seeds import further_arms
from eval import compare, watch
from eval.comparison.failures import Failure
from eval.comparison.methods import Method, classical_methods, learned_methods, shipped_policies
from eval.comparison.pairs import Pair, measure
from eval.comparison.sets import MOST, fresh_scenarios, fresh_set
from eval.comparison.splits import EPISODES, SPLITS, first_seed
from eval.report import side_by_side
from eval.tails import shards, study
from eval.tails.estimates import against, percentile, share_of, tail_of, tail_size, unlike
from eval.tails.page import page
from eval.tails.publish import record
from eval.tails.shards import KEPT, Shard, is_kept, keep, merged, policy_of, run, run_shards, shards_of

SPLIT = "randomized"


def method(name: str = "paper") -> Method:
    (found,) = [one for one in [*classical_methods(), *learned_methods(shipped_policies())] if one.name == name]
    return found


# Scenarios


@pytest.mark.parametrize("name", ["randomized", "sensing"])
def test_a_fresh_set_goes_on_where_it_ends(name: str):
    few = fresh_set(1).splits[name]
    assert fresh_scenarios(1, name, range(EPISODES)).digest == few.digest
    across = fresh_scenarios(1, name, range(EPISODES - 2, EPISODES + 2))
    assert np.array_equal(across.moves[:2], few.moves[-2:]) and np.array_equal(across.delays[:2], few.delays[-2:])
    alone = fresh_scenarios(1, name, [EPISODES + 1])
    assert np.array_equal(alone.table[0], across.table[3]) and np.array_equal(alone.delays, across.delays[3:])
    assert alone.seed == first_seed(name, further_arms(1), MOST) + EPISODES + 1


def test_every_split_has_room_for_the_most_scenarios():
    firsts = [first_seed(name, further_arms(0), MOST) for name in SPLITS]
    assert np.diff(firsts).tolist() == [MOST] * (len(SPLITS) - 1)
    with pytest.raises(ValueError, match=f"scenarios of a fresh set have the numbers 0 to {MOST - 1}, got {MOST}"):
        fresh_scenarios(1, SPLIT, [MOST])


# Shards


def test_shards_are_the_batch_bit_for_bit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    together = measure(Pair(method(), fresh_set(1).splits[SPLIT], 24))
    monkeypatch.setattr(shards, "SIZE", 10)
    monkeypatch.setattr(shards, "BATCH", 4)
    cut = shards_of(method(), SPLIT, 1, 24)
    assert [(one.first, one.count) for one in cut] == [(0, 10), (10, 10), (20, 4)]
    assert run_shards(cut, tmp_path, 1) == []
    for name in KEPT:
        assert np.array_equal(merged(cut, tmp_path, name), together[name][0])


def test_policies_take_turns():
    several = method("ppo")
    whole = Shard(several, "nominal", 1, 3, 6)
    found = run(whole)
    split = fresh_set(1).splits["nominal"]
    for k in (0, 5):
        policy = policy_of(3 + k, several)
        assert policy == (3 + k) % len(several.sources)
        alone = split.run(several.controller(policy, []), 3 + k)
        assert found["cost"][k] == alone.cost[0]


def few(count: int = 5) -> list[Shard]:
    return [Shard(method(), "nominal", 1, first, 2) for first in range(0, 2 * count, 2)]


def test_arms_that_do_not_arrive_do_not_count_as_still(tmp_path: Path):
    """Neither in vibration, nor in settling, nor in torques; where none arrives, there are no numbers."""
    shard = Shard(method(), "nominal", 1, 0, 40)
    away = np.arange(40) < 10
    for gone in (away, np.ones(40, bool)):
        values = {name: np.where(gone, 0.0, 5.0) for name in KEPT}
        values |= {"cost": np.arange(40.0), NOT_ARRIVED: gone.astype(float), "cpu_seconds": np.array(1.0)}
        keep(shard, values, tmp_path)
        (found,) = study._outcomes([[shard]], tmp_path)
        assert found.not_arrived.value == gone.mean()
        for name in ("residual_pp_mm", "settling_s", "torque_rate_rms"):
            tail = found.tails[name]
            assert [tail.mean, tail.iqm] == pytest.approx([np.nan if gone.all() else 5.0] * 2, nan_ok=True)
        assert found.tails["cost"].mean == 19.5
    done = study.Study(1, 40, {"nominal": [found]}, [], {"command": "", "beltarm": "", "commit": ""})
    assert "nan" not in page(done) and "NaN" not in json.dumps(record(done))


def test_an_interrupted_run_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    ran: list[int] = []

    def counted(shard: Shard) -> shards.Tables:
        if len(ran) == 2:
            raise KeyboardInterrupt
        ran.append(shard.first)
        return run(shard)

    monkeypatch.setattr(shards, "run", counted)
    with pytest.raises(KeyboardInterrupt, match=r"2 of 5 shards are done, and kept in .*; the same command"):
        run_shards(few(), tmp_path, 1)
    ran.clear()
    with pytest.raises(KeyboardInterrupt, match="4 of 5 shards"):
        run_shards(few(), tmp_path, 1)
    assert ran == [4, 6]
    ran.clear()
    told: list[tuple[int, int]] = []
    assert run_shards(few(), tmp_path, 1, lambda *news: told.append(news)) == []
    assert ran == [8] and told == [(4, 5), (5, 5)]
    assert len(merged(few(), tmp_path, "cost")) == 10


@pytest.mark.slow
def test_damaged_shards_are_run_again(tmp_path: Path):
    run_shards(few(4), tmp_path, 1)
    paths = [shard.file(tmp_path) for shard in few(4)]
    before = merged(few(4), tmp_path, "cost")
    paths[0].write_bytes(paths[0].read_bytes()[:-20])
    paths[1].write_bytes(b"")
    content = bytearray(paths[2].read_bytes())
    content[200] ^= 1  # within the first table
    paths[2].write_bytes(content)
    assert [is_kept(shard, tmp_path) for shard in few(4)] == [False, False, False, True]
    assert [path.exists() for path in paths] == [False, False, False, True]
    run_shards(few(4), tmp_path, 1)
    assert np.array_equal(merged(few(4), tmp_path, "cost"), before)


def test_shards_of_another_shape_or_without_numbers_are_run_again(tmp_path: Path):
    shard = few()[0]
    sound = run(shard)
    for spoilt in ({**sound, "cost": sound["cost"][:1]}, {**sound, "cost": np.array([1.0, np.nan])}):
        keep(shard, spoilt, tmp_path)
        assert not is_kept(shard, tmp_path)
    keep(shard, {name: values for name, values in sound.items() if name != "cost"}, tmp_path)
    assert not is_kept(shard, tmp_path)


def test_results_of_other_gains_are_replaced(tmp_path: Path):
    old = Shard(Method("paper", "classical", ("paper",), "other gains"), "nominal", 1, 0, 2)
    keep(old, run(old), tmp_path)
    assert is_kept(old, tmp_path) and not is_kept(few()[0], tmp_path)
    run_shards(few(1), tmp_path, 1)
    assert not old.file(tmp_path).exists() and is_kept(few()[0], tmp_path)


def test_a_failure_is_told_once_and_others_go_on(tmp_path: Path):
    broken = Method("broken", "classical", ("nobody",), "")
    mixed = [Shard(broken, "nominal", 1, first, 2) for first in (0, 2)] + few(1)
    (failure,) = run_shards(mixed, tmp_path, 1)
    assert isinstance(failure, Failure) and (failure.method, failure.message) == ("broken", "KeyError: 'nobody'")
    assert is_kept(mixed[-1], tmp_path)


# Estimates


def test_percentiles_are_values_and_their_intervals_cover():
    values = np.random.default_rng(0).permutation(5000).astype(float)  # value k is that of rank k + 1
    for share in (0.5, 0.9, 0.99, 0.999):
        found = percentile(values, share)
        assert found.value == np.quantile(values, share, method="inverted_cdf") == round(5000 * share) - 1
        covered = binom.cdf(found.high, 5000, share) - binom.cdf(found.low, 5000, share)
        assert covered >= 0.95  # of ranks low + 1 to high, one of which is the true percentile's
        assert binom.cdf(found.low, 5000, share) <= 0.025 and binom.sf(found.high, 5000, share) <= 0.025


def test_an_end_that_too_few_values_show_is_not_a_number():
    found = percentile(np.arange(500.0), 0.999)
    assert found.value == 499 and found.low < 499 and np.isnan(found.high)
    low = percentile(np.arange(500.0), 0.001)
    assert low.value == 0 and np.isnan(low.low) and low.high > 0


def test_tails_of_known_values():
    values = np.random.default_rng(1).permutation(np.arange(10_000.0))
    found = tail_of(values)
    assert found.mean == 4999.5 and found.error == pytest.approx(np.std(values) / 100, rel=1e-3)
    assert found.iqm == 4999.5 and found.worst == 9999
    assert found.worst_mean == np.mean(np.arange(9990, 10_000))
    share = share_of(values < 30)
    assert share.value == 0.003 and share.low < 0.003 < share.high < 0.005
    assert share_of(values < 0).low == 0 < share_of(values < 0).high < 4e-4
    paired = against(values, np.full(10_000, 2500.0))
    assert paired.dearer.value == 0.7499 and (paired.least, paired.most) == (-2500, 7499)


def test_errors_of_few_values_by_hand():
    # The standard deviation of 1, 2, 3, 6 is the root of 14 / 3, that of their mean half as large.
    values = np.array([2.0, 6.0, 1.0, 3.0])
    assert tail_of(values).error == pytest.approx((14 / 3) ** 0.5 / 2)
    paired = against(values, np.array([1.0, 1.0, 1.0, 1.0]))
    assert (paired.mean, paired.error) == (2.0, pytest.approx((14 / 3) ** 0.5 / 2))


def test_a_thousandth_is_the_tail_and_one_value_at_least():
    assert [tail_size(count) for count in (1, 1400, 1600, 100_000)] == [1, 1, 2, 100]


def test_what_a_tail_is_told_by():
    random = np.random.default_rng(2)
    usual = {"a": random.random(5000), "b": random.random(5000)}
    (found,) = unlike({"a": 0.5 + 0.5 * random.random(50), "b": random.random(50)}, usual)
    assert found.name == "a" and 0.4 < found.distance < 0.6 and found.median > 0.6 and found.p < 1e-6


# The command


def test_what_is_refused(tmp_path: Path):
    seed = ("--scenario-seed", "1")
    line = mistake(compare.main, ("--episodes", "501"), tmp_path)
    assert "--episodes must lie within 4 and 500, got 501; --scenario-seed 1 draws as many as you want, up to" in line
    assert "within 4 and 500, got 3" in mistake(compare.main, ("--episodes", "3"), tmp_path)
    line = mistake(compare.main, ("--episodes", "10000001", *seed), tmp_path)
    assert line.endswith("--episodes must lie within 4 and 10000000, got 10000001")
    for option in ("--maps", "--computing-time"):
        line = mistake(compare.main, ("--episodes", "600", option, *seed), tmp_path)
        assert f"{option} is for up to 500 scenarios, got --episodes 600: leave one of them out" in line
    line = mistake(watch.main, ("--scenario", "500", "--controller", "paper"), tmp_path)
    assert "--scenario must lie within 0 and 499, got 500" in line
    assert list(tmp_path.iterdir()) == []


def test_results_that_cannot_be_kept_are_refused(tmp_path: Path):
    unknown = Method("mine", "added", ("x:Y",), None)
    with pytest.raises(ValueError, match="results of mine cannot be kept, as more than 500 scenarios have to be"):
        study.study([unknown], [SPLIT], 1, 600, tmp_path, 1)


@pytest.mark.slow
def test_a_comparison_of_many_scenarios(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(shards, "SIZE", 400)
    arguments = ("--scenario-seed", "1", "--episodes", "1200", "--splits", "nominal", "--out", "out")
    arguments += ("--methods", "paper", "zvd", "--jobs", "2")
    assert stopped(compare.main, arguments, tmp_path) == (0, "")
    folder = tmp_path / "out"
    assert {path.name for path in folder.iterdir()} == {"tails.md", "tails.json", "tails.png", "shards"}
    assert (folder / "tails.png").read_bytes().startswith(b"\x89PNG")
    files = {path: path.stat().st_mtime_ns for path in folder.rglob("*.npz")}
    assert len(files) == 6
    costs = merged(shards_of(method(), "nominal", 1, 1200), folder, "cost")
    known = measure(Pair(method(), fresh_set(1).splits["nominal"], 40))["cost"][0]
    assert len(costs) == 1200 and np.array_equal(costs[:40], known)

    text, content = (folder / "tails.md").read_text(encoding="utf-8"), (folder / "tails.json").read_text()
    assert not re.search(r"\b(nan|inf|None)\b", text) and str(tmp_path) not in text
    assert "| `zvd` |" in capsys.readouterr().out and "### Against `zvd`, scenario by scenario" in text
    found = json.loads(content)["splits"]["nominal"]["paper"]
    assert found["tails"]["cost"]["percentiles"]["0.99"]["value"] == np.quantile(costs, 0.99, method="inverted_cdf")
    assert found["tails"]["cost"]["percentiles"]["0.999"]["high"] is None
    assert [case["scenario"] for case in found["worst"]] == np.argsort(-costs)[:5].tolist()

    worst = found["worst"][0]
    (command,) = re.findall(r"python eval/watch\.py (.*--controller paper)", text)
    assert f"--scenario {worst['scenario']} " in command
    monkeypatch.setattr(side_by_side, "write", lambda *_: None)
    assert stopped(watch.main, (*command.split(), "--out", "x.gif"), tmp_path) == (0, "")
    said = f"paper: tip error at most {worst['tip_max_mm']:.1f} mm, cost {worst['cost']:.0f}"
    assert said in capsys.readouterr().out

    assert stopped(compare.main, arguments, tmp_path) == (0, "")
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*.npz")} == files  # nothing was run again
