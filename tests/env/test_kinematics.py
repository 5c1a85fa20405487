import math
from dataclasses import astuple, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from properties import examples

from beltarm_env import ArmParams, BeltArmEnv, BeltArmVectorEnv
from beltarm_env.arm import Plant, plant_of
from beltarm_env.physics.kinematics import (
    WORKSPACE_MARGIN,
    contained,
    outside_workspace,
    reference_tip,
    tip_errors,
    tip_motion,
)
from beltarm_env.physics.state import ArmState
from beltarm_env.physics.trigonometry import sin_cos
from eval.reference.event_located import tip

Floats = NDArray[np.float64]

DEG_90 = math.pi / 2
LOWEST, HIGHEST = -WORKSPACE_MARGIN, DEG_90 + WORKSPACE_MARGIN

ANGLES = st.floats(LOWEST, HIGHEST)
TORSIONS = st.floats(-0.3, 0.3)
SPEEDS = st.floats(-10, 10)
ARMS = st.builds(
    ArmParams,
    gear_ratio=st.floats(1, 200),
    link_length=st.floats(0.05, 1),
    hand_length=st.just(0.0) | st.floats(0, 0.5),
)


def plant_for(params: ArmParams) -> Plant:
    return plant_of(np.array(astuple(params)))


def arm_state(params: ArmParams, joint: float, speed: float, torsion: float, torsion_speed: float) -> ArmState:
    return ArmState(params.gear_ratio * joint, params.gear_ratio * speed, torsion, torsion_speed)


class TestTip:
    @examples(100)
    @given(ARMS, ANGLES, TORSIONS)
    def test_position_is_that_of_the_linkage(self, params: ArmParams, joint: float, torsion: float):
        state = arm_state(params, joint, 0.0, torsion, 0.0)
        motion = tip_motion(state, plant_for(params))
        np.testing.assert_allclose(motion[:2], tip(params, np.array(state)), atol=1e-14)

    @examples(100)
    @given(ARMS, ANGLES, TORSIONS, SPEEDS, SPEEDS)
    def test_velocity_is_the_change_of_position(
        self, params: ArmParams, joint: float, torsion: float, speed: float, torsion_speed: float
    ):
        state = np.array(arm_state(params, joint, speed, torsion, torsion_speed))
        step = 1e-5 * np.array([state[1], 0, state[3], 0])
        expected = (tip(params, state + step) - tip(params, state - step)) / 2e-5
        motion = tip_motion(ArmState(*state.tolist()), plant_for(params))
        np.testing.assert_allclose(motion[2:], expected, atol=1e-5)

    @pytest.mark.parametrize(("joint", "x"), [(0.0, 0.6), (math.pi / 3, 0.35), (DEG_90, 0.1)])
    def test_known_positions_of_the_nominal_arm(self, joint: float, x: float):
        params = ArmParams()
        motion = tip_motion(arm_state(params, joint, 0.0, 0.0, 0.0), plant_for(params))
        np.testing.assert_allclose(motion, [x, 0, 0, 0], atol=1e-15)

    @examples(100)
    @given(ARMS, ANGLES, SPEEDS)
    def test_rigid_arm_moves_as_the_reference_tip(self, params: ArmParams, joint: float, speed: float):
        motion = tip_motion(arm_state(params, joint, speed, 0.0, 0.0), plant_for(params))
        x, x_speed = reference_tip(joint, speed, plant_for(params))
        # One rounding of the gear ratio, at the motor and back, is allowed.
        np.testing.assert_allclose([motion.x, motion.x_speed], [x, x_speed], rtol=1e-13, atol=1e-14)
        assert motion.y == 0 and motion.y_speed == 0

    @examples(50)
    @given(ANGLES, SPEEDS)
    def test_reference_tip_is_on_the_line_of_motion(self, angle: float, speed: float):
        x, x_speed = reference_tip(angle, speed, plant_for(ArmParams()))
        assert x == pytest.approx(0.5 * math.cos(angle) + 0.1, abs=1e-15)
        assert x_speed == pytest.approx(-0.5 * math.sin(angle) * speed, abs=1e-14)


@pytest.mark.parametrize("degrees", [0, 30, 45, 60, 90])
def test_a_milliradian_of_torsion_moves_the_tip_by_half_a_millimetre_or_more(degrees: int):
    at = [88 * math.radians(degrees), 0.0, 0.0, 0.0]
    still, twisted = (tip(ArmParams(), np.array([*at[:2], torsion, 0.0])) for torsion in (0.0, 1e-3))
    assert 0.499e-3 < np.linalg.norm(twisted - still) < 0.601e-3


class TestTipError:
    @pytest.mark.parametrize("profile", ["trapezoid", "scurve", "quintic"])
    def test_is_zero_at_rest_on_the_reference(self, profile):
        env = BeltArmVectorEnv(8, profile=profile)
        env.reset(seed=1)
        np.testing.assert_allclose(env.tip_errors(), 0, atol=1e-15)

    def test_is_zero_on_the_way(self):
        env = BeltArmEnv()
        env.reset(options={"move": {"start": 0.3, "goal": 1.2, "duration": 1.0, "ramp_time": 0.3}})
        plant = plant_for(env.params)
        for time in np.arange(0.0, 1.8, 0.1):
            reference = env.reference(time)
            state = arm_state(env.params, reference.angle, reference.speed, 0.0, 0.0)
            x, x_speed = reference_tip(reference.angle, reference.speed, plant)
            np.testing.assert_allclose(tip_motion(state, plant), [x, 0, x_speed, 0], atol=1e-14)

    def test_has_both_directions_and_both_speeds(self):
        env = BeltArmVectorEnv(1)
        move = {"start": 0.3, "goal": 1.2, "duration": 1.0, "ramp_time": 0.3}
        joint, speed, torsion, torsion_speed = 0.32, 0.5, -0.04, 1.5
        state = arm_state(ArmParams(), joint, speed, torsion, torsion_speed)
        env.reset(options={"move": move, "state": np.array(state)})
        expected = np.array(tip_motion(state, plant_for(ArmParams())))
        expected[0] -= 0.5 * math.cos(0.3) + 0.1
        np.testing.assert_allclose(env.tip_errors()[0], expected, rtol=1e-12)
        assert (np.abs(expected) > 1e-3).all()

    def test_of_many_states_by_finite_differences(self):
        params = ArmParams()
        states = np.array([[60.0, 90.0, 0.04, -2.0], [110.0, -40.0, -0.03, 1.0]])
        references = np.array([[0.7, 1.1], [1.2, -0.6]])

        def errors(time: float) -> Floats:
            moved = [tip(params, x + time * np.array([x[1], 0.0, x[3], 0.0])) for x in states]
            angles = references[:, 0] + time * references[:, 1]
            return np.array(moved) - np.column_stack([0.5 * np.cos(angles) + 0.1, np.zeros(2)])

        found = tip_errors(states, references, plant_for(params))
        np.testing.assert_allclose(found[:, :2], errors(0.0), atol=1e-14)
        np.testing.assert_allclose(found[:, 2:], (errors(1e-5) - errors(-1e-5)) / 2e-5, atol=1e-8)


class TestDirectionOfVibration:
    """The motor holds still while the belt is wound up a little: d tip / d torsion."""

    def slope(self, joint: float, params: ArmParams) -> Floats:
        plant = plant_for(params)
        ends = [tip_motion(arm_state(params, joint, 0.0, sign * 1e-6, 0.0), plant)[:2] for sign in (-1, 1)]
        return (np.array(ends[1]) - np.array(ends[0])) / 2e-6

    def test_stretched_arm_vibrates_across_the_line_of_motion_only(self):
        radial, lateral = self.slope(0.0, ArmParams())
        assert radial == pytest.approx(0, abs=1e-9)
        assert lateral == pytest.approx(0.6, abs=1e-9)

    def test_folded_arm_vibrates_nearly_along_it(self):
        radial, lateral = self.slope(DEG_90, ArmParams())
        assert radial == pytest.approx(0.5, abs=1e-9)
        assert lateral == pytest.approx(0.1, abs=1e-9), "the hand's length"
        _, without_hand = self.slope(DEG_90, ArmParams(hand_length=0.0))
        assert without_hand == pytest.approx(0, abs=1e-9)

    @pytest.mark.parametrize("joint", [0.2, 0.7, 1.3])
    def test_in_between(self, joint: float):
        expected = [0.5 * math.sin(joint), 0.5 * math.cos(joint) + 0.1]
        np.testing.assert_allclose(self.slope(joint, ArmParams()), expected, atol=1e-9)


class TestWorkspace:
    INSIDE = 1e-9

    @pytest.mark.parametrize(("limit", "outwards"), [(LOWEST, -1.0), (HIGHEST, 1.0)])
    @pytest.mark.parametrize("gear_ratio", [1.0, 88.0])
    def test_limits_of_the_joint(self, limit: float, outwards: float, gear_ratio: float):
        params = ArmParams(gear_ratio=gear_ratio)
        for beyond in (-self.INSIDE, self.INSIDE):
            # the arm lags behind, so that the joint alone is at the limit
            state = arm_state(params, limit + outwards * beyond, 0.0, 0.1 * outwards, 0.0)
            assert outside_workspace(state, plant_for(params)) == (beyond > 0)

    @pytest.mark.parametrize(("limit", "outwards"), [(LOWEST, -1.0), (HIGHEST, 1.0)])
    def test_limits_of_the_arm(self, limit: float, outwards: float):
        for beyond in (-self.INSIDE, self.INSIDE):
            torsion = -0.1 * outwards
            state = arm_state(ArmParams(), limit + torsion + outwards * beyond, 0.0, torsion, 0.0)
            assert outside_workspace(state, plant_for(ArmParams())) == (beyond > 0)

    @pytest.mark.parametrize("limit", [LOWEST, HIGHEST])
    def test_the_limits_themselves_are_inside(self, limit: float):
        plant = plant_for(ArmParams(gear_ratio=1.0))
        for angle, torsion in ((limit, limit), (limit, 0.0), (0.0, -limit)):
            assert not outside_workspace(ArmState(angle, 0.0, torsion, 0.0), plant)

    def test_margin_is_a_quarter_of_a_radian(self):
        assert math.degrees(LOWEST) == pytest.approx(-14.3, abs=0.05)
        assert math.degrees(HIGHEST) == pytest.approx(104.3, abs=0.05)

    @pytest.mark.parametrize("field", ["motor_angle", "torsion"])
    @pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
    def test_what_is_not_a_number_is_outside(self, field: str, value: float):
        state = ArmState(60.0, 0.0, 0.0, 0.0)._replace(**{field: value})
        assert outside_workspace(state, plant_for(ArmParams()))

    def test_speeds_do_not_matter(self):
        assert not outside_workspace(ArmState(60.0, 1e6, 0.0, -1e6), plant_for(ArmParams()))

    def test_hand_and_links_do_not_matter(self):
        state = arm_state(ArmParams(), HIGHEST - 0.01, 0.0, 0.0, 0.0)
        assert not outside_workspace(state, plant_for(replace(ArmParams(), link_length=2.0, hand_length=1.0)))

    @pytest.mark.parametrize("field", ArmState._fields)
    @pytest.mark.parametrize("value", [math.nan, math.inf, -1e9, 1e9])
    def test_what_runs_away_is_put_at_rest_outside(self, field: str, value: float):
        plant = plant_for(ArmParams())
        state = contained(ArmState(60.0, 1.0, 0.01, 2.0)._replace(**{field: value}), plant)
        assert state[1:] == (0.0, 0.0, 0.0)
        assert math.isfinite(state.motor_angle) and outside_workspace(state, plant)

    def test_what_is_far_but_finite_stays_as_it_is(self):
        for state in (ArmState(60.0, 1.0, 0.01, 2.0), ArmState(-9e8, 9e8, 9e8, -9e8)):
            assert contained(state, plant_for(ArmParams())) == state


class TestSinCos:
    @examples(100)
    @given(st.floats(-2, 2))
    def test_as_the_maths_library(self, angle: float):
        sine, cosine = sin_cos(angle)
        assert abs(sine - math.sin(angle)) <= 1e-15
        assert abs(cosine - math.cos(angle)) <= 1e-15

    def test_largest_error(self):
        angles = np.linspace(-2, 2, 20_001)
        series = np.array([sin_cos(angle) for angle in angles])
        errors = np.abs(series - np.column_stack([np.sin(angles), np.cos(angles)]))
        assert errors.max() <= 1e-15

    def test_parity(self):
        for angle in np.linspace(0, 2, 101):
            sine, cosine = sin_cos(angle)
            assert sin_cos(-angle) == (-sine, cosine)

    @pytest.mark.parametrize("angle", [0.0, 1e-200, 1e-9, 1e-4])
    def test_small_angles_keep_their_digits(self, angle: float):
        assert sin_cos(angle) == pytest.approx((math.sin(angle), math.cos(angle)), rel=4e-16, abs=0)
