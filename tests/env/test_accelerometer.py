"""The accelerometer on the arm's end: its parts, and what the environment shows of it."""

import math
from typing import Any

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
from beltarm_env import CONTROL_PERIOD, BeltArmEnv
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


@examples(100)
@given(st.floats(-1.5, 1.5), st.floats(-0.2, 0.6), st.floats(-100, 100), st.floats(-100, 100))
def test_axes_are_those_of_the_hand(angle: float, reach: float, x: float, y: float):
    tip = TipMotion(reach * math.cos(angle), reach * math.sin(angle), 0.0, 0.0)
    along, across = along_and_across(x, y, tip)
    if abs(reach) > 1e-6:
        assert along == pytest.approx(x * math.cos(angle) + y * math.sin(angle), abs=1e-10)
        assert across == pytest.approx(y * math.cos(angle) - x * math.sin(angle), abs=1e-10)
    assert math.hypot(along, across) <= math.hypot(x, y) * (1 + 1e-12)
    folded = along_and_across(x, y, TipMotion(0.0, 0.0, 0.0, 0.0))  # onto joint 1
    assert np.isfinite(folded).all()


@pytest.fixture(scope="module")
def series() -> Floats:
    """Noise of shape (seeds, samples, axes)."""
    seeds = [noise_seed(u) for u in np.random.default_rng(0).random(40)]
    return np.array([[[noise(seed, float(k), axis) for axis in (0, 1)] for k in range(600)] for seed in seeds])


class TestNoise:
    def test_is_about_standard_normal(self, series: Floats):
        values = series.ravel()
        n = len(values)
        assert abs(values.mean()) < 4 / math.sqrt(n)
        assert values.std() == pytest.approx(1, abs=4 / math.sqrt(2 * n))
        for level in (-2.0, -1.0, -0.3, 0.5, 1.5):
            assert np.mean(values < level) == pytest.approx(norm.cdf(level), abs=0.015)
        assert 3 < np.abs(values).max() < 3.47
        sums = np.random.default_rng(1).random((200_000, 4)).sum(axis=1)  # it is distributed as four uniform numbers'
        edges = np.quantile((sums - 2) / math.sqrt(1 / 3), np.linspace(0, 1, 21)[1:-1])
        counts, expected = np.bincount(np.searchsorted(edges, values), minlength=20), n / 20
        assert ((counts - expected) ** 2 / expected).sum() < chi2.ppf(0.9999, 19) + n / 200_000 * 19

    def test_is_white_and_of_its_own_on_each_axis_and_in_each_episode(self, series: Floats):
        near = np.array([[noise(seed, float(k), 0) for k in range(400)] for seed in (123456.0, 123457.0)])
        pairs = {
            "neighbours": (series[:, 1:], series[:, :-1]),
            "next but one": (series[:, 2:], series[:, :-2]),
            "axes": (series[..., 0], series[..., 1]),
            "episodes": (series[1:], series[:-1]),
            "axes, shifted": (series[:, 1:, 0], series[:, :-1, 1]),
            "last digit of the seed": tuple(near),
        }
        for name, (a, b) in pairs.items():
            assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 4 / math.sqrt(a.size), name

    @examples(100)
    @given(st.floats(0, 1, exclude_max=True), st.floats(-1e3, 1e3), st.integers(0, 1202), st.sampled_from([0, 1]))
    def test_seed_bias_and_reading(self, uniform: float, acceleration: float, sample: int, axis: Any):
        seed, bias = noise_seed(uniform), bias_of(uniform)
        assert 0 <= seed < 2**32 and seed == int(seed)
        assert -BIAS <= bias < BIAS
        shown = reading(acceleration, bias, seed, float(sample), axis)
        errors = bias + NOISE * noise(seed, float(sample), axis)
        assert shown == pytest.approx(min(max(acceleration + errors, -RANGE), RANGE), abs=1e-12)


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


class TestThroughTheEnvironment:
    @pytest.mark.parametrize("delay", [0, 0.4, 1.5, 2])
    def test_shows_the_low_passed_acceleration_late(self, delay: float):
        env = BeltArmEnv(sensors="accelerometer", delay=delay)
        first, _ = env.reset(seed=5, options={"move": MOVE, "state": MOVING})
        states, seen = [env.state], [first]
        for k in range(STEPS):
            result, _, over, _, _ = env.step(np.array([torque(k)], np.float32))
            assert not over
            states.append(env.state)
            seen.append(result)
        course, times = np.array(states), CONTROL_PERIOD * np.arange(STEPS + 1)
        draw, *biases = seeding.np_random(5)[0].random(DRAWS)[-3:]

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

        decoded = decode(np.array(seen), "accelerometer")
        for axis, (name, true) in enumerate(zip(NAMES, (along, across), strict=True)):
            noises = [noise(noise_seed(draw), float(k + 2), axis) for k in range(-whole, STEPS + 1 - whole)]
            shown = np.concatenate([np.zeros(whole), true[: STEPS + 1 - whole]])
            expected = np.clip(shown + bias_of(biases[axis]) + NOISE * np.array(noises), -RANGE, RANGE)
            np.testing.assert_allclose(decoded[name], expected, rtol=1e-6, atol=1e-5)

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

    @pytest.mark.parametrize("name", ["paper", "adaptive"])
    def test_controllers_ignore_it(self, name: str):
        tiers: Any = ("encoder", "accelerometer")
        runs = [rollout(CONTROLLERS[name](), 2, seed=1, sensors=tier) for tier in tiers]
        assert runs[0].torque.tobytes() == runs[1].torque.tobytes()
