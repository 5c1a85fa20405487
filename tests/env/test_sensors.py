"""Encoder, index pulse, tachometer, accelerometer and delay: their parts, and what the environment shows of them."""

import math
from typing import Any

import numpy as np
import pytest
from gymnasium.utils import seeding
from hypothesis import example, given
from hypothesis import strategies as st
from numpy.typing import NDArray
from properties import examples
from scipy.interpolate import CubicHermiteSpline
from scipy.stats import chi2, norm

from baselines import CONTROLLERS
from beltarm_env import CONTROL_PERIOD, BeltArmEnv, observation
from beltarm_env.physics.state import ArmState
from beltarm_env.rollout import rollout
from beltarm_env.task.accelerometer import BANDWIDTH, BIAS, NOISE, RANGE, bias_of, noise, noise_seed
from beltarm_env.task.draws import DRAWS
from beltarm_env.task.sensors import around_half_a_turn, between_samples, to_counts

Floats = NDArray[np.float64]

GEAR = 88.0
RESOLUTION = 2 * math.pi / 4000
STEPS = 400
NAMES = ("tip_acceleration_along", "tip_acceleration_across")
TAU, G = 1 / (2 * math.pi * BANDWIDTH), 9.80665
MOVE = {"start": 0.3, "goal": 1.2, "duration": 1.0, "ramp_time": 0.3}


class TestCounting:
    @examples(100)
    @given(st.floats(-200, 200), st.sampled_from([500, 1000, 4000, 10_000_000]))
    def test_rounds_to_the_nearest(self, angle: float, per_turn: int):
        resolution = 2 * math.pi / per_turn
        counts = to_counts(angle, resolution)
        assert counts == np.rint(angle / resolution)
        assert abs(counts * resolution - angle) <= 0.5 * resolution * (1 + 1e-12) + 1e-13
        assert to_counts(counts * resolution, resolution) == counts, "whole counts are exact"

    @pytest.mark.parametrize(("halves", "counts"), [(0.5, 0), (1.5, 2), (-0.5, 0), (-1.5, -2), (1000.5, 1000)])
    def test_halves_round_to_even(self, halves: float, counts: float):
        assert to_counts(halves, 1.0) == counts
        assert to_counts(math.nextafter(halves, math.inf), 1.0) == math.floor(halves) + 1
        assert to_counts(math.nextafter(halves, -math.inf), 1.0) == math.floor(halves)


@examples(200)
@given(st.floats(-1000, 1000))
@example(303.171875)  # near the end of the series
def test_index_pulse_has_sine_and_cosine_of_twice_the_angle(angle: float):
    expected = math.sin(2 * angle), math.cos(2 * angle)
    assert around_half_a_turn(angle) == pytest.approx(expected, rel=0, abs=1.5e-12)


ANGLES, SPEEDS = st.floats(-200, 200), st.floats(-1000, 1000)
SHARES = st.floats(0, 1, exclude_max=True)


def both_of(state: ArmState) -> tuple[tuple[float, float], tuple[float, float]]:
    """Angle and speed of the motor, and of the torsion."""
    return (state.motor_angle, state.motor_speed), (state.torsion, state.torsion_speed)


class TestBetweenSamples:
    @examples(200)
    @given(st.lists(st.tuples(SHARES, st.floats(-1e4, 1e4)), min_size=1, max_size=4), SHARES)
    def test_error_is_bounded_by_the_change_of_acceleration(self, jumps: list[tuple[float, float]], back: float):
        def at(share: float) -> tuple[float, float]:
            since = CONTROL_PERIOD * np.array([max(share - when, 0.0) for when, _ in jumps])
            sizes = np.array([size for _, size in jumps])
            return float(0.5 * sizes @ since**2), float(sizes @ since)

        before, now = ArmState(*at(0.0), *at(0.0)), ArmState(*at(1.0), *at(1.0))
        change = sum(abs(size) for _, size in jumps)
        for shown, shown_speed in both_of(between_samples(before, now, back)):
            expected, expected_speed = at(1 - back)
            assert abs(shown - expected) <= 0.0162 * change * CONTROL_PERIOD**2 + 1e-15
            assert abs(shown_speed - expected_speed) <= change * CONTROL_PERIOD / 12 + 1e-12


# The accelerometer on the arm's end


def test_numbers_of_the_data_sheet():
    assert (RANGE / G, BIAS / G, BANDWIDTH) == (pytest.approx(8), pytest.approx(0.05), 260.0)
    assert NOISE / G == pytest.approx(400e-6 * math.sqrt(math.pi / 2 * 260))
    assert 2 * BANDWIDTH < 1 / CONTROL_PERIOD, "no more bandwidth than is sampled"


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


# Through the environment


def torque(k: int) -> float:
    """Over its limit: pushes the arm to and fro."""
    return 0.5 * math.sin(0.02 * k) + 0.3 * math.sin(0.11 * k)


class Record:
    """States and observations (in physical units) of an episode, row 0 at its start."""

    def __init__(self, state: Floats | None = None, params: dict[str, float] | None = None, **settings: Any) -> None:
        env = BeltArmEnv(**settings)
        options: dict[str, Any] = {"move": MOVE, "params": params or {}} | ({} if state is None else {"state": state})
        first, _ = env.reset(seed=1, options=options)
        states, seen = [env.state], [first]
        for k in range(STEPS):
            result, _, terminated, _, _ = env.step(np.array([torque(k)], np.float32))
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

    def course(self, column: int, times: NDArray[Any], order: int = 0) -> Floats:
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
DELAYS = [(0, 4000), (0.4, 4000), (1, 1000), (1.75, 20_000), (2, 4000)]


class TestThroughTheEnvironment:
    @pytest.mark.parametrize(("delay", "per_turn"), DELAYS)
    @pytest.mark.parametrize("state", [None, MOVING], ids=["from rest", "moving"])
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

    @pytest.mark.parametrize("delay", [0, 0.3, 1, 1.999])
    @pytest.mark.parametrize("state", [None, MOVING], ids=["from rest", "moving"])
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
    @pytest.mark.parametrize("delay", [0, 0.4, 1.5, 2])
    def test_shows_the_low_passed_acceleration_late(self, delay: float):
        record, whole = Record(MOVING, sensors="accelerometer", delay=delay), math.floor(delay)
        draw, *biases = seeding.np_random(1)[0].random(DRAWS)[-3:]
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

    @pytest.mark.parametrize("name", ["paper", "adaptive"])
    def test_controllers_ignore_it(self, name: str):
        tiers: Any = ("encoder", "accelerometer")
        runs = [rollout(CONTROLLERS[name](), 2, seed=1, sensors=tier) for tier in tiers]
        assert runs[0].torque.tobytes() == runs[1].torque.tobytes()
