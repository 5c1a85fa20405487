"""The study of the controllers' loops: margins, changes of an arm, the price of margins, worth of identification."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from baselines import CONTROLLERS, TUNABLE
from baselines.gains import read_file, tuned, write_entry
from baselines.loops.condition import least_margins
from beltarm_env.arm import COLUMN, FIELDS
from beltarm_env.rollout import rollout
from beltarm_env.task.ranges import TRAIN_RANGES
from beltarm_env.task.seeds import LOOPS
from eval.studies._arms import drawn
from eval.studies.loops import NONE_LEFT, costs, gains, scan
from eval.studies.loops.costs import CHANGES, LIMITS, blind, price, run_arms, worth


def test_the_worst_margins_are_those_of_the_condition():
    found, least = scan(CONTROLLERS["ei"]()), least_margins(CONTROLLERS["ei"]())
    for name in ("modulus", "delay"):
        worst = found["worst"][name]
        assert worst["value"] == getattr(least, name)
        assert f"{worst['arm']}, {worst['degrees']:.0f}°" == getattr(least, f"{name}_at")
    assert found["over_arms"]["modulus"].min() == found["modulus_by_arm"].min() == least.modulus


def test_an_unstable_loop_has_no_margins():
    found = scan(CONTROLLERS["paper"]())
    assert not found["stable"] and not found["stable_design"] and found["slowest"] > 0
    assert {name: worst["value"] for name, worst in found["worst"].items()} == NONE_LEFT


def test_a_change_sets_its_constants_and_nothing_else():
    table = drawn(3, LOOPS.first).params_table
    for change in CHANGES:
        differ = {FIELDS[k] for k in np.flatnonzero((change.applied(table) != table).any(axis=0))}
        assert differ <= set(change.constants)
        for name, value in change.constants.items():
            assert np.all(change.applied(table)[:, getattr(COLUMN, name)] == value)
    for change in LIMITS:
        ((name, value),) = change.constants.items()
        low, high = TRAIN_RANGES[name]
        assert not low <= value <= high


def test_arms_as_built_run_as_the_environment_draws_them():
    controller = CONTROLLERS["zv"]()
    expected = rollout(controller, 3, seed=LOOPS.first, randomization="train")
    np.testing.assert_array_equal(run_arms(blind(controller), drawn(3, LOOPS.first).params_table).cost, expected.cost)


def test_prices_are_of_the_same_law_and_search(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    file = tmp_path / "without.json"
    monkeypatch.setattr(costs, "WITHOUT", file)
    same = read_file()["zv"]["provenance"]
    write_entry("zv", tuned("zv", TUNABLE["zv"].gains), same, file)
    kept = run_arms(blind(CONTROLLERS["zv"]()), drawn(3, LOOPS.first).params_table).cost
    found = price("zv", kept)
    assert found is not None and found["with"] == found["without"] and found["mean_with"] == found["mean_without"]
    write_entry("zv", tuned("ei", TUNABLE["ei"].gains), same, file)
    assert price("zv", kept) is None, "of another law"
    write_entry("zv", tuned("zv", TUNABLE["zv"].gains), {**same, "budget": same["budget"] + 1}, file)
    assert price("zv", kept) is None, "of another budget"
    assert price("ei", kept) is None and price("paper", kept) is None


def test_identification_is_beside_the_best_that_does_not():
    by_name = {"ei": np.full(4, 100.0), "zv": np.full(4, 300.0), "adaptive": np.array([100.0, 119.0, 121.0, 90.0])}
    same, best = worth(by_name)
    assert (best["title"], best["worse"], best["worst"]) == ("`ei`", 1, 1.21)
    assert same["own"] == best["own"] and same["other"] > 0
    assert worth({"ei": np.ones(4)}) == []


def test_gains_come_with_the_provenance_of_their_tuning():
    for name, entry in read_file().items():
        shown = gains(name)
        assert {value["name"]: value["value"] for value in shown["values"]} == pytest.approx(entry["gains"])
        assert shown["tuning"]["commit"] == entry["provenance"]["commit"]
    assert gains("paper")["tuning"] is None
