"""The study of the controllers' loops: margins, and changes of an arm."""

import numpy as np

from baselines import CONTROLLERS
from baselines.loops.condition import least_margins
from beltarm_env.arm import COLUMN, FIELDS
from beltarm_env.rollout import rollout
from beltarm_env.task.ranges import TRAIN_RANGES
from beltarm_env.task.seeds import LOOPS
from eval.studies._arms import drawn
from eval.studies.loops import NONE_LEFT, scan
from eval.studies.loops.costs import CHANGES, LIMITS, blind, run_arms


def test_the_worst_margins_are_those_of_the_condition():
    """An unstable loop has none."""
    found, least, unstable = scan(CONTROLLERS["ei"]()), least_margins(CONTROLLERS["ei"]()), scan(CONTROLLERS["paper"]())
    for name in ("modulus", "delay"):
        worst = found["worst"][name]
        assert worst["value"] == getattr(least, name)
        assert f"{worst['arm']}, {worst['degrees']:.0f}°" == getattr(least, f"{name}_at")
    assert found["over_arms"]["modulus"].min() == found["modulus_by_arm"].min() == least.modulus
    assert not unstable["stable"] and unstable["slowest"] > 0
    assert {name: worst["value"] for name, worst in unstable["worst"].items()} == NONE_LEFT


def test_a_change_sets_its_constants_and_nothing_else():
    """A limit lies beyond training; what is not changed runs as the environment draws it."""
    table, controller = drawn(3, LOOPS.first).params_table, CONTROLLERS["zv"]()
    for change in CHANGES:
        differ = {FIELDS[k] for k in np.flatnonzero((change.applied(table) != table).any(axis=0))}
        assert differ <= set(change.constants)
        for name, value in change.constants.items():
            assert np.all(change.applied(table)[:, getattr(COLUMN, name)] == value)
    for change in LIMITS:
        ((name, value),) = change.constants.items()
        assert not TRAIN_RANGES[name][0] <= value <= TRAIN_RANGES[name][1]
    expected = rollout(controller, 3, seed=LOOPS.first, randomization="train")
    np.testing.assert_array_equal(run_arms(blind(controller), table).cost, expected.cost)
