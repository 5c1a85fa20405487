"""Encoder, index pulse, tachometer, accelerometer and delay: their parts, and what the environment shows of them."""

import math
from typing import Any

import numpy as np
import pytest
from gymnasium.utils import seeding
from scipy.interpolate import CubicHermiteSpline
from scipy.stats import kstest

from baselines import CONTROLLERS
from beltarm_env import CONTROL_PERIOD, BeltArmEnv, observation
from beltarm_env.arrays import Floats
from beltarm_env.rollout import rollout
from beltarm_env.task.accelerometer import BANDWIDTH, NOISE, RANGE, bias_of, noise, noise_seed
from beltarm_env.task.draws import DRAWS, FIRST_OF_SENSORS

GEAR = 88.0
RESOLUTION = 2 * math.pi / 4000
STEPS = 400
NAMES = ("tip_acceleration_along", "tip_acceleration_across")
TAU = 1 / (2 * math.pi * BANDWIDTH)
MOVE = {"start": 0.3, "goal": 1.2, "duration": 1.0, "ramp_time": 0.3}


@pytest.fixture(scope="module")
def series() -> Floats:
    """Noise of shape (seeds, samples, axes)."""
    seeds = [noise_seed(u) for u in np.random.default_rng(0).random(40)]
    return np.array([[[noise(seed, float(k), axis) for axis in (0, 1)] for k in range(600)] for seed in seeds])


class TestNoise:
    def test_is_the_sum_of_four_uniform_numbers_white_and_of_its_own_on_each_axis_and_episode(self, series: Floats):
        values = series.ravel()
        assert abs(values.mean()) < 4 / math.sqrt(len(values))
        assert values.std() == pytest.approx(1, abs=4 / math.sqrt(2 * len(values)))
        sums = np.random.default_rng(1).random((200_000, 4)).sum(axis=1)
        assert kstest(values, (sums - 2) / math.sqrt(1 / 3)).pvalue > 0.01
        near = np.array([[noise(seed, float(k), 0) for k in range(400)] for seed in (123456.0, 123457.0)])
        neighbours = (series[:, 1:], series[:, :-1]), (series[:, 2:], series[:, :-2]), (series[1:], series[:-1])
        axes = (series[..., 0], series[..., 1]), (series[:, 1:, 0], series[:, :-1, 1])
        for a, b in (*neighbours, *axes, near):
            assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 4 / math.sqrt(a.size)


class Record:
    """States and observations (in physical units) of an episode, row 0 at its start."""

    def __init__(self, state: Floats | None = None, params: dict[str, float] | None = None, **settings: Any) -> None:
        env = BeltArmEnv(**settings)
        options: dict[str, Any] = {"move": MOVE, "params": params or {}} | ({} if state is None else {"state": state})
        first, _ = env.reset(seed=1, options=options)
        states, seen = [env.state], [first]
        for k in range(STEPS):
            torque = 0.5 * math.sin(0.02 * k) + 0.3 * math.sin(0.11 * k)  # to and fro
            result, _, terminated, _, _ = env.step(np.array([torque], np.float32))
            assert not terminated
            states.append(env.state)
            seen.append(result)
        self.times = CONTROL_PERIOD * np.arange(STEPS + 1)
        self.states, self.seen = np.array(states), observation.decode(np.array(seen), env.sensors)
        self.reference = np.array([env.reference(time) for time in self.times])

    def counts(self, resolution: float = RESOLUTION) -> Floats:
        """Encoder counts recovered from the tracking error, and equal to those of the angle."""
        counts = (GEAR * self.reference[:, 0] - self.seen["motor_angle_error"]) / resolution
        # float32 keeps 6e-8 of an error of up to 80 rad: 0.003 of 4000 counts per turn
        np.testing.assert_allclose(counts, np.rint(counts), atol=0.1)
        np.testing.assert_allclose(self.seen["motor_angle"] / resolution, np.rint(counts), atol=0.3)
        return np.rint(counts)

    def course(self, column: int, times: Any, order: int = 0) -> Floats:
        """Angle or torsion at any time; before the episode the motor moved as fast as at its start."""
        spline = CubicHermiteSpline(self.times, self.states[:, column], self.states[:, column + 1])
        start, speed = self.states[0, column : column + 2]
        earlier = start + speed * times if order == 0 else np.full_like(times, speed)
        return np.where(times < 0, earlier, spline(times, order))


def tip_velocity(states: Floats) -> tuple[Floats, Floats]:
    """Velocity of the nominal arm's end along x and y for states of shape (4, n)."""
    theta_a, omega_a, theta_s, omega_s = states
    phi, phi_dot = theta_a / GEAR - theta_s, omega_a / GEAR - omega_s
    away, around = -0.5 * np.sin(phi) * phi_dot, (0.5 * np.cos(phi) + 0.1) * omega_s
    return away * np.cos(theta_s) - around * np.sin(theta_s), away * np.sin(theta_s) + around * np.cos(theta_s)


MOVING = np.array([GEAR * 0.6, 40.0, 0.02, -0.5])


class TestThroughTheEnvironment:
    @pytest.mark.parametrize(
        ("delay", "per_turn", "state"), [(0, 4000, None), (0.4, 4000, MOVING), (1, 1000, None), (1.75, 20_000, MOVING)]
    )
    def test_encoder_counts_late_and_is_known_by_nothing_else(self, delay: float, per_turn: int, state: Floats | None):
        record, resolution = Record(state, encoder_counts=per_turn, delay=delay), 2 * math.pi / per_turn
        prompt = Record(state)
        np.testing.assert_array_equal(record.states, prompt.states, "the encoder does not act back on the arm")
        exact = record.course(0, np.append(-CONTROL_PERIOD, record.times) - CONTROL_PERIOD * delay) / resolution
        decided = np.abs(exact - np.floor(exact) - 0.5) > 1e-6
        counts, expected = record.counts(resolution), np.rint(exact)
        np.testing.assert_array_equal(counts[decided[1:]], expected[1:][decided[1:]])
        assert decided.mean() > 0.99 and np.ptp(expected) > per_turn / 4, "the motor does turn"
        speed = np.diff(np.append(expected[0], counts)) * resolution / CONTROL_PERIOD
        np.testing.assert_allclose(record.seen["motor_speed"], speed, rtol=1e-6, atol=1e-9)
        error = GEAR * record.reference[:, 1] - speed
        np.testing.assert_allclose(record.seen["motor_speed_error"], error, rtol=1e-6, atol=1e-4)
        for name, function in (("sin_2_motor_angle", np.sin), ("cos_2_motor_angle", np.cos)):
            np.testing.assert_allclose(record.seen[name], function(2 * counts * resolution), atol=1e-6)
        for name in ("reference_angle", "reference_speed", "elapsed_time", "last_command"):
            np.testing.assert_array_equal(record.seen[name], prompt.seen[name], "known entries are not late")

    @pytest.mark.parametrize(("delay", "state"), [(0, MOVING), (0.3, None), (1, None), (1.999, MOVING)])
    def test_tachometer_at_the_tip(self, delay: float, state: Floats | None):
        record, whole = Record(state, sensors="tip", delay=delay), math.ceil(delay)
        late = record.times[whole:] - CONTROL_PERIOD * delay
        states = np.stack([record.course(column, late, order) for column in (0, 2) for order in (0, 1)])
        x_speed, _ = tip_velocity(states)
        np.testing.assert_allclose(record.seen["tip_speed"][whole:], x_speed, rtol=1e-5, atol=1e-6)
        assert np.abs(x_speed).max() > 0.1

    def test_true_torsion_is_neither_rounded_nor_late(self):
        record = Record(params={"kinematic_error": 3e-4, "kinematic_error_phase": 0.7}, sensors="full", delay=2)
        angle, speed, torsion, torsion_speed = record.states.T
        phase = 2 * angle + 0.7
        np.testing.assert_allclose(record.seen["torsion"], torsion + 3e-4 * np.sin(phase), rtol=1e-6, atol=1e-7)
        rate = torsion_speed + 6e-4 * np.cos(phase) * speed
        np.testing.assert_allclose(record.seen["torsion_speed"], rate, rtol=1e-6, atol=1e-6)


class TestAccelerometerInTheEnvironment:
    @pytest.mark.parametrize("delay", [0, 0.4, 2])
    def test_shows_the_low_passed_acceleration_late(self, delay: float):
        record, whole = Record(MOVING, sensors="accelerometer", delay=delay), math.floor(delay)
        draw, *biases = seeding.np_random(1)[0].random(DRAWS)[FIRST_OF_SENSORS:][:3]
        read = np.maximum(record.times - (delay - whole) * CONTROL_PERIOD, 0.0)
        states = np.stack([record.course(column, read, order) for column in (0, 2) for order in (0, 1)])
        velocity, decay = np.stack(tip_velocity(states), axis=1), math.exp(-CONTROL_PERIOD / TAU)
        filtered = np.zeros_like(velocity)
        for k in range(STEPS):
            mean = (velocity[k + 1] - velocity[k]) / CONTROL_PERIOD
            filtered[k + 1] = mean + (filtered[k] - mean) * decay
        cosine, sine = np.cos(states[2]), np.sin(states[2])
        axes = filtered[:, 0] * cosine + filtered[:, 1] * sine, filtered[:, 1] * cosine - filtered[:, 0] * sine
        for axis, (name, true) in enumerate(zip(NAMES, axes, strict=True)):
            assert np.abs(true).max() > 5
            noises = [noise(noise_seed(draw), float(k + 2), axis) for k in range(-whole, STEPS + 1 - whole)]
            shown = np.concatenate([np.zeros(whole), true[: STEPS + 1 - whole]])
            expected = np.clip(shown + bias_of(biases[axis]) + NOISE * np.array(noises), -RANGE, RANGE)
            np.testing.assert_allclose(record.seen[name], expected, rtol=1e-6, atol=1e-5)

    def test_every_episode_has_errors_of_its_own_however_the_arm_is_fixed(self):
        env, episodes = BeltArmEnv(sensors="accelerometer"), []
        for seed in (1, None, 1):
            seen = [env.reset(seed=seed, options={"move": MOVE})[0]]
            seen += [env.step(np.zeros(1, np.float32))[0] for _ in range(50)]
            episodes.append(np.array(seen)[:, -2:])
        assert np.array_equal(episodes[0], episodes[2])
        assert not np.isclose(episodes[0], episodes[1]).any()
        drawn = BeltArmEnv(sensors="accelerometer", randomization="train").reset(seed=1)[0]
        assert np.array_equal(drawn[-2:], episodes[0][0])

    def test_controllers_ignore_it(self):
        tiers: Any = ("encoder", "accelerometer")
        runs = [rollout(CONTROLLERS["paper"](), 2, seed=1, sensors=tier) for tier in tiers]
        assert runs[0].torque.tobytes() == runs[1].torque.tobytes()
