"""The accelerometer on the arm's end: its parts, and what the environment shows of it."""

import math
from itertools import pairwise
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils import seeding
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from properties import examples
from scipy.integrate import quad
from scipy.interpolate import CubicHermiteSpline
from scipy.stats import chi2, norm

from baselines import CONTROLLERS
from beltarm_env import CONTROL_PERIOD, BeltArmEnv, BeltArmVectorEnv
from beltarm_env.observation import decode
from beltarm_env.physics.kinematics import TipMotion
from beltarm_env.rollout import rollout
from beltarm_env.task.accelerometer import (
    BANDWIDTH,
    BIAS,
    NOISE,
    RANGE,
    along_and_across,
    bias_of,
    low_passed,
    noise,
    noise_seed,
    reading,
)
from beltarm_env.task.draws import DRAWS

Floats = NDArray[np.float64]

NAMES = ("tip_acceleration_along", "tip_acceleration_across")
TAU = 1 / (2 * math.pi * BANDWIDTH)
G = 9.80665
STEPS = 300
MOVE = {"start": 0.3, "goal": 1.2, "duration": 1.0, "ramp_time": 0.3}
MOVING = np.array([88 * 0.6, 40.0, 0.02, -0.5])


def test_numbers_of_the_data_sheet():
    assert (RANGE / G, BIAS / G, BANDWIDTH) == (pytest.approx(8), pytest.approx(0.05), 260.0)
    assert NOISE / G == pytest.approx(400e-6 * math.sqrt(math.pi / 2 * 260))
    assert 2 * BANDWIDTH < 1 / CONTROL_PERIOD, "no more bandwidth than is sampled"


class TestLowPass:
    @examples(50)
    @given(st.floats(-100, 100), st.floats(-2, 2), st.floats(-2, 2))
    def test_is_that_of_a_velocity_linear_in_between(self, filtered: float, before: float, now: float):
        slope = (now - before) / CONTROL_PERIOD
        driven, _ = quad(lambda s: math.exp(-(CONTROL_PERIOD - s) / TAU) * slope / TAU, 0, CONTROL_PERIOD)
        expected = filtered * math.exp(-CONTROL_PERIOD / TAU) + driven
        assert low_passed(filtered, before, now) == pytest.approx(expected, rel=1e-9, abs=1e-9)

    @examples(50)
    @given(st.lists(st.floats(-2, 2), min_size=2, max_size=20))
    def test_is_velocity_minus_low_passed_velocity_over_the_time_constant(self, velocities: list[float]):
        acceleration, z = 0.0, velocities[0]
        decay = math.exp(-CONTROL_PERIOD / TAU)
        for before, now in pairwise(velocities):
            slope = (now - before) / CONTROL_PERIOD
            z = now - slope * TAU + (z - before + slope * TAU) * decay  # closed form of z' = (v - z) / tau
            acceleration = low_passed(acceleration, before, now)
            assert acceleration == pytest.approx((now - z) / TAU, rel=1e-9, abs=1e-7)

    def test_response_to_a_slow_sine(self):
        omega = 2 * math.pi * BANDWIDTH / 10
        velocity = np.sin(omega * CONTROL_PERIOD * np.arange(4000)) / omega
        found = [acceleration := 0.0]
        for before, now in pairwise(velocity):
            found.append(acceleration := low_passed(acceleration, before, now))
        rms = np.sqrt(2 * np.mean(np.square(found[200:])))
        assert rms == pytest.approx(1 / math.hypot(1, omega * TAU), rel=0.02)


class TestAxes:
    @examples(100)
    @given(st.floats(-1.5, 1.5), st.floats(-0.2, 0.6), st.floats(-100, 100), st.floats(-100, 100))
    def test_are_those_of_the_hand(self, angle: float, reach: float, x: float, y: float):
        tip = TipMotion(reach * math.cos(angle), reach * math.sin(angle), 0.0, 0.0)
        along, across = along_and_across(x, y, tip)
        if abs(reach) > 1e-6:
            assert along == pytest.approx(x * math.cos(angle) + y * math.sin(angle), abs=1e-10)
            assert across == pytest.approx(y * math.cos(angle) - x * math.sin(angle), abs=1e-10)
        assert math.hypot(along, across) <= math.hypot(x, y) * (1 + 1e-12)

    def test_folded_onto_joint_1_nothing_is_infinite(self):
        assert np.isfinite(along_and_across(1.0, 2.0, TipMotion(0.0, 0.0, 0.0, 0.0))).all()


@pytest.fixture(scope="module")
def many() -> Floats:
    """Noise of shape (seeds, samples, axes)."""
    seeds = [noise_seed(u) for u in np.random.default_rng(0).random(40)]
    return np.array([[[noise(seed, float(k), axis) for axis in (0, 1)] for k in range(600)] for seed in seeds])


class TestNoise:
    def test_is_about_standard_normal(self, many: Floats):
        values = many.ravel()
        n = len(values)
        assert abs(values.mean()) < 4 / math.sqrt(n)
        assert values.std() == pytest.approx(1, abs=4 / math.sqrt(2 * n))
        assert np.mean(values**4) == pytest.approx(2.7, abs=0.06)
        for level in (-2.0, -1.0, -0.3, 0.5, 1.5):
            assert np.mean(values < level) == pytest.approx(norm.cdf(level), abs=0.015)
        assert 3 < np.abs(values).max() < 3.47

    def test_is_white_and_of_its_own_on_each_axis_and_in_each_episode(self, many: Floats):
        pairs = {
            "neighbours": (many[:, 1:], many[:, :-1]),
            "next but one": (many[:, 2:], many[:, :-2]),
            "axes": (many[..., 0], many[..., 1]),
            "episodes": (many[1:], many[:-1]),
            "axes, shifted": (many[:, 1:, 0], many[:, :-1, 1]),
        }
        for name, (one, other) in pairs.items():
            assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 4 / math.sqrt(one.size), name

    def test_every_digit_of_the_seed_counts(self):
        one, other = ([noise(seed, float(k), 0) for k in range(400)] for seed in (123456.0, 123457.0))
        assert abs(np.corrcoef(one, other)[0, 1]) < 4 / math.sqrt(400)

    def test_is_distributed_as_the_sum_of_four_uniform_numbers(self):
        values = np.array([noise(noise_seed(0.5), float(k), 0) for k in range(8000)])
        sums = np.random.default_rng(1).random((200_000, 4)).sum(axis=1)
        edges = np.quantile((sums - 2) / math.sqrt(1 / 3), np.linspace(0, 1, 21)[1:-1])
        found = np.bincount(np.searchsorted(edges, values), minlength=20)
        assert ((found - 400) ** 2 / 400).sum() < chi2.ppf(0.9999, 19)

    @examples(100)
    @given(st.floats(0, 1, exclude_max=True))
    def test_seed_and_bias_of_a_draw(self, uniform: float):
        assert 0 <= noise_seed(uniform) < 2**32 and noise_seed(uniform) == int(noise_seed(uniform))
        assert -BIAS <= bias_of(uniform) < BIAS


@examples(100)
@given(st.floats(-1e3, 1e3), st.floats(-BIAS, BIAS), st.integers(0, 1202), st.sampled_from([0, 1]))
def test_reading_is_cut_at_the_range(acceleration: float, bias: float, sample: int, axis: Any):
    found = reading(acceleration, bias, 7.0, float(sample), axis)
    errors = bias + NOISE * noise(7.0, float(sample), axis)
    assert found == pytest.approx(min(max(acceleration + errors, -RANGE), RANGE), abs=1e-12)


def torque(k: int) -> float:
    """Over its limit: pushes the arm to and fro."""
    return 0.5 * math.sin(0.02 * k) + 0.3 * math.sin(0.11 * k)


def tip_of(states: Floats) -> tuple[Floats, Floats, Floats]:
    """Angle of the hand, and the tip's velocity along x and y, for states of shape (4, n) of the nominal arm."""
    theta_a, omega_a, theta_s, omega_s = states
    phi, phi_dot = theta_a / 88 - theta_s, omega_a / 88 - omega_s
    reach, away = 0.5 * np.cos(phi) + 0.1, -0.5 * np.sin(phi) * phi_dot
    around = reach * omega_s
    x = away * np.cos(theta_s) - around * np.sin(theta_s)
    return theta_s, x, away * np.sin(theta_s) + around * np.cos(theta_s)


@pytest.mark.parametrize("delay", [0, 0.4, 1, 1.5, 2])
def test_what_the_environment_shows(delay: float):
    env = BeltArmEnv(sensors="accelerometer", delay=delay)
    first, _ = env.reset(seed=5, options={"move": MOVE, "state": MOVING})
    states, seen = [env.state], [first]
    for k in range(STEPS):
        result, _, over, _, _ = env.step(np.array([torque(k)], np.float32))
        assert not over
        states.append(env.state)
        seen.append(result)
    course, times = np.array(states), CONTROL_PERIOD * np.arange(STEPS + 1)
    draw, *of_bias = seeding.np_random(5)[0].random(DRAWS)[-3:]
    seed, biases = noise_seed(draw), [bias_of(u) for u in of_bias]

    whole = math.floor(delay)
    read = np.maximum(times - (delay - whole) * CONTROL_PERIOD, 0.0)
    splines = [CubicHermiteSpline(times, course[:, k], course[:, k + 1]) for k in (0, 2)]
    angle, x, y = tip_of(np.array([spline(read, order) for spline in splines for order in (0, 1)]))
    filtered, decay = np.zeros((STEPS + 1, 2)), math.exp(-CONTROL_PERIOD / TAU)
    velocity = np.stack([x, y], axis=1)
    velocity[0] = np.stack(tip_of(course[0])[1:])
    for k in range(STEPS):
        mean = (velocity[k + 1] - velocity[k]) / CONTROL_PERIOD
        filtered[k + 1] = mean + (filtered[k] - mean) * decay
    cosine, sine = np.cos(angle), np.sin(angle)
    along = filtered[:, 0] * cosine + filtered[:, 1] * sine
    across = filtered[:, 1] * cosine - filtered[:, 0] * sine
    assert np.abs(along).max() > 5 and np.abs(across).max() > 5

    told = decode(np.array(seen), "accelerometer")
    for axis, (name, true) in enumerate(zip(NAMES, (along, across), strict=True)):
        noises = [noise(seed, float(k + 2), axis) for k in range(-whole, STEPS + 1 - whole)]
        shown = np.concatenate([np.zeros(whole), true[: STEPS + 1 - whole]])
        expected = np.clip(shown + biases[axis] + NOISE * np.array(noises), -RANGE, RANGE)
        np.testing.assert_allclose(told[name], expected, rtol=1e-6, atol=1e-5)


def test_of_an_arm_at_rest_there_is_bias_and_noise():
    arms = 60
    envs = BeltArmVectorEnv(arms, sensors="accelerometer")
    seen = [envs.reset(seed=3)[0]]
    for _ in range(300):
        seen.append(envs.step(np.zeros((arms, 1), np.float32))[0])
    told = decode(np.array(seen), "accelerometer")
    assert not np.array_equal(told[NAMES[0]], told[NAMES[1]])
    for name in NAMES:
        assert told[name].std(axis=0) == pytest.approx(np.full(arms, NOISE), rel=0.2)
        biases = told[name].mean(axis=0)
        assert np.abs(biases).max() < BIAS + 5 * NOISE / math.sqrt(300)
        assert np.ptp(biases) > 1.5 * BIAS and abs(biases.mean()) < 0.3 * BIAS


def test_every_episode_has_errors_of_its_own():
    env = BeltArmEnv(sensors="accelerometer")
    episodes = []
    for seed in (1, None, 1):
        seen = [env.reset(seed=seed, options={"move": MOVE})[0]]
        seen += [env.step(np.zeros(1, np.float32))[0] for _ in range(50)]
        episodes.append(np.array(seen)[:, -2:])
    assert np.array_equal(episodes[0], episodes[2])
    assert not np.isclose(episodes[0], episodes[1]).any()


def test_errors_do_not_depend_on_how_the_arm_is_fixed():
    first = BeltArmEnv(sensors="accelerometer", randomization="train").reset(seed=4)[0]
    options = {"params": {"payload_mass": 0.1}, "move": MOVE}
    assert np.array_equal(BeltArmEnv(sensors="accelerometer").reset(seed=4, options=options)[0][-2:], first[-2:])


@pytest.mark.parametrize("name", ["paper", "ei", "lqg", "adaptive"])
def test_controllers_ignore_it(name: str):
    runs: list[Any] = [rollout(CONTROLLERS[name](), 2, seed=1, sensors=tier) for tier in ("encoder", "accelerometer")]
    assert runs[0].torque.tobytes() == runs[1].torque.tobytes()


def test_agrees_with_single_arms_across_episodes():
    case: dict[str, Any] = {"sensors": "accelerometer", "randomization": "train", "delay": 0.7}
    envs = BeltArmVectorEnv(3, autoreset_mode="SameStep", **case)
    singles = [gym.make("BeltArm-v0", **case) for _ in range(3)]
    start, _ = envs.reset(seed=20)
    assert np.array_equal(start, [single.reset(seed=20 + i)[0] for i, single in enumerate(singles)])
    ends = 0
    for k in range(1500):
        action = np.array([1.2 * torque(k)], np.float32)
        for i, observation in enumerate(envs.step(np.stack([action] * 3))[0]):
            mine, _, terminated, truncated, _ = singles[i].step(action)
            if terminated or truncated:
                ends += 1
                mine, _ = singles[i].reset()
            assert observation.tobytes() == mine.tobytes()
    assert ends >= 3
