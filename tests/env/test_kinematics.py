"""Kinematics of the tip, and what is written out instead of a maths library."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from beltarm_env import ArmParams
from beltarm_env.physics.kinematics import WORKSPACE_MARGIN, tip_motion
from beltarm_env.physics.state import ArmState
from beltarm_env.physics.trigonometry import exponential, polar_angle, sin_cos, sine_cosine, wrapped
from eval.reference.event_located import tip

DEG_90, TURN = math.pi / 2, 2 * math.pi
SPEEDS = st.floats(-10, 10)
ARMS = st.builds(ArmParams, st.floats(1, 200), st.floats(0.05, 1), st.just(0.0) | st.floats(0, 0.5))


@examples(100)
@given(ARMS, st.floats(-WORKSPACE_MARGIN, DEG_90 + WORKSPACE_MARGIN), st.floats(-0.3, 0.3), SPEEDS, SPEEDS)
def test_motion_of_the_tip_is_that_of_the_linkage(
    params: ArmParams, joint: float, torsion: float, speed: float, torsion_speed: float
):
    state = np.array([params.gear_ratio * joint, params.gear_ratio * speed, torsion, torsion_speed])
    step = 1e-5 * np.array([state[1], 0, state[3], 0])
    velocity = (tip(params, state + step) - tip(params, state - step)) / 2e-5
    motion = tip_motion(ArmState(*state.tolist()), params.plant(), None)
    np.testing.assert_allclose(motion[:2], tip(params, state), atol=1e-14)
    np.testing.assert_allclose(motion[2:], velocity, atol=1e-5)


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
