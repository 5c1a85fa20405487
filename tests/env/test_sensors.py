import math
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from numpy.typing import NDArray
from properties import examples
from scipy.interpolate import CubicHermiteSpline

from beltarm_env import CONTROL_PERIOD, BeltArmEnv, observation
from beltarm_env.physics.state import ArmState
from beltarm_env.task.sensors import (
    ENCODER_COUNTS,
    around_half_a_turn,
    between_samples,
    speed_from_counts,
    to_counts,
)

Floats = NDArray[np.float64]

GEAR = 88.0
RESOLUTION = 2 * math.pi / 4000
STEPS = 400
MOVE = {"start": 0.3, "goal": 1.2, "duration": 1.0, "ramp_time": 0.3}


class TestCounting:
    @examples(100)
    @given(st.floats(-200, 200), st.sampled_from([500, 1000, 4000, 10_000_000]))
    def test_rounds_to_the_nearest(self, angle: float, per_turn: int):
        resolution = 2 * math.pi / per_turn
        counts = to_counts(angle, resolution)
        assert counts == np.rint(angle / resolution)
        assert abs(counts * resolution - angle) <= 0.5 * resolution * (1 + 1e-12) + 1e-13

    @pytest.mark.parametrize(
        ("halves", "counts"),
        [(0.5, 0), (1.5, 2), (2.5, 2), (3.5, 4), (-0.5, 0), (-1.5, -2), (-2.5, -2), (1000.5, 1000)],
    )
    def test_halves_round_to_even(self, halves: float, counts: float):
        assert to_counts(halves, 1.0) == counts
        assert to_counts(math.nextafter(halves, math.inf), 1.0) == math.floor(halves) + 1
        assert to_counts(math.nextafter(halves, -math.inf), 1.0) == math.floor(halves)

    @examples(100)
    @given(st.integers(-(2**50), 2**50), st.sampled_from([1.0, 0.5, RESOLUTION]))
    def test_whole_counts_are_exact(self, counts: int, resolution: float):
        assert to_counts(float(counts), 1.0) == counts
        if abs(counts) < 2**40:
            assert to_counts(counts * resolution, resolution) == counts

    @examples(100)
    @given(st.integers(-(10**6), 10**6), st.integers(-(10**4), 10**4))
    def test_speed_is_the_difference_of_two_counts_over_the_period(self, before: int, change: int):
        speed = speed_from_counts(float(before + change), float(before), RESOLUTION)
        assert speed == pytest.approx(change * RESOLUTION / 0.0015, rel=1e-14)

    def test_one_count_per_sample_is_about_one_radian_per_second(self):
        assert ENCODER_COUNTS == 4000
        assert speed_from_counts(8.0, 7.0, RESOLUTION) == pytest.approx(1.0472, abs=1e-4)


class TestIndexPulse:
    @examples(200)
    @given(st.floats(-1000, 1000))
    @example(303.171875)  # near the end of the series
    def test_sine_and_cosine_of_twice_the_angle(self, angle: float):
        expected = math.sin(2 * angle), math.cos(2 * angle)
        assert around_half_a_turn(angle) == pytest.approx(expected, rel=0, abs=1.5e-12)

    @examples(100)
    @given(st.floats(-200, 200), st.integers(-50, 50))
    def test_half_turns_do_not_show(self, angle: float, half_turns: int):
        turned = around_half_a_turn(angle + math.pi * half_turns)
        assert turned == pytest.approx(around_half_a_turn(angle), rel=0, abs=3e-12)


ANGLES, SPEEDS = st.floats(-200, 200), st.floats(-1000, 1000)
STATES = st.builds(ArmState, ANGLES, SPEEDS, ANGLES, SPEEDS)
AMONG = st.floats(0, 1, exclude_max=True)


def both_of(state: ArmState) -> tuple[tuple[float, float], tuple[float, float]]:
    """Angle and speed of the motor, and of the torsion."""
    return (state.motor_angle, state.motor_speed), (state.torsion, state.torsion_speed)


class TestBetweenSamples:
    @examples(100)
    @given(STATES, STATES)
    def test_at_a_sample_it_is_the_state_itself(self, before: ArmState, now: ArmState):
        assert between_samples(before, now, 0.0) == now
        for (angle, speed), (angle_0, speed_0) in zip(
            both_of(between_samples(before, now, 1.0)), both_of(before), strict=True
        ):
            assert angle == pytest.approx(angle_0, abs=1e-11)
            assert speed == pytest.approx(speed_0, abs=1e-8)

    @examples(100)
    @given(ANGLES, SPEEDS, st.floats(-1e5, 1e5), st.floats(-1e8, 1e8), AMONG)
    def test_cubics_are_exact(self, angle: float, speed: float, acceleration: float, jerk: float, back: float):
        def at(time: float) -> tuple[float, float]:
            course = np.polynomial.Polynomial([angle, speed, acceleration / 2, jerk / 6])
            return float(course(time)), float(course.deriv()(time))

        before, now = ArmState(*at(0.0), *at(0.0)), ArmState(*at(CONTROL_PERIOD), *at(CONTROL_PERIOD))
        for found, found_speed in both_of(between_samples(before, now, back)):
            expected, expected_speed = at((1 - back) * CONTROL_PERIOD)
            assert found == pytest.approx(expected, abs=1e-11)
            assert found_speed == pytest.approx(expected_speed, abs=1e-8)

    @examples(200)
    @given(st.lists(st.tuples(AMONG, st.floats(-1e4, 1e4)), min_size=1, max_size=4), AMONG)
    def test_error_is_bounded_by_what_the_acceleration_changes_by(self, jumps: list[tuple[float, float]], back: float):
        def at(share: float) -> tuple[float, float]:
            since = CONTROL_PERIOD * np.array([max(share - when, 0.0) for when, _ in jumps])
            sizes = np.array([size for _, size in jumps])
            return float(0.5 * sizes @ since**2), float(sizes @ since)

        before, now = ArmState(*at(0.0), *at(0.0)), ArmState(*at(1.0), *at(1.0))
        change = sum(abs(size) for _, size in jumps)
        for found, found_speed in both_of(between_samples(before, now, back)):
            expected, expected_speed = at(1 - back)
            assert abs(found - expected) <= 0.0162 * change * CONTROL_PERIOD**2 + 1e-15
            assert abs(found_speed - expected_speed) <= change * CONTROL_PERIOD / 12 + 1e-12

    def test_the_bounds_are_reached(self):
        size = 1e4
        worst, worst_speed = 0.0, 0.0
        for when in np.linspace(0, 1, 51):
            left = (1 - when) * CONTROL_PERIOD
            now = ArmState(*[0.5 * size * left**2, size * left] * 2)
            for back in np.linspace(0, 1, 51):
                since = max(1 - back - when, 0.0) * CONTROL_PERIOD
                (angle, speed), _ = both_of(between_samples(ArmState(0.0, 0.0, 0.0, 0.0), now, back))
                worst = max(worst, abs(angle - 0.5 * size * since**2))
                worst_speed = max(worst_speed, abs(speed - size * since))
        assert worst > 0.016 * size * CONTROL_PERIOD**2
        assert worst_speed > 0.08 * size * CONTROL_PERIOD


def torque(k: int) -> float:
    """Over its limit: pushes the arm to and fro."""
    return 0.5 * math.sin(0.02 * k) + 0.3 * math.sin(0.11 * k)


class Record:
    """States and observations (in physical units) of an episode, row 0 at its start."""

    def __init__(self, state: Floats | None = None, **settings: Any) -> None:
        env = BeltArmEnv(**settings)
        options: dict[str, Any] = {"move": MOVE} | ({} if state is None else {"state": state})
        first, _ = env.reset(seed=1, options=options)
        states, seen = [env.state], [first]
        for k in range(STEPS):
            result, _, terminated, _, _ = env.step(np.array([torque(k)], np.float32))
            assert not terminated
            states.append(env.state)
            seen.append(result)
        self.states = np.array(states)
        self.seen = observation.decode(np.array(seen), env.sensors)
        self.reference = np.array([env.reference(k * CONTROL_PERIOD) for k in range(STEPS + 1)])

    def counts(self, resolution: float = RESOLUTION) -> Floats:
        """Encoder counts recovered from the tracking error, and equal to those of the angle."""
        counts = (GEAR * self.reference[:, 0] - self.seen["motor_angle_error"]) / resolution
        np.testing.assert_allclose(self.seen["motor_angle"] / resolution, counts, atol=0.02)
        # float32 keeps 6e-8 of an error of up to 80 rad: 0.003 of 4000 counts per turn
        np.testing.assert_allclose(counts, np.rint(counts), atol=0.01)
        return np.rint(counts)


def radial_speed(states: Floats) -> Floats:
    """Speed of the arm's end along x for states of shape (4, n)."""
    theta_a, omega_a, theta_s, omega_s = states
    phi, phi_dot = theta_a / GEAR - theta_s, omega_a / GEAR - omega_s
    reach = 0.5 * np.cos(phi) + 0.1
    return -0.5 * np.sin(phi) * phi_dot * np.cos(theta_s) - reach * np.sin(theta_s) * omega_s


MOVING = np.array([GEAR * 0.6, 40.0, 0.02, -0.5])


@pytest.fixture(scope="module")
def prompt() -> Record:
    return Record()


class TestThroughTheEnvironment:
    def test_angle_is_in_whole_counts(self, prompt: Record):
        expected = np.rint(prompt.states[:, 0] / RESOLUTION)
        np.testing.assert_array_equal(prompt.counts(), expected)
        assert np.ptp(expected) > 1000, "the motor does turn"

    def test_error_differs_from_the_true_one_by_up_to_half_a_count(self, prompt: Record):
        true_error = GEAR * prompt.reference[:, 0] - prompt.states[:, 0]
        difference = np.abs(prompt.seen["motor_angle_error"] - true_error) / RESOLUTION
        assert difference.max() <= 0.5 + 0.01
        assert difference.max() > 0.45

    def test_speed_is_the_difference_of_counts(self, prompt: Record):
        expected = np.diff(prompt.counts()) * RESOLUTION / CONTROL_PERIOD
        np.testing.assert_allclose(prompt.seen["motor_speed"][1:], expected, rtol=1e-6)
        error = GEAR * prompt.reference[:, 1] - prompt.seen["motor_speed"]
        np.testing.assert_allclose(prompt.seen["motor_speed_error"], error, rtol=1e-6, atol=1e-4)

    def test_speed_is_true_to_one_count_per_sample(self, prompt: Record):
        mean_speed = np.diff(prompt.states[:, 0]) / CONTROL_PERIOD
        assert np.abs(prompt.seen["motor_speed"][1:] - mean_speed).max() <= 1.001 * RESOLUTION / CONTROL_PERIOD

    @pytest.mark.parametrize("per_turn", [1000, 4000, 100_000])
    def test_resolution(self, prompt: Record, per_turn: int):
        record = Record(encoder_counts=per_turn)
        np.testing.assert_array_equal(record.states, prompt.states, "the encoder does not act back on the arm")
        resolution = 2 * math.pi / per_turn
        error = GEAR * prompt.reference[:, 0] - np.rint(prompt.states[:, 0] / resolution) * resolution
        np.testing.assert_allclose(record.seen["motor_angle_error"], error, rtol=1e-6, atol=1e-6)
        speeds = record.seen["motor_speed"] * CONTROL_PERIOD / resolution
        np.testing.assert_allclose(speeds, np.rint(speeds), atol=0.01)

    def test_coarser_encoder_has_four_of_the_finer_ones_counts(self, prompt: Record):
        coarse = Record(encoder_counts=1000).counts(4 * RESOLUTION)
        assert np.abs(4 * coarse - prompt.counts()).max() == 2

    @pytest.mark.parametrize("delay", [1, 2])
    @pytest.mark.parametrize("state", [None, MOVING], ids=["from rest", "moving"])
    def test_delay_shifts_by_whole_samples(self, delay: int, state: Floats | None):
        fresh, late = Record(state), Record(state, delay=delay)
        np.testing.assert_array_equal(fresh.states, late.states)
        shown = len(fresh.states) - delay
        np.testing.assert_array_equal(late.counts()[delay:], fresh.counts()[:shown])
        for name in ("motor_speed", "motor_angle", "sin_2_motor_angle", "cos_2_motor_angle"):
            np.testing.assert_array_equal(late.seen[name][delay:], fresh.seen[name][:shown])
        for name in ("reference_angle", "reference_speed", "elapsed_time", "last_command"):
            np.testing.assert_array_equal(late.seen[name], fresh.seen[name], "what is known is not late")

    @pytest.mark.parametrize("delay", [0.3, 0.5, 1.75, 1.999])
    @pytest.mark.parametrize("sensors", ["encoder", "tip"])
    def test_between_samples_states_are_interpolated(self, delay: float, sensors: str):
        record, whole = Record(MOVING, sensors=sensors, delay=delay), math.floor(delay)
        np.testing.assert_array_equal(record.states, Record(MOVING).states)
        times = CONTROL_PERIOD * np.arange(STEPS + 1)
        late = times[whole + 1 :] - CONTROL_PERIOD * delay
        angle, torsion = (CubicHermiteSpline(times, record.states[:, k], record.states[:, k + 1]) for k in (0, 2))
        counts = angle(late) / RESOLUTION
        decided = np.abs(counts - np.floor(counts) - 0.5) > 1e-6
        np.testing.assert_array_equal(record.counts()[whole + 1 :][decided], np.rint(counts)[decided])
        assert decided.mean() > 0.99
        speeds = np.diff(record.counts()) * RESOLUTION / CONTROL_PERIOD
        np.testing.assert_allclose(record.seen["motor_speed"][1:], speeds, rtol=1e-6, atol=1e-9)
        if sensors == "tip":
            x_speed = radial_speed(np.stack([angle(late), angle(late, 1), torsion(late), torsion(late, 1)]))
            np.testing.assert_allclose(record.seen["tip_speed"][whole + 1 :], x_speed, rtol=1e-6, atol=1e-7)

    @pytest.mark.parametrize("delay", [1, 2])
    def test_delay_makes_a_difference(self, prompt: Record, delay: int):
        assert (Record(delay=delay).counts() != prompt.counts()).mean() > 0.5

    @pytest.mark.parametrize("delay", [0, 0.4, 1, 1.7, 2])
    def test_before_an_episode_that_starts_moving_the_motor_moved_as_fast(self, delay: int):
        record = Record(MOVING, delay=delay)
        before = MOVING[0] - CONTROL_PERIOD * MOVING[1] * np.array([delay, delay + 1])
        now, earlier = np.rint(before / RESOLUTION)
        assert record.counts()[0] == now
        assert record.seen["motor_speed"][0] == pytest.approx((now - earlier) * RESOLUTION / CONTROL_PERIOD)

    @pytest.mark.parametrize("delay", [0, 1, 2])
    def test_tachometer_at_the_tip(self, delay: int):
        record = Record(sensors="tip", delay=delay)
        x_speed = radial_speed(record.states.T)
        np.testing.assert_allclose(record.seen["tip_speed"][delay:], x_speed[: STEPS + 1 - delay], rtol=1e-6, atol=1e-7)
        assert np.abs(x_speed).max() > 0.1

    def test_tachometer_of_an_arm_that_starts_moving(self):
        record = Record(MOVING, sensors="tip")
        reach, phi_dot = 0.5 * math.cos(0.58) + 0.1, 40 / GEAR + 0.5
        x_speed = -0.5 * math.sin(0.58) * phi_dot * math.cos(0.02) - reach * math.sin(0.02) * -0.5
        assert record.seen["tip_speed"][0] == pytest.approx(x_speed, rel=1e-6)

    def test_true_torsion_is_neither_rounded_nor_late(self):
        record = Record(sensors="full", delay=2)
        np.testing.assert_allclose(record.seen["torsion"], record.states[:, 2], rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(record.seen["torsion_speed"], record.states[:, 3], rtol=1e-6, atol=1e-9)
