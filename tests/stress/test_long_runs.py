"""Whole episodes under adversarial torques: arms of a batch as arms alone, and the same on another processor."""

import hashlib
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from commands import ROOT, python
from episodes import assert_as_alone
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from beltarm_env import BeltArmEnv, BeltArmVectorEnv
from beltarm_env.arrays import Singles
from beltarm_env.engine import building
from beltarm_env.observation import SENSORS
from beltarm_env.task.reference import PROFILES

ARMS, STEPS = 140, 1300  # more than a block, and than an episode
TORQUES: dict[str, Callable[[Singles, BeltArmVectorEnv], Any]] = {
    "noise": lambda noise, env: noise,
    "full": lambda noise, env: np.sign(noise),
    "with the belt": lambda noise, env: np.sign(env.state[:, 3:]),  # drives its vibration
    "against the motor": lambda noise, env: -np.sign(env.state[:, 1:2]),  # stops and starts it
    "huge": lambda noise, env: 1e30 * noise,
}
"""Torques over their limits, shape (arms, 1)."""
CHOICES = {
    **{"sensors": SENSORS, "profile": sorted(PROFILES), "model": ["lumped", "lagrangian"]},
    **{"randomization": ["train", "ideal"], "encoder_counts": [1, 100, 4000, 10_000_000]},
}
SETTINGS = {name: st.sampled_from(values) for name, values in CHOICES.items()} | {"delay": st.floats(0, 2)}


def torques(kind: str, env: BeltArmVectorEnv, seed: int, steps: int) -> Iterator[Singles]:
    """Torques of a kind as the arms move, whose states stay finite."""
    rng = np.random.default_rng(seed)
    for _ in range(steps):
        noise = rng.uniform(-1, 1, (env.num_envs, 1)).astype(np.float32)
        yield np.asarray(TORQUES[kind](noise, env), np.float32)
        assert np.isfinite(env.state).all() and np.isfinite(env.motor_torques).all()


@pytest.mark.parametrize("kind", TORQUES)
def test_arms_of_a_batch_are_arms_alone(kind: str):
    @examples(10, shrink=False)
    @given(st.fixed_dictionaries(SETTINGS), st.integers(0, 2**31), st.integers(1, 2))
    def run(settings: dict[str, Any], seed: int, threads: int) -> None:
        batch = BeltArmVectorEnv(ARMS, **settings, autoreset_mode="SameStep", num_threads=threads)
        arms = (0, 77, ARMS - 1)
        alone = [BeltArmEnv(**settings) for _ in arms]
        assert assert_as_alone(batch, alone, torques(kind, batch, seed, STEPS), seed, arms) >= len(arms)

    run()


def digest() -> str:
    total = hashlib.sha256()
    for kind in TORQUES:
        env = BeltArmVectorEnv(ARMS, randomization="train", sensors="accelerometer", delay=1.3)
        total.update(env.reset(seed=3)[0].tobytes())
        for torque in torques(kind, env, 3, 300):
            total.update(env.step(torque)[0].tobytes() + env.state.tobytes())
    return total.hexdigest()


def test_a_processor_without_wide_vectors_gives_the_same_bits():
    code = "from tests.stress.test_long_runs import digest; print(digest())"
    path = ROOT, ROOT / "tests" / "helpers"
    assert python("-c", code, path=path, BELTARM_LEVEL=building.baseline()).strip() == digest()
