"""A sample of the siege, which finds nothing; and faults that are planted, which it finds."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import mistake

from baselines import CONTROLLERS
from beltarm_env import BeltArmVectorEnv
from eval import soak
from eval.comparison.sets import development_set
from eval.siege import determinism, encoders, environment, guard, hostile, properties
from eval.siege.report import Siege, markdown


def test_a_sample_finds_nothing():
    siege = environment.besiege(5e-4, 1)
    assert siege.found == []
    assert siege.count > 1e5


class Fragile(BeltArmVectorEnv):
    """Has one reward that is no number, after a while."""

    def step(self, actions: Any) -> Any:
        observations, rewards, *rest = super().step(actions)
        rewards[3] = np.nan if self._batch.times[3] > 0.01 else rewards[3]
        return observations, rewards, *rest


class OfABatch(BeltArmVectorEnv):
    """Arms differ in their last bit from what they are alone."""

    def step(self, actions: Any) -> Any:
        observations, *rest = super().step(actions)
        return np.nextafter(observations, np.float32(0)), *rest


@pytest.mark.parametrize(
    ("planted", "told"), [(Fragile, "step 6: rewards are not finite"), (OfABatch, "does something else alone")]
)
def test_planted_faults_are_found(planted: type, told: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(environment, "BeltArmVectorEnv", planted)
    (first, *_) = environment.besiege(1e-4, 1).found
    assert first.startswith("seed 1, round 0 of 64 arms: {'sensors': ")
    assert told in first


def test_bits_that_depend_on_the_batch_are_found(monkeypatch: pytest.MonkeyPatch):
    assert determinism.episodes(3, 17) == determinism.episodes(3)
    monkeypatch.setattr(determinism, "_ELSEWHERE", {"Python's seed of hashes": {"PYTHONHASHSEED": "3"}})
    assert determinism.besiege(0.03, 1).found == []
    monkeypatch.setattr(determinism, "BeltArmVectorEnv", OfItsSize)
    assert "other bits in batches of" in determinism.besiege(0.03, 1).found[0]


class OfItsSize(BeltArmVectorEnv):
    """Observes something else in small batches."""

    def step(self, actions: Any) -> Any:
        observations, *rest = super().step(actions)
        return observations + np.float32(self.num_envs < 137), *rest


def test_guards_that_are_told_nonsense():
    siege = guard.besiege(0.02, 1)
    assert siege.found == []
    assert siege.count >= 4e5


@pytest.mark.parametrize(
    ("planted", "told"),
    [
        (lambda torques: torques.fill(np.nan), "a command of nan N m"),
        (lambda torques: torques.__imul__(1.5), "a command of"),
        (lambda torques: torques.__imul__(-1.0), "a command that changes by"),
        (lambda torques: torques.__imul__(1 - 1e-15 * (len(torques) > 1)), "a guard does something else alone"),
    ],
)
def test_guards_that_fail_are_found(planted: Any, told: str, monkeypatch: pytest.MonkeyPatch):
    sound = guard.guard_arms

    def faulty(design: Any, inputs: Any, begins: Any, memory: Any, torques: Any) -> None:
        sound(design, inputs, begins, memory, torques)
        planted(torques)

    monkeypatch.setattr(guard, "guard_arms", faulty)
    assert f": {told}" in guard.besiege(0.001, 1).found[0]


def test_encoders_lie_from_some_sample_on():
    length, arms = 300, 40 * len(encoders.FAULTS)
    made = encoders.LyingEncoders(np.zeros(arms, np.intp), length, np.random.default_rng(1))
    true = np.cumsum(np.random.default_rng(2).integers(1, 30, size=(length, arms)), axis=0)
    shown = np.array([made.shown(counts) for counts in true])
    lied = shown != true
    onset = np.where(lied.any(axis=0), lied.argmax(axis=0), length)
    assert np.abs(shown).max() <= 2**31
    for fault in encoders.FAULTS:
        whose = made.faults == fault
        assert lied[:, whose].any() == (fault != "none"), fault
        assert onset[whose].max() > 20, "samples before it are shown as they are"


@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")
def test_programs_of_controllers_whose_encoders_lie(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    split = next(iter(development_set().splits.values()))

    def found(folder: str) -> list[str]:
        return encoders.attack("paper", True, split, 20, 80, np.random.default_rng(3), tmp_path / folder)

    assert found("sound") == []
    monkeypatch.setattr(encoders, "controller_of", lambda source, guard: CONTROLLERS["ei"]())
    assert " N m in Python, " in found("planted")[0]


def test_there_are_twenty_kinds_of_mischief():
    assert len(hostile.KINDS) >= 20
    assert set(hostile.HARMLESS) < set(hostile.KINDS)


def test_the_page_has_what_was_found_and_what_cannot_be_seen():
    parts = [(Siege("one", "tries", "half of it", 1200), 3.2), (Siege("two", "tries", "more", 7, ["it broke"]), 61.0)]
    page = markdown(parts, "From nowhere.")
    for text in (
        "| one | 1,200 tries | 3 s | 0 |",
        "| two | 7 tries | 61 s | 1 |",
        "- two: it broke",
        "- one: half of it.",
    ):
        assert text in page
    assert "## Found" not in markdown(parts[:1], "From nowhere.")


def test_an_unknown_part(tmp_path: Path):
    told = mistake(soak.main, ("--parts", "moon"), tmp_path)
    assert "--parts has 'moon'; there are properties, inputs, kills" in told


TOY = """
from hypothesis import given, strategies
from properties import examples

@examples(50)
@given(strategies.integers(0, 10**9))
def test_small(number):
    assert number < {bound}

def test_of_another_kind():
    assert {other}
"""


@pytest.mark.parametrize(
    ("bound", "other", "told"),
    [(10**9 + 1, True, []), (10**8, True, ["test_small", "with the seed "]), (10**9 + 1, False, ["any seed"])],
    ids=["sound", "broken", "another"],
)
def test_a_property_that_fails_is_told_with_its_seed(bound: int, other: bool, told: list[str], tmp_path: Path):
    for name in ("conftest.py", "properties.py"):
        shutil.copy(Path(__file__).with_name(name), tmp_path)
    (tmp_path / "test_toy.py").write_text(TOY.format(bound=bound, other=other))
    found = properties.broken(str(tmp_path), seeds=[5, 6])
    assert len(found) == bool(told) and all(word in line for line in found for word in told)
