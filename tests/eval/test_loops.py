"""The study of the controllers' loops: margins, and changes of an arm."""

from baselines import CONTROLLERS
from baselines.loops.condition import least_margins
from eval.studies.loops import NONE_LEFT, gains, scan


def test_the_worst_margins_are_those_of_the_condition():
    found, least, unstable = scan(CONTROLLERS["ei"]()), least_margins(CONTROLLERS["ei"]()), scan(CONTROLLERS["paper"]())
    for name in ("modulus", "delay"):
        worst = found["worst"][name]
        assert worst["value"] == getattr(least, name)
        assert f"{worst['arm']}, {worst['degrees']:.0f}°" == getattr(least, f"{name}_at")
    assert found["over_arms"]["modulus"].min() == found["modulus_by_arm"].min() == least.modulus
    assert not unstable["stable"] and unstable["slowest"] > 0
    assert {name: worst["value"] for name, worst in unstable["worst"].items()} == NONE_LEFT


def test_only_gains_that_were_tuned_have_a_range():
    assert [value["searched"] for value in gains("paper")["values"]] == [None] * 3
    for value in gains("adrc")["values"]:
        assert value["searched"]["low"] < value["value"] < value["searched"]["high"]
