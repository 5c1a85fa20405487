import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from properties import examples

from beltarm_env import CONTROL_PERIOD, EPISODE_STEPS
from beltarm_env.metrics import (
    METRICS,
    SETTLING_BAND,
    SHOWN,
    TORQUES,
    episode_metrics,
    residual_vibration,
    settling_time,
    torque_reversals,
)
from beltarm_env.rollout import rollout
from beltarm_env.task.moves import SHORTEST, WORKSPACE

Floats = NDArray[np.float64]

DURATION = 0.9  # of the move [s]: the last row of it is 599
TIME: Floats = np.arange(1.0, EPISODE_STEPS + 1) * np.float64(CONTROL_PERIOD)
NEVER = EPISODE_STEPS * CONTROL_PERIOD


def evaluate(**signals: Any) -> dict[str, float]:
    """Metrics of one episode with the given signals, all others zero; those of shape (T,) are radial."""
    defaults: dict[str, Any] = {
        "tip_error": np.zeros((EPISODE_STEPS, 2)),
        "tip_velocity_error": np.zeros((EPISODE_STEPS, 2)),
        "torque": np.zeros(EPISODE_STEPS),
        "torque_limit": 0.3,
        "move_duration": DURATION,
        "cost": 0.0,
        "finished": True,
    }
    unknown = set(signals) - set(defaults)
    assert not unknown
    merged = defaults | signals
    rows = {name: np.asarray(merged[name], dtype=np.float64) for name in ("tip_error", "tip_velocity_error")}
    for name, values in rows.items():
        if values.ndim == 1:
            rows[name] = np.column_stack([values, np.zeros(EPISODE_STEPS)])
    metrics = episode_metrics(
        rows["tip_error"][:, None],
        rows["tip_velocity_error"][:, None],
        np.asarray(merged["torque"], dtype=np.float64)[:, None],
        np.array([merged["torque_limit"]]),
        np.array([merged["move_duration"]]),
        np.array([merged["cost"]]),
        np.array([merged["finished"]]),
    )
    assert list(metrics) == list(METRICS)
    assert all(value.shape == (1,) for value in metrics.values())
    return {name: float(value[0]) for name, value in metrics.items()}


def ringing(amplitude: float) -> Floats:
    """A cosine after the move that its straight-line trend leaves as it is, since it is even about the middle."""
    after = TIME >= DURATION - 1e-9
    assert after.sum() == 601
    return np.where(after, amplitude * np.cos(2 * np.pi * (np.arange(EPISODE_STEPS) - 899) / 40), 0.0)


def both(radial: Floats, lateral: Floats) -> Floats:
    return np.column_stack([radial, lateral])


def held(value: float) -> Floats:
    return np.full(EPISODE_STEPS, value)


class TestTipError:
    def test_of_a_perfect_episode(self):
        metrics = evaluate()
        assert metrics["settling_s"] == CONTROL_PERIOD, "in the band at the first sample already"
        assert all(value == 0 for name, value in metrics.items() if name != "settling_s")

    def test_rms_and_maximum_of_a_constant(self):
        metrics = evaluate(tip_error=both(held(0.003), held(-0.004)))
        assert metrics["tip_rms_mm"] == pytest.approx(5.0)
        assert metrics["tip_max_mm"] == pytest.approx(5.0)
        assert metrics["residual_pp_mm"] == pytest.approx(0.0, abs=1e-12)

    def test_rms_and_maximum_of_a_pulse(self):
        error = np.zeros((EPISODE_STEPS, 2))
        error[:300] = [0.0, 0.008]
        metrics = evaluate(tip_error=error)
        assert metrics["tip_rms_mm"] == pytest.approx(4.0), "8 mm for a quarter of the time"
        assert metrics["tip_max_mm"] == pytest.approx(8.0)

    def test_maximum_is_of_the_distance_not_of_a_coordinate(self):
        error = np.zeros((EPISODE_STEPS, 2))
        error[10], error[20] = [0.006, 0.0], [0.005, 0.005]
        assert evaluate(tip_error=error)["tip_max_mm"] == pytest.approx(5 * math.sqrt(2))


class Still:
    def predict(self, observation: Any, *_: Any, **__: Any) -> Any:
        return np.zeros((len(observation), 1), np.float32), None


class TestArrival:
    """An arm arrives if the mean of its error after the move, in each axis, is within a bound."""

    @pytest.mark.parametrize(("offset", "away"), [(0.0, 0), (0.0105, 0), (0.0107, 1), (0.18, 1)])
    def test_an_offset_beyond_the_bound(self, offset: float, away: int):
        assert evaluate(tip_error=both(held(offset), held(-offset)))["not_arrived_share"] == away

    def test_vibration_about_the_goal_has_arrived(self):
        assert evaluate(tip_error=ringing(0.03))["not_arrived_share"] == 0

    def test_an_error_before_the_end_of_the_move_does_not_count(self):
        assert evaluate(tip_error=np.where(TIME < DURATION - 1e-9, 0.2, 0.0))["not_arrived_share"] == 0

    def test_an_arm_that_left_its_workspace_has_not_arrived(self):
        assert evaluate(finished=False)["not_arrived_share"] == 1

    def test_the_shortest_move_takes_the_tip_farther_than_the_bound(self):
        """So no arm arrives that stays where it is."""
        for move in ({"start": 0.0, "goal": SHORTEST}, {"start": WORKSPACE, "goal": WORKSPACE - SHORTEST}):
            run = rollout(Still(), 1, options={"move": move})
            assert run.finished and run.metrics()["not_arrived_share"] == 1


class TestResidualVibration:
    def test_of_a_pure_sine(self):
        metrics = evaluate(tip_error=ringing(0.002))
        assert metrics["residual_radial_pp_mm"] == pytest.approx(4.0)
        assert metrics["residual_lateral_pp_mm"] == pytest.approx(0.0, abs=1e-12)
        assert metrics["residual_pp_mm"] == pytest.approx(4.0)

    def test_both_together_are_the_hypotenuse(self):
        metrics = evaluate(tip_error=both(ringing(0.003), ringing(-0.004)))
        assert metrics["residual_radial_pp_mm"] == pytest.approx(6.0)
        assert metrics["residual_lateral_pp_mm"] == pytest.approx(8.0)
        assert metrics["residual_pp_mm"] == pytest.approx(10.0)

    @pytest.mark.parametrize("drift", [0.005 * TIME, 0.02 - 0.01 * TIME])
    def test_offset_and_linear_drift_do_not_count(self, drift: Floats):
        metrics = evaluate(tip_error=both(ringing(0.002) + drift, drift))
        assert metrics["residual_radial_pp_mm"] == pytest.approx(4.0)
        assert metrics["residual_lateral_pp_mm"] == pytest.approx(0.0, abs=1e-10)

    def test_curved_creep_counts(self):
        # Of s^2 over 0 <= s <= 1 the line s - 1/6 is taken away; s^2 - s + 1/6 runs from -1/12 to 1/6.
        s = np.clip((TIME - DURATION) / (TIME[-1] - DURATION), 0, None)
        assert evaluate(tip_error=0.004 * s**2)["residual_pp_mm"] == pytest.approx(1.0, rel=0.01)

    def test_motion_before_the_end_of_the_move_does_not_count(self):
        before = np.where(TIME < DURATION - 1e-9, 0.05 * np.sin(40 * TIME), 0.0)
        metrics = evaluate(tip_error=both(ringing(0.002) + before, before))
        assert metrics["residual_radial_pp_mm"] == pytest.approx(4.0)
        assert metrics["residual_lateral_pp_mm"] == pytest.approx(0.0, abs=1e-12)

    @pytest.mark.parametrize("row", [600, 601, 1199])
    def test_every_row_after_the_end_counts(self, row: int):
        error = np.zeros(EPISODE_STEPS)
        error[row] = 0.001
        # one row among 600 hardly moves the trend, at the ends by up to 4 / 600
        assert evaluate(tip_error=error)["residual_pp_mm"] == pytest.approx(1.0, abs=0.01)

    def test_each_arm_has_its_own_end_of_the_move(self):
        signal = np.where(TIME < 1.2 - 1e-9, 0.01 * np.sin(60 * TIME), 0.0)
        error = np.repeat(both(signal, signal)[:, None], 2, axis=1)
        early, late = residual_vibration(error, np.array([0.6, 1.2]))
        assert (early > 0.015).all()
        np.testing.assert_allclose(late, 0, atol=1e-15)

    @examples(50)
    @given(st.floats(0.5, 1.5), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(1e-5, 1e-2))
    def test_scales_with_the_signal_and_ignores_lines(self, end: float, offset: float, drift: float, scale: float):
        signal = np.random.default_rng(0).normal(size=(EPISODE_STEPS, 1, 2))
        line = offset + drift * TIME[:, None, None]
        plain = residual_vibration(signal, np.array([end]))
        np.testing.assert_allclose(
            residual_vibration(scale * signal + line, np.array([end])), scale * plain, rtol=1e-6, atol=1e-12
        )


class TestSettling:
    @pytest.mark.parametrize("axis", [0, 1])
    @pytest.mark.parametrize("sign", [-1, 1])
    @pytest.mark.parametrize("rows_outside", [1, 250, 1199])
    def test_is_the_time_of_the_first_sample_of_the_rest_within_the_band(self, rows_outside: int, sign: int, axis: int):
        error = np.zeros((EPISODE_STEPS, 2))
        error[:rows_outside, axis] = sign * 0.0011
        metrics = evaluate(tip_error=error)
        assert metrics["settling_s"] == pytest.approx((rows_outside + 1) * CONTROL_PERIOD, abs=1e-12)
        assert metrics["settling_s"] == pytest.approx(TIME[rows_outside], abs=1e-12)
        assert metrics["failure_share"] == 0

    def test_the_last_departure_counts(self):
        error = np.zeros((EPISODE_STEPS, 2))
        error[:100, 0] = error[700, 1] = -0.002
        assert evaluate(tip_error=error)["settling_s"] == pytest.approx(702 * CONTROL_PERIOD)

    def test_both_coordinates_must_be_inside_but_not_their_distance(self):
        assert SETTLING_BAND == 0.001
        error = both(held(0.001), held(-0.001))
        assert evaluate(tip_error=error)["settling_s"] == CONTROL_PERIOD

    def test_never(self):
        error = np.zeros((EPISODE_STEPS, 2))
        error[-1, 1] = 0.0011
        metrics = evaluate(tip_error=error)
        assert metrics["settling_s"] == pytest.approx(NEVER)
        assert metrics["failure_share"] == 1
        assert settling_time(error[:, None]) == np.inf

    def test_leaving_the_workspace_is_a_failure_wherever_the_tip_is(self):
        metrics = evaluate(finished=False)
        assert metrics["settling_s"] == pytest.approx(NEVER)
        assert metrics["failure_share"] == 1


class TestTorque:
    def test_rms_of_constants(self):
        torque = np.where(np.arange(EPISODE_STEPS) % 2 == 0, 0.1, -0.1)
        assert evaluate(torque=torque)["torque_rms"] == pytest.approx(0.1)
        torque[: EPISODE_STEPS * 3 // 4] = 0
        assert evaluate(torque=torque)["torque_rms"] == pytest.approx(0.05)

    def test_rate_of_a_ramp_from_rest(self):
        assert evaluate(torque=0.15 * TIME)["torque_rate_rms"] == pytest.approx(0.15)

    @pytest.mark.parametrize("row", [0, 500])
    def test_rate_of_a_step(self, row: int):
        # One change of 0.2 N m among 1200; the motor is without torque before the episode.
        torque = np.where(np.arange(EPISODE_STEPS) >= row, 0.2, 0.0)
        expected = 0.2 / CONTROL_PERIOD / math.sqrt(EPISODE_STEPS)
        assert evaluate(torque=torque)["torque_rate_rms"] == pytest.approx(expected)

    def test_share_of_samples_at_the_limit(self):
        torque = 0.999 * held(0.3)
        torque[:60] = 0.3
        torque[60:120] = -0.3
        torque[120:150] = 0.3 * float(np.float32(0.99999994))  # the largest float32 below 1
        assert evaluate(torque=torque)["saturated_share"] == pytest.approx(0.125)

    @pytest.mark.parametrize(
        ("torque", "count"),
        [
            ([0.0, 0.2, 0.3, 0.2, 0.0], 0),  # never on the other side
            ([0.2, -0.2], 1),
            ([0.2, 0.0, 0.0, -0.2], 1),  # through zero at any speed
            ([0.2, -0.05, -0.2, -0.05, -0.2], 1),  # a swing counts once
            ([0.02, -0.02] * 50, 50 * 2 - 1),  # 0.04 is more than a tenth of 0.3
            ([0.014, -0.014] * 50, 0),  # 0.028 is not
            ([0.025, -0.004] * 50, 0),
            ([0.025, -0.006] * 50, 50 * 2 - 1),  # one side may be small if the other is large
            ([0.2, -0.001, 0.001, -0.001, 0.001], 1),  # chatter after a large torque: one sign change is large
            ([0.01, -0.01, 0.01, -0.25, 0.01, -0.01, 0.25], 2),
            ([0.014, -0.014, 0.02, -0.014], 2),
            ([0.002, -0.014, 0.02], 1),  # from the extremes, wherever it began
            ([-0.1, 0.01, -0.01, 0.01, -0.1, 0.2], 3),  # the small swings between do not count
        ],
    )
    @pytest.mark.parametrize("sign", [-1, 1])
    def test_reversals_of_signals_by_hand(self, torque: list[float], count: int, sign: int):
        signal = np.zeros(EPISODE_STEPS)
        signal[10 : 10 + len(torque)] = sign * np.array(torque)
        assert evaluate(torque=signal)["torque_reversals_hz"] == pytest.approx(count / 1.8)

    @pytest.mark.parametrize(("amplitude", "rate"), [(0.2, 35 / 1.8), (0.0149, 0.0), (0.0151, 35 / 1.8)])
    def test_a_sine_reverses_with_every_half_wave_but_the_first(self, amplitude: float, rate: float):
        signal = amplitude * np.sin(2 * np.pi * 10 * TIME)
        assert evaluate(torque=signal)["torque_reversals_hz"] == pytest.approx(rate)

    def test_reversals_are_relative_to_the_arms_own_limit(self):
        signal = np.tile([0.02, -0.02], EPISODE_STEPS // 2)
        torque, swing = np.column_stack([signal, signal, 10 * signal]), 0.1 * np.array([0.3, 0.5, 0.3])
        assert torque_reversals(torque, swing).tolist() == [EPISODE_STEPS - 1, 0, EPISODE_STEPS - 1]

    def test_limit_is_the_arms_own(self):
        assert evaluate(torque=held(0.2), torque_limit=0.2)["saturated_share"] == 1
        assert evaluate(torque=held(0.2), torque_limit=0.25)["saturated_share"] == 0


class TestAcceleration:
    @pytest.mark.parametrize("axis", [0, 1])
    def test_of_a_known_sinusoid(self, axis: int):
        # v = V sin(w t), ten whole periods in 1199 differences: the acceleration's RMS is V w / sqrt(2).
        rate = 10 * 2 * np.pi / (1199 * CONTROL_PERIOD)
        velocity = np.zeros((EPISODE_STEPS, 2))
        velocity[:, axis] = 0.2 * np.sin(rate * TIME)
        expected = 0.2 * rate / math.sqrt(2)
        assert evaluate(tip_velocity_error=velocity)["tip_acc_rms"] == pytest.approx(expected, rel=2e-4), (
            "differencing: 1e-4"
        )

    def test_of_a_constant_acceleration_in_both_directions(self):
        velocity = both(0.3 * TIME, 1.0 - 0.4 * TIME)
        assert evaluate(tip_velocity_error=velocity)["tip_acc_rms"] == pytest.approx(0.5)

    def test_constant_velocity_has_none(self):
        assert evaluate(tip_velocity_error=held(0.5))["tip_acc_rms"] == 0


def test_torques_are_shown():
    assert set(TORQUES) <= set(SHOWN)


def test_cost_is_passed_on():
    assert evaluate(cost=123.5)["cost"] == 123.5


def test_arms_do_not_mix():
    rng = np.random.default_rng(1)
    error, velocity = rng.normal(scale=2e-3, size=(2, EPISODE_STEPS, 3, 2))
    error[1000:, 1] = 0
    torque = rng.uniform(-0.3, 0.3, (EPISODE_STEPS, 3))
    limit, duration = np.array([0.3, 0.2, 0.25]), np.array([0.6, 0.9, 1.2])
    cost, finished = np.array([1.0, 2.0, 3.0]), np.array([True, True, False])
    together = episode_metrics(error, velocity, torque, limit, duration, cost, finished)
    for arm in range(3):
        alone = evaluate(
            tip_error=error[:, arm],
            tip_velocity_error=velocity[:, arm],
            torque=torque[:, arm],
            torque_limit=limit[arm],
            move_duration=duration[arm],
            cost=cost[arm],
            finished=finished[arm],
        )
        assert {name: value[arm] for name, value in together.items()} == pytest.approx(alone)
    np.testing.assert_array_equal(together["failure_share"], [1, 0, 1])
