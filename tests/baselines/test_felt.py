"""Accelerometer in the filters: its measurement equation, and what it tells of the arm."""

from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from agents.policy.bundle import FELT_POLICIES, read_spec
from baselines import CONTROLLERS
from baselines.estimation import believed_arm as arm_of
from baselines.estimation.felt import SPREAD, unfiltered
from baselines.estimation.felt_observer import felt_gains, felt_slopes, steady_felt_gain
from baselines.estimation.observer import QUANTUM, Noise, kalman_gains
from baselines.models.linear import ANGLES, LinearArms, linear_arm
from baselines.registry import FELT
from beltarm_env import CONTROL_PERIOD, ArmParams, BeltArmVectorEnv, design_model
from beltarm_env.arm import COLUMN
from beltarm_env.observation import decode
from beltarm_env.rollout import rollout
from beltarm_env.task.accelerometer import BIAS, RANGE
from eval.comparison.methods import learned_methods, shipped_policies

Floats = NDArray[np.float64]
SEED = 5_210_000  # of the gains' search
STEPS = 1200


@cache
def followed(name: str, arms: int = 6) -> tuple[Floats, Floats, Floats, Any]:
    """States and readings of drawn arms at every sample, their constants, and the controller's memory at the end."""
    env = BeltArmVectorEnv(arms, autoreset_mode=AutoresetMode.DISABLED, randomization="train", sensors="accelerometer")
    observation, _ = env.reset(seed=SEED)
    controller, memory, states, felt = FELT[name](), None, [], []
    for _ in range(STEPS - 1):
        seen = decode(observation, "accelerometer")
        felt.append(np.stack([seen["tip_acceleration_along"], seen["tip_acceleration_across"]], axis=1))
        states.append(env.state)
        action, memory = controller.predict(observation, memory, np.full(arms, memory is None))
        observation = env.step(action)[0]
    return np.array(states), np.array(felt), env.params_table, memory


def tip(states: Floats, table: Floats) -> Floats:
    """Position of the end by the planar arm's kinematics, the joint's kinematic error included; (..., n, 2) [m]."""
    angle, torsion = states[..., 0] / table[:, COLUMN.gear_ratio], states[..., 2]
    error = table[:, COLUMN.kinematic_error] * np.sin(2 * states[..., 0] + table[:, COLUMN.kinematic_error_phase])
    reach = 2 * table[:, COLUMN.link_length] * np.cos(angle - torsion) + table[:, COLUMN.hand_length]
    return np.stack([reach * np.cos(torsion + error), reach * np.sin(torsion + error)], axis=-1)


class TestMeasurementEquation:
    def test_readings_are_accelerations_of_the_tip_with_a_constant_and_white_noise(self):
        """Of drawn arms that move: the tip's velocity by finite differences of its place."""
        states, felt, table, _ = followed("adaptive")
        moved = states.copy()
        moved[..., 0], moved[..., 2] = states[..., 1], states[..., 3]  # rates of the angles
        moved[..., 1] = moved[..., 3] = 0.0
        velocity = (tip(states + 1e-6 * moved, table) - tip(states - 1e-6 * moved, table)) / 2e-6
        mean, place = np.diff(velocity, axis=0) / CONTROL_PERIOD, tip(states[1:], table)
        along = place / np.linalg.norm(place, axis=-1, keepdims=True)
        turned = np.stack(
            [(mean * along).sum(-1), mean[..., 1] * along[..., 0] - mean[..., 0] * along[..., 1]], axis=-1
        )
        told = np.array([unfiltered(now, before)[0].T for before, now in pairwise(felt)])
        errors = told - turned
        assert np.abs(turned[..., 1]).max() > 30 * SPREAD and np.abs(turned[..., 0]).max() > 10 * SPREAD
        assert np.abs(errors.mean(0)).max() < BIAS
        assert errors.std(0) == pytest.approx(SPREAD, rel=0.08)
        white = errors - errors.mean(0)
        assert np.abs((white[1:] * white[:-1]).mean(0) / white.var(0)).max() < 0.2

    def test_a_reading_that_is_cut_off_tells_nothing(self):
        now = np.array([[1.0, RANGE], [1.0, 2.0]])
        _, variance = unfiltered(now, np.ones((2, 2)))
        assert variance[0] == pytest.approx(SPREAD**2)
        assert variance[1, 1] == pytest.approx(SPREAD**2) and variance[1, 0] > 1e5

    def test_slopes_at_rest_are_those_of_the_kinematics(self):
        plant, angle = ArmParams().plant(), 0.9
        reach = plant.double_link * np.cos(angle) + plant.hand
        along = -plant.double_link * np.sin(angle) * np.array([0, plant.inverse_gear, 0, -1]) / CONTROL_PERIOD
        across = np.array([0, 0, 0, reach]) / CONTROL_PERIOD
        np.testing.assert_allclose(felt_slopes(angle, plant), [along, across], rtol=1e-6, atol=1e-6)


class TestGains:
    """Steady-state gains of the observer with three readings."""

    noise = Noise(torque=5e-3, acceleration=0.3, disturbance=1e-3)

    def arm(self, k: int) -> tuple[LinearArms, Floats]:
        params = design_model()
        return LinearArms(*(part[k] for part in linear_arm(params))), felt_slopes(ANGLES[k], params.plant())

    def test_are_those_of_a_filter_that_also_keeps_the_state_before(self):
        """A Kalman filter of [z[k]; z[k-1]], run until it is steady, has uncorrelated noise and no such formula."""
        k, spread = 20, (SPREAD, 3 * SPREAD)
        arm, slopes = self.arm(k)
        one, process = np.eye(5), np.zeros((5, 5))
        one[:4, :4], one[:4, 4] = arm.transition, arm.by_torque
        for by_noise, deviation in ((arm.by_torque, 5e-3), (arm.by_acceleration, 0.3)):
            process[:4, :4] += deviation**2 * np.outer(by_noise, by_noise)
        process[4, 4] = 1e-6 * CONTROL_PERIOD
        transition, both = np.zeros((10, 10)), np.zeros((10, 10))
        transition[:5, :5], transition[5:, :5], both[:5, :5] = one, np.eye(5), process
        seen = np.zeros((3, 10))
        seen[0, 0], seen[1:, :4], seen[1:, 5:9] = 1.0, slopes, -slopes
        measured = np.diag([QUANTUM**2 / 12, *np.square(spread)])
        after, gain = np.diag([1e-6, 1e-2, 1e-6, 1e-2, 1e-4, *[0.0] * 5]), np.empty(0)
        for _ in range(6000):
            before = transition @ after @ transition.T + both
            gain = before @ seen.T @ np.linalg.inv(seen @ before @ seen.T + measured)
            after = before - gain @ seen @ before
        found = steady_felt_gain(arm, slopes, self.noise, 1.0, spread)
        np.testing.assert_allclose(found / np.abs(found).max(0), gain[:5] / np.abs(found).max(0), atol=1e-5)

    def test_an_accelerometer_that_tells_nothing_leaves_those_of_the_encoder(self):
        arm, slopes = self.arm(11)
        found = steady_felt_gain(arm, slopes, self.noise, 1.0, (1e6, 1e6))
        np.testing.assert_allclose(found[:, 0], kalman_gains(design_model(), self.noise)[11], rtol=1e-5)
        assert np.abs(found[:, 1:]).max() < 1e-6

    def test_a_motor_that_sticks_stays_where_it_is(self):
        slides, sticks = felt_gains(design_model(), self.noise)
        assert not sticks[:, [1, 4]].any() and not sticks[:, 0, 1:].any()
        assert (np.abs(sticks[:, 3, 2]) > 0).all(), "what is felt across the hand tells the torsion's rate"
        across = np.abs(slides[:, :, 3, 2])
        assert (np.diff(across, axis=1) < 0).all(), "the faster the motor, the more the kinematic error is felt"


class TestKnowledge:
    def test_kinematic_error_and_zero_g_output_are_found(self):
        _, felt, table, memory = followed("adaptive")
        size, phase = table[:, COLUMN.kinematic_error], table[:, COLUMN.kinematic_error_phase]
        z = memory.belief.tracks.mean.T
        np.testing.assert_allclose(z[arm_of.ERROR_SINE], size * np.cos(phase), atol=8e-6)
        np.testing.assert_allclose(z[arm_of.ERROR_COSINE], size * np.sin(phase), atol=8e-6)
        assert size.max() > 2e-4
        np.testing.assert_allclose(z[arm_of.BIAS :].T, felt[0], atol=4 * SPREAD)  # at rest, but for its noise
        assert np.sqrt(memory.belief.variance[:, arm_of.BIAS :]).max() < 0.5 * SPREAD

    def test_errors_are_as_large_as_the_filter_believes(self):
        """It may believe them larger: its gains are the encoder's, with noise for a model that is often wrong."""
        states, _, _, memory = followed("adaptive")
        errors = memory.belief.state - states[-1]
        shares = errors[:, 2:] ** 2 / memory.belief.variance[:, 2:4]
        assert shares.max() < 9 and np.median(shares) > 0.005


class TestControllers:
    @pytest.mark.parametrize("name", FELT)
    def test_one_arm_alone_moves_as_in_a_batch(self, name: str):
        arguments: dict[str, Any] = {"seed": SEED, "sensors": "accelerometer", "randomization": "train"}
        batch, alone = rollout(FELT[name](), 3, **arguments), rollout(FELT[name](), 1, **arguments)
        np.testing.assert_array_equal(batch.torque[:, :1], alone.torque)

    @pytest.mark.parametrize("name", FELT)
    def test_a_new_episode_begins_without_memory_of_the_last(self, name: str):
        env = BeltArmVectorEnv(2, autoreset_mode=AutoresetMode.DISABLED, sensors="accelerometer")
        controller, torques = FELT[name](), []
        memory: Any = None
        for _ in range(2):
            observation, _ = env.reset(seed=SEED)
            start, done = np.ones(2, np.bool_), []
            for _ in range(80):
                action, memory = controller.predict(observation, memory, start)
                observation, start = env.step(action)[0], np.zeros(2, np.bool_)
                done.append(action)
            torques.append(np.array(done))
        np.testing.assert_array_equal(*torques)

    @pytest.mark.parametrize("name", FELT)
    def test_without_the_sensor_there_is_a_remedy(self, name: str):
        with pytest.raises(ValueError, match="use an environment with sensors='accelerometer'"):
            rollout(FELT[name](), 1, seed=1)

    def test_they_are_not_ranked_with_the_others(self):
        assert set(FELT) <= set(CONTROLLERS)
        assert all(CONTROLLERS[name]().sensors == "encoder" for name in FELT)
        assert all(FELT[name]().gains == CONTROLLERS[name]().gains for name in FELT)

    def test_the_student_that_has_it_is_not_ranked_either(self):
        (folder,) = FELT_POLICIES.glob("*/*")
        assert read_spec(folder)[0].sensors == "accelerometer" and folder not in shipped_policies()
        with pytest.raises(ValueError, match="the comparison gives all methods the encoder alone"):
            learned_methods([folder])
