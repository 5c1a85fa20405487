"""Seeds: nobody draws another's arms; and the streams of random numbers that they begin."""

from itertools import pairwise

import numpy as np
from gymnasium.utils import seeding
from hypothesis import given
from hypothesis import strategies as st
from properties import examples
from refusals import refused

from beltarm_env import BeltArmVectorEnv
from beltarm_env.task import seeds
from beltarm_env.task.streams import checked_seed, draw, seeded, wrapping


def test_ranges_are_disjoint():
    ordered = sorted(seeds.RANGES.values())
    assert len(ordered) > 10 and all(each.size > 0 for each in ordered)
    assert all(before.first + before.size <= after.first for before, after in pairwise(ordered))
    assert ordered[-4:] == [seeds.FRESH, seeds.TEST, seeds.UNUSED, seeds.FURTHER]
    assert all(before.first + before.size == after.first for before, after in pairwise(ordered[-4:]))
    assert seeds.FURTHER.first + seeds.FURTHER.size < 2**63
    assert seeds.training_arms(0).size == seeds.SEED_SPACING and seeds.fresh_arms(0).size == seeds.DEVELOPMENT.size


def test_seeds_share_no_arm_and_fill_their_range():
    digits = [part + 32 * "f" for part in ("00000000", "00000001", "ffffffff")]
    for arms, whole in (
        ([seeds.training_arms(k) for k in (0, 1, seeds.MAX_TRAINING_SEED)], seeds.TRAINING),
        ([seeds.dataset_arms(k) for k in (0, 1, seeds.MAX_DATASET_SEED)], seeds.DATASETS),
        ([seeds.fresh_arms(k) for k in (0, 1, seeds.MAX_FRESH_SEED)], seeds.FRESH),
        ([seeds.further_arms(k) for k in (0, 1, seeds.MAX_FRESH_SEED)], seeds.FURTHER),
        ([seeds.arms_chosen_by(digit) for digit in digits], seeds.TEST),
    ):
        first, second, last = arms
        assert first.first == whole.first and second.first == first.first + first.size
        assert last.first + last.size == whole.first + whole.size


def test_what_is_no_hash_or_seed_is_refused():
    for no_hash in ("", "abc1234", "g" * 40, "A" * 40):
        refused(ValueError, ("40 hexadecimal digits",), lambda no_hash=no_hash: seeds.arms_chosen_by(no_hash))
    refused(ValueError, ("0 to 99", "100"), lambda: seeds.training_arms(100))
    for seed in (-1, 1.0, True, "3", None):
        refused(ValueError, ("seed ", ", got"), lambda seed=seed: checked_seed(seed))


class TestStreams:
    @examples(60)
    @given(st.lists(st.integers(0, 2**140) | st.integers(0, 2**40), min_size=1, max_size=4), st.integers(1, 40))
    def test_are_those_of_gymnasiums_generators(self, seeds: list[int], count: int):
        streams, order = seeded(seeds), np.arange(len(seeds))[::-1]
        generators = [seeding.np_random(seed)[0] for seed in seeds]
        for _ in range(2):
            drawn = np.empty((len(seeds), count))
            with wrapping():
                draw(streams, order, drawn)
            np.testing.assert_array_equal(drawn, [generators[i].random(count) for i in order])

    def test_a_batch_tells_the_seed_of_each_and_gives_no_generator(self):
        batch = BeltArmVectorEnv(2)
        unseeded = batch.np_random_seed
        first = batch.reset()[0]
        assert batch.np_random_seed == unseeded and np.array_equal(batch.reset(seed=unseeded)[0], first)
        batch.reset(seed=[7, None])
        assert batch.np_random_seed == (7, unseeded[1]) and batch.reset(seed=3) and batch.np_random_seed == (3, 4)
        refused(AttributeError, ("np_random", "reset(seed="), lambda: batch.np_random)
        refused(AttributeError, ("np_random", "reset(seed="), lambda: setattr(batch, "np_random", None))

    def test_of_a_large_batch_begin_as_those_of_arms_alone(self):
        batch = BeltArmVectorEnv(5000, randomization="train")
        observations, _ = batch.reset(seed=7)
        for arm in (0, 4095, 4096, 4999):
            alone = BeltArmVectorEnv(1, randomization="train")
            assert (alone.reset(seed=7 + arm)[0][0] == observations[arm]).all()
            assert (alone.params_table[0] == batch.params_table[arm]).all()
