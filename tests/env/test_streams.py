import numpy as np
import pytest
from gymnasium.utils import seeding
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from beltarm_env import BeltArmVectorEnv
from beltarm_env.task.streams import checked_seed, draw, seeded, wrapping


@examples(60)
@given(st.lists(st.integers(0, 2**140) | st.integers(0, 2**40), min_size=1, max_size=4), st.integers(1, 40))
def test_streams_are_those_of_gymnasiums_generators(seeds: list[int], count: int):
    streams, order = seeded(seeds), np.arange(len(seeds))[::-1]
    generators = [seeding.np_random(seed)[0] for seed in seeds]
    for _ in range(2):
        drawn = np.empty((len(seeds), count))
        with wrapping():
            draw(streams, order, drawn)
        np.testing.assert_array_equal(drawn, [generators[i].random(count) for i in order])


def test_streams_that_are_not_chosen_stay():
    streams = seeded([3, 4, 5])
    before = streams.copy()
    with wrapping():
        draw(streams, np.array([1]), np.empty((1, 7)))
    assert np.array_equal(streams[[0, 2]], before[[0, 2]])
    assert not np.array_equal(streams[1], before[1])


@pytest.mark.parametrize("seed", [-1, 1.0, True, "3", None])
def test_seeds_that_are_none(seed: object):
    with pytest.raises(ValueError, match="seed must be a whole number of at least 0, got"):
        checked_seed(seed)


def test_a_large_batch_begins_as_arms_alone_do():
    """More arms than draw at once."""
    batch = BeltArmVectorEnv(5000, randomization="train")
    observations, _ = batch.reset(seed=7)
    for arm in (0, 4095, 4096, 4999):
        alone = BeltArmVectorEnv(1, randomization="train")
        assert (alone.reset(seed=7 + arm)[0][0] == observations[arm]).all()
        assert (alone.params_table[0] == batch.params_table[arm]).all()
