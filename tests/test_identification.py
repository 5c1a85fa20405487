"""The identification: constants of the arm, delay and resolution of its encoder."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from baselines import CONTROLLERS
from baselines.estimation.arm_ekf import IDENTIFIED
from baselines.estimation.identification import ArmIdentifier, common_count
from baselines.optimal.adaptive import AdaptiveController
from baselines.reading import read
from beltarm_env import EPISODE_STEPS, ArmParams, BeltArmVectorEnv
from beltarm_env.arm import params_table
from beltarm_env.rollout import rollout

SEED = 5_000_000


def batch(count: int, seed: int = SEED, **settings: Any) -> BeltArmVectorEnv:
    env = BeltArmVectorEnv(count, autoreset_mode="Disabled", **settings)
    env.reset(seed=seed)
    return env


class TestArm:
    @pytest.mark.parametrize("payload", [0.0, 0.2])
    @pytest.mark.parametrize("stiffness", [28.0, 38.0])
    def test_finds_payload_and_stiffness_while_moving(self, payload: float, stiffness: float):
        options = {
            "params": {"payload_mass": payload, "belt_stiffness": stiffness},
            "move": {"start": 0.2, "goal": 1.4, "duration": 1.0, "ramp_time": 0.2},
        }
        env = batch(1)
        observations, _ = env.reset(seed=0, options=options)
        controller, memory = AdaptiveController(), None
        for _ in range(EPISODE_STEPS):
            action, memory = controller.predict(observations, memory)
            observations, *_ = env.step(action)
        assert memory is not None
        logs = dict(zip(IDENTIFIED, memory.belief.logs[0].tolist(), strict=True))
        assert 33 * math.exp(logs["belt_stiffness"]) == pytest.approx(stiffness, rel=0.08)
        assert 0.06 * math.exp(logs["arm_inertia_swing"]) == pytest.approx(0.06 + 0.25 * payload, rel=0.12)

    def test_learns_nothing_from_an_arm_at_rest(self):
        env = batch(1)
        observations, _ = env.reset(seed=1)
        identifier, belief = ArmIdentifier(ArmParams()), None
        for _ in range(200):
            belief = identifier.update(belief, read(observations, ArmParams()), np.array([belief is None]))
            observations, *_ = env.step(np.zeros((1, 1), np.float32))
        assert belief is not None
        np.testing.assert_allclose(belief.logs, 0.0, atol=1e-6)
        np.testing.assert_allclose(identifier.table(belief), params_table([ArmParams()]), rtol=1e-6)


class TestEncoder:
    @pytest.mark.parametrize("delay", [0, 1, 2])
    @pytest.mark.parametrize("counts", [4000, 1500, 1000])
    def test_finds_delay_and_resolution_of_the_encoder_on_arms_that_differ(self, delay: int, counts: int):
        env = batch(24, randomization="ideal", delay=delay, encoder_counts=counts)
        observations, _ = env.reset(seed=SEED)
        controller, memory = CONTROLLERS["adaptive"](), None
        for _ in range(100):
            action, memory = controller.predict(observations, memory)
            observations, *_ = env.step(action)
        assert memory is not None
        assert (memory.belief.delay == delay).all()
        np.testing.assert_allclose(memory.belief.count, 2 * np.pi / counts, rtol=0.05)

    @pytest.mark.parametrize("delay", [1, 2])
    def test_believes_in_the_state_now_not_in_the_one_that_it_reads(self, delay: int):
        env = batch(8, randomization="ideal", delay=delay)
        observations, _ = env.reset(seed=SEED)
        controller, memory, errors = CONTROLLERS["adaptive"](), None, []
        for _ in range(400):
            action, memory = controller.predict(observations, memory)
            late = np.abs(read(observations, ArmParams()).motor_angle - env.state[:, 0])
            errors.append((np.abs(memory.belief.state[:, 0] - env.state[:, 0]), late))
            observations, *_ = env.step(action)
        believed, read_late = np.array(errors)[100:].mean(axis=(0, 2))
        assert believed < 0.05 * read_late

    def test_a_late_coarse_encoder_costs_it_little(self):
        good = rollout(CONTROLLERS["adaptive"](), 24, seed=SEED, randomization="ideal").cost
        bad = rollout(
            CONTROLLERS["adaptive"](), 24, seed=SEED, randomization="ideal", delay=2, encoder_counts=1000
        ).cost
        assert bad.mean() < 1.15 * good.mean()

    def test_a_batch_of_late_encoders_is_bit_for_bit_as_single_arms(self):
        together = rollout(CONTROLLERS["adaptive"](), 5, seed=SEED, randomization="ideal", delay=2, encoder_counts=1000)
        for arm in range(5):
            alone = rollout(
                CONTROLLERS["adaptive"](), 1, seed=SEED + arm, randomization="ideal", delay=2, encoder_counts=1000
            )
            np.testing.assert_array_equal(together.torque[:, arm], alone.torque[:, 0])

    @given(
        counts=st.integers(500, 4000),
        moves=st.lists(st.integers(-6, 6), min_size=4, max_size=30).filter(lambda m: {1, -1} & set(m)),
    )
    def test_resolution_is_the_common_divisor_of_what_the_encoder_moves(self, counts: int, moves: list[int]):
        quantum = 2 * math.pi / counts
        count = np.zeros(1)
        for move in moves:
            count = common_count(count, np.array([abs(move) * quantum]))
        assert count[0] == pytest.approx(quantum, rel=1e-6)
