"""Kinematics of the tip, the workspace, and what is written out instead of a maths library."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from properties import examples

from beltarm_env import ArmParams
from beltarm_env.physics.kinematics import WORKSPACE_MARGIN, contained, outside_workspace, tip_errors, tip_motion
from beltarm_env.physics.state import ArmState
from beltarm_env.physics.trigonometry import exponential, polar_angle, sin_cos, sine_cosine, wrapped
from eval.reference.event_located import tip

Floats = NDArray[np.float64]

DEG_90, TURN = math.pi / 2, 2 * math.pi
LOWEST, HIGHEST = -WORKSPACE_MARGIN, DEG_90 + WORKSPACE_MARGIN
NOMINAL = ArmParams()

ANGLES = st.floats(LOWEST, HIGHEST)
SPEEDS = st.floats(-10, 10)
ARMS = st.builds(
    ArmParams,
    gear_ratio=st.floats(1, 200),
    link_length=st.floats(0.05, 1),
    hand_length=st.just(0.0) | st.floats(0, 0.5),
)


def arm_state(params: ArmParams, joint: float, speed: float, torsion: float, torsion_speed: float) -> ArmState:
    return ArmState(params.gear_ratio * joint, params.gear_ratio * speed, torsion, torsion_speed)


class TestTip:
    @examples(100)
    @given(ARMS, ANGLES, st.floats(-0.3, 0.3), SPEEDS, SPEEDS)
    def test_motion_is_that_of_the_linkage(
        self, params: ArmParams, joint: float, torsion: float, speed: float, torsion_speed: float
    ):
        state = np.array(arm_state(params, joint, speed, torsion, torsion_speed))
        step = 1e-5 * np.array([state[1], 0, state[3], 0])
        velocity = (tip(params, state + step) - tip(params, state - step)) / 2e-5
        motion = tip_motion(ArmState(*state.tolist()), params.plant())
        np.testing.assert_allclose(motion[:2], tip(params, state), atol=1e-14)
        np.testing.assert_allclose(motion[2:], velocity, atol=1e-5)

    def test_errors_are_tip_less_reference_and_their_rates(self):
        states = np.array([[60.0, 90.0, 0.04, -2.0], [110.0, -40.0, -0.03, 1.0]])
        references = np.array([[0.7, 1.1], [1.2, -0.6]])

        def errors(time: float) -> Floats:
            moved = [tip(NOMINAL, x + time * np.array([x[1], 0.0, x[3], 0.0])) for x in states]
            angles = references[:, 0] + time * references[:, 1]
            return np.array(moved) - np.column_stack([0.5 * np.cos(angles) + 0.1, np.zeros(2)])

        calculated = tip_errors(states, references, NOMINAL.plant())
        np.testing.assert_allclose(calculated[:, :2], errors(0.0), atol=1e-14)
        np.testing.assert_allclose(calculated[:, 2:], (errors(1e-5) - errors(-1e-5)) / 2e-5, atol=1e-8)


class TestWorkspace:
    @pytest.mark.parametrize(("limit", "outwards"), [(LOWEST, -1.0), (HIGHEST, 1.0)])
    @pytest.mark.parametrize("gear_ratio", [1.0, 88.0])
    def test_limits_of_joint_and_arm(self, limit: float, outwards: float, gear_ratio: float):
        params = replace(NOMINAL, gear_ratio=gear_ratio, link_length=2.0, hand_length=1.0)
        for beyond in (-1e-9, 1e-9):
            lagging = arm_state(params, limit + outwards * beyond, 1e6, 0.1 * outwards, -1e6)
            leading = arm_state(params, limit + outwards * (beyond - 0.1), 0.0, -0.1 * outwards, 0.0)
            for state in (lagging, leading):  # the joint alone is at the limit, or the arm alone
                assert outside_workspace(state, params.plant()) == (beyond > 0)
        exact = ArmParams(gear_ratio=1.0).plant()
        for angle, torsion in ((limit, limit), (limit, 0.0), (0.0, -limit)):
            assert not outside_workspace(ArmState(angle, 0.0, torsion, 0.0), exact), "the limits themselves are inside"

    @pytest.mark.parametrize("field", ArmState._fields)
    def test_a_state_that_runs_away_is_put_at_rest_outside(self, field: str):
        plant = NOMINAL.plant()
        for value in (math.nan, math.inf, -math.inf, -1e9, 1e9):
            wild = ArmState(60.0, 1.0, 0.01, 2.0)._replace(**{field: value})
            assert outside_workspace(wild, plant) or "speed" in field
            state = contained(wild, plant)
            assert state[1:] == (0.0, 0.0, 0.0)
            assert math.isfinite(state.motor_angle) and outside_workspace(state, plant)
        for state in (ArmState(60.0, 1.0, 0.01, 2.0), ArmState(-9e8, 9e8, 9e8, -9e8)):
            assert contained(state, plant) == state


class TestTrigonometry:
    def test_sin_cos(self):
        angles = np.linspace(-2, 2, 20_001)
        series = np.array([sin_cos(angle) for angle in angles])
        assert np.abs(series - np.column_stack([np.sin(angles), np.cos(angles)])).max() <= 1e-15
        for angle in (0.0, 1e-200, 1e-9, 1e-4, *angles[10_000::100]):
            sine, cosine = sin_cos(angle)
            assert sin_cos(-angle) == (-sine, cosine)
            assert angle > 1e-3 or (sine, cosine) == pytest.approx((math.sin(angle), math.cos(angle)), rel=4e-16, abs=0)

    def test_of_any_angle(self):
        for angle in np.append(np.linspace(-30, 30, 2001), [1234.5, -2000.0, -9e5, 3e5]):
            rounding = 1e-15 + 2.3e-16 * abs(angle)  # of whole turns
            assert sine_cosine(float(angle)) == pytest.approx((math.sin(angle), math.cos(angle)), abs=rounding)
            if abs(angle) < 1e4:
                assert wrapped(float(angle)) == pytest.approx(math.remainder(angle, TURN), abs=1e-12)

    def test_polar_angle(self):
        for radius in (1e-200, 1.0, 3e7):
            for angle in np.linspace(0, TURN, 721)[:-1]:
                x, y = radius * math.cos(angle), radius * math.sin(angle)
                assert polar_angle(x, y) == pytest.approx(math.atan2(y, x) % TURN, rel=4e-16, abs=1e-15)
        for x, y, quarters in ((1, 0, 0), (1, 1, 0.5), (0, 1, 1), (-1, 0, 2), (-1, -1, 2.5), (0, -1, 3), (0, 0, 0)):
            assert polar_angle(float(x), float(y)) == pytest.approx(quarters * DEG_90, rel=4e-16, abs=0)

    def test_exponential(self):
        for x in np.append(np.linspace(-700, 700, 1001), np.linspace(-1, 1, 101)):
            assert exponential(float(x)) == pytest.approx(math.exp(x), rel=1e-15, abs=0)
        assert exponential(0.0) == 1.0
        for x in (700.5, 1e4, math.inf):
            assert exponential(x) == exponential(700.0) and exponential(-x) == exponential(-700.0)
