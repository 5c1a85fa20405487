"""A sample of the siege, which finds nothing; and faults that are planted, which it finds."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import mistake

from beltarm_env import BeltArmVectorEnv
from eval import soak
from eval.siege import determinism, environment, hostile
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
