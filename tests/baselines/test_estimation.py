"""Observers against the truth: the Kalman filter of the encoder, and the one that feels with an accelerometer."""

from __future__ import annotations

from dataclasses import asdict, replace
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from baselines.estimation import believed_arm as arm_of
from baselines.estimation.felt import SPREAD, unfiltered
from baselines.estimation.felt_observer import felt_slopes, steady_felt_gain
from baselines.estimation.observer import QUANTUM, Noise, StickSlipObserver, kalman_gains
from baselines.models.linear import ANGLES, LinearArms, linear_arm
from baselines.reading import read
from baselines.registry import CONTROLLERS, FELT
from beltarm_env import CONTROL_PERIOD, ArmParams, BeltArmVectorEnv, design_model
from beltarm_env.arm import COLUMN
from beltarm_env.observation import decode
from beltarm_env.rollout import rollout
from beltarm_env.task.accelerometer import BIAS, RANGE
from eval.comparison.sets import development_set

Floats = NDArray[np.float64]
GEAR = 88.0
SEED = 5_210_000  # of the gains' search
STEPS = 1200


def single_arm(**settings: Any) -> BeltArmVectorEnv:
    return BeltArmVectorEnv(1, autoreset_mode="Disabled", **settings)


class TestObserver:
    def test_covariance_is_that_of_simulated_errors(self):
        # The linear arm driven by the noise that the filter is designed for, at 45 degrees.
        noise, k = Noise(1e-2, 30.0, 0.2), 22
        tables = [part[k] for part in linear_arm(ArmParams())]
        gain = kalman_gains(ArmParams(), noise)[k]
        transition = np.eye(5)
        transition[:4, :4], transition[:4, 4] = tables[0], tables[1]
        rng, count = np.random.default_rng(0), 4000
        error, squares = np.zeros((count, 5)), []
        for step in range(1500):
            error = error @ transition.T
            error[:, :4] += rng.normal(0, noise.torque, (count, 1)) * tables[1]
            error[:, :4] += rng.normal(0, noise.acceleration, (count, 1)) * tables[2]
            error[:, 4] += rng.normal(0, noise.disturbance * CONTROL_PERIOD**0.5, count)
            innovation = error[:, 0] + rng.normal(0, QUANTUM / 12**0.5, count)
            error -= innovation[:, None] * gain
            if step > 1400:
                squares.append(np.mean(error**2, axis=0))
        spread = np.sqrt(np.mean(squares, axis=0))
        worse = [np.sqrt(self.spread_of(gain * f, transition, tables, noise)) for f in (0.9, 1.0, 1.1)]
        np.testing.assert_allclose(spread, worse[1], rtol=0.05)
        assert (worse[1] < worse[0]).all() and (worse[1] < worse[2]).all(), "the Kalman gain is the best"

    @staticmethod
    def spread_of(gain: Floats, transition: Floats, tables: list[Floats], noise: Noise) -> Floats:
        """Steady-state variance of the estimate's errors under a gain, by iterating its Lyapunov equation."""
        drive = np.zeros((5, 5))
        drive[:4, :4] = noise.torque**2 * np.outer(tables[1], tables[1])
        drive[:4, :4] += noise.acceleration**2 * np.outer(tables[2], tables[2])
        drive[4, 4] = noise.disturbance**2 * CONTROL_PERIOD
        kept = np.eye(5) - np.outer(gain, [1, 0, 0, 0, 0])
        covariance = np.zeros((5, 5))
        for _ in range(6000):
            covariance = kept @ (transition @ covariance @ transition.T + drive) @ kept.T
            covariance += QUANTUM**2 / 12 * np.outer(gain, gain)
        return np.diag(covariance)

    def test_knows_the_torsion_behind_a_stuck_motor(self):
        env = single_arm(encoder_counts=4000)
        observer, estimate = StickSlipObserver(ArmParams()), None
        observations, _ = env.reset(seed=3)
        begins = np.array([True])
        rings = []
        for k in range(700):
            estimate = observer.update(estimate, read(observations, ArmParams()), begins)
            begins = np.array([False])
            if k > 400:
                assert env.state[0, 1] == 0.0, "stuck"
                rings.append((env.state[0, 2], estimate.state[0, 2]))
            torque = 0.12 if k < 150 else 0.0
            observations, *_ = env.step(np.array([[torque / 0.3]], np.float32))
        true, believed = np.array(rings).T
        assert np.ptp(true) > 0.01, "rings"
        assert np.abs(true - believed).max() < 0.03 * np.ptp(true)

    @staticmethod
    def observed(params: ArmParams, start: list[float], noise: Noise, command: Any, steps: int) -> list[Floats]:
        """True states, their estimates, and those for when a command acts: shapes (steps, 4)."""
        env = single_arm(encoder_counts=10_000_000)
        observations, _ = env.reset(options={"params": asdict(params), "state": start})
        observer, estimate, rows = StickSlipObserver(params, noise), None, []
        for k in range(steps):
            estimate = observer.update(estimate, read(observations, params), np.array([k == 0]))
            rows.append((env.state[0], estimate.state[0], estimate.ahead[0]))
            observations, *_ = env.step(np.array([[command(k) / 0.3]], np.float32))
        return [np.array(part) for part in zip(*rows, strict=True)]

    @pytest.mark.parametrize("latency", [0.0, 0.75, 2.9])
    def test_state_ahead_is_the_one_that_comes(self, latency: float):
        params = replace(design_model(), command_latency=latency * CONTROL_PERIOD)
        start = [GEAR * 0.8, 0.0, 0.0, 0.0]
        true, actual, ahead = self.observed(params, start, Noise(), lambda k: 0.15 if k < 60 else -0.15, 150)
        assert (np.abs(actual - true).max(axis=0) < [1e-4, 0.02, 1e-5, 2e-3]).all()
        late = latency + params.current_loop_time_constant / CONTROL_PERIOD
        whole, part = int(late), late - int(late)
        for first in (20, 80):  # where the command has not changed for a while
            later = true[first + whole : first + whole + 30], true[first + whole + 1 : first + whole + 31]
            expected = later[0] + part * (later[1] - later[0])
            errors = np.abs(ahead[first : first + 30] - expected).max(axis=0)
            assert (errors < [1e-3, 0.02, 1e-5, 2e-3]).all()


@cache
def followed() -> tuple[Floats, Floats, Floats, Any]:
    """States and readings of drawn arms at every sample, their constants, and the controller's memory at the end."""
    arms = 6
    env = BeltArmVectorEnv(arms, autoreset_mode="Disabled", randomization="train", sensors="accelerometer")
    observation, _ = env.reset(seed=SEED)
    controller, memory, states, felt = FELT["adaptive"](), None, [], []
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
        states, felt, table, _ = followed()
        moved = states.copy()
        moved[..., 0], moved[..., 2] = states[..., 1], states[..., 3]  # rates of the angles
        moved[..., 1] = moved[..., 3] = 0.0
        velocity = (tip(states + 1e-6 * moved, table) - tip(states - 1e-6 * moved, table)) / 2e-6
        mean, place = np.diff(velocity, axis=0) / CONTROL_PERIOD, tip(states[1:], table)
        along = place / np.linalg.norm(place, axis=-1, keepdims=True)
        turned = np.stack(
            [(mean * along).sum(-1), mean[..., 1] * along[..., 0] - mean[..., 0] * along[..., 1]], axis=-1
        )
        reported = np.array([unfiltered(now, before)[0].T for before, now in pairwise(felt)])
        errors = reported - turned
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
        single, process = np.eye(5), np.zeros((5, 5))
        single[:4, :4], single[:4, 4] = arm.transition, arm.by_torque
        for by_noise, deviation in ((arm.by_torque, 5e-3), (arm.by_acceleration, 0.3)):
            process[:4, :4] += deviation**2 * np.outer(by_noise, by_noise)
        process[4, 4] = 1e-6 * CONTROL_PERIOD
        transition, both = np.zeros((10, 10)), np.zeros((10, 10))
        transition[:5, :5], transition[5:, :5], both[:5, :5] = single, np.eye(5), process
        seen = np.zeros((3, 10))
        seen[0, 0], seen[1:, :4], seen[1:, 5:9] = 1.0, slopes, -slopes
        measured = np.diag([QUANTUM**2 / 12, *np.square(spread)])
        after, gain = np.diag([1e-6, 1e-2, 1e-6, 1e-2, 1e-4, *[0.0] * 5]), np.empty(0)
        for _ in range(6000):
            before = transition @ after @ transition.T + both
            gain = before @ seen.T @ np.linalg.inv(seen @ before @ seen.T + measured)
            after = before - gain @ seen @ before
        actual = steady_felt_gain(arm, slopes, self.noise, 1.0, spread)
        np.testing.assert_allclose(actual / np.abs(actual).max(0), gain[:5] / np.abs(actual).max(0), atol=1e-5)

    def test_an_accelerometer_that_tells_nothing_leaves_those_of_the_encoder(self):
        arm, slopes = self.arm(11)
        actual = steady_felt_gain(arm, slopes, self.noise, 1.0, (1e6, 1e6))
        np.testing.assert_allclose(actual[:, 0], kalman_gains(design_model(), self.noise)[11], rtol=1e-5)
        assert np.abs(actual[:, 1:]).max() < 1e-6


class TestKnowledge:
    def test_kinematic_error_and_zero_g_output_are_found(self):
        _, felt, table, memory = followed()
        size, phase = table[:, COLUMN.kinematic_error], table[:, COLUMN.kinematic_error_phase]
        z = memory.belief.tracks.mean.T
        np.testing.assert_allclose(z[arm_of.ERROR_SINE], size * np.cos(phase), atol=8e-6)
        np.testing.assert_allclose(z[arm_of.ERROR_COSINE], size * np.sin(phase), atol=8e-6)
        assert size.max() > 2e-4
        np.testing.assert_allclose(z[arm_of.BIAS :].T, felt[0], atol=4 * SPREAD)  # at rest, but for its noise
        assert np.sqrt(memory.belief.variance[:, arm_of.BIAS :]).max() < 0.5 * SPREAD

    def test_with_an_accelerometer_the_torsion_is_known_better_and_the_arm_vibrates_less(self):
        error, cost, ringing = [], [], []
        arms = development_set().splits["randomized"].arguments(slice(16))
        for make, sensors in ((CONTROLLERS["adaptive"], "encoder"), (FELT["adaptive"], "accelerometer")):
            noted = Noted(make())
            run = rollout(noted, 16, **{**arms, "sensors": sensors})
            error.append(np.std(np.array(noted.torsions[1:]) - run.state[:-1, :, 2]))
            cost.append(run.cost)
            ringing.append(run.metrics()["residual_pp_mm"].mean())
        assert error[1] < 0.4 * error[0]
        assert np.median(cost[1] - cost[0]) < 0 and ringing[1] < 0.9 * ringing[0]


class Noted:
    """Controller whose estimates of the torsion are kept."""

    def __init__(self, controller: Any) -> None:
        self.controller, self.params = controller, controller.params
        self.torsions: list[Floats] = []

    def predict(self, *arguments: Any, **named: Any) -> Any:
        action, memory = self.controller.predict(*arguments, **named)
        self.torsions.append(memory.belief.state[:, 2])
        return action, memory
