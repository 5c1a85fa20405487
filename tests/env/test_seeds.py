"""Seeds: nobody draws another's arms."""

import re
from itertools import pairwise
from pathlib import Path

import pytest

from beltarm_env.task.seeds import (
    DATASETS,
    DEVELOPMENT,
    FRESH,
    FURTHER,
    MAX_DATASET_SEED,
    MAX_FRESH_SEED,
    MAX_TRAINING_SEED,
    RANGES,
    SEALED,
    SEED_SPACING,
    TEST,
    TRAINING,
    arms_chosen_by,
    dataset_arms,
    fresh_arms,
    further_arms,
    sealed_arms,
    training_arms,
)

ROOT = Path(__file__).parents[2]


def test_ranges_are_disjoint():
    ordered = sorted(RANGES.values())
    assert len(ordered) > 10 and all(first.first + first.size <= second.first for first, second in pairwise(ordered))
    assert all(of.size > 0 for of in ordered)


def test_training_seeds_share_no_arm_and_fill_their_range():
    first, last = training_arms(0), training_arms(MAX_TRAINING_SEED)
    assert first.first == TRAINING.first and last.first + last.size == TRAINING.first + TRAINING.size
    assert training_arms(1).first == first.first + first.size == SEED_SPACING


def test_datasets_share_no_episode_and_fill_their_range():
    first, last = dataset_arms(0), dataset_arms(MAX_DATASET_SEED)
    assert first.first == DATASETS.first and last.first + last.size == DATASETS.first + DATASETS.size
    assert dataset_arms(1).first == first.first + first.size


def test_fresh_sets_share_no_arm_and_lie_beyond_what_is_used_here():
    first, last = fresh_arms(0), fresh_arms(MAX_FRESH_SEED)
    assert first.first == FRESH.first == max(of.first for of in RANGES.values() if of not in (TEST, SEALED, FURTHER))
    assert fresh_arms(1).first == first.first + first.size and first.size == DEVELOPMENT.size
    assert last.first + last.size == FRESH.first + FRESH.size


def test_a_hash_chooses_the_test_scenarios():
    first, last = arms_chosen_by("0" * 40), arms_chosen_by("f" * 40)
    assert first.first == TEST.first and last.first + last.size == TEST.first + TEST.size
    assert arms_chosen_by("00000002" + "a" * 32).first == first.first + 2 * DEVELOPMENT.size
    assert TEST.first == FRESH.first + FRESH.size
    for no_hash in ("", "abc1234", "g" * 40, "A" * 40):
        with pytest.raises(ValueError, match="the hash of a commit has 40 hexadecimal digits, got"):
            arms_chosen_by(no_hash)


def test_a_secret_chooses_the_sealed_scenarios():
    last = sealed_arms(SEALED.size // DEVELOPMENT.size - 1)
    assert sealed_arms(0).first == SEALED.first == TEST.first + TEST.size
    assert last.first + last.size == SEALED.first + SEALED.size


def test_further_scenarios_of_fresh_sets_lie_beyond_all_others():
    first, last = further_arms(0), further_arms(MAX_FRESH_SEED)
    assert first.first == FURTHER.first == max(of.first for of in RANGES.values())
    assert further_arms(1).first == first.first + first.size
    assert last.first + last.size == FURTHER.first + FURTHER.size < 2**63


def test_no_other_module_has_a_range_of_its_own():
    """A seed of seven digits stands in one module; others name it. Numbers of samples, steps, budgets are no seeds."""
    found = []
    for package in ("beltarm_env", "baselines", "agents", "train", "eval"):
        for path in (ROOT / package).rglob("*.py"):
            for line in path.read_text(encoding="utf-8").splitlines():
                if path.name != "seeds.py" and re.search(r"\b[4-9]_?\d{3}_?\d{3}\b", line):
                    found += (
                        []
                        if re.search(r"\b(samples|total_steps): int\b|--budget ", line)
                        else [f"{path.name}: {line.strip()}"]
                    )
    assert found == []
