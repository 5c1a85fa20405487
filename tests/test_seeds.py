"""Seeds: nobody draws another's arms."""

from itertools import pairwise

from beltarm_env.task.seeds import MAX_TRAINING_SEED, RANGES, SEED_SPACING, TRAINING, training_arms


def test_ranges_are_disjoint():
    ordered = sorted(RANGES.values())
    assert len(ordered) > 10 and all(first.first + first.size <= second.first for first, second in pairwise(ordered))
    assert all(of.size > 0 for of in ordered)


def test_training_seeds_share_no_arm_and_fill_their_range():
    first, last = training_arms(0), training_arms(MAX_TRAINING_SEED)
    assert first.first == TRAINING.first and last.first + last.size == TRAINING.first + TRAINING.size
    assert training_arms(1).first == first.first + first.size == SEED_SPACING
