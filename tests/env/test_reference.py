"""Reference profiles, and the moves that are drawn."""

import math
import re
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from properties import examples
from scipy.stats import kstest

from beltarm_env import ArmParams, BeltArmEnv
from beltarm_env.arrays import Floats
from beltarm_env.task import moves, reference
from beltarm_env.task.moves import DRAWS, LONGEST_TIME, MOST_TORQUE, SHORTEST, WORKSPACE, check_moves, peak_torque
from beltarm_env.task.reference import PROFILES, QUINTIC, SCURVE, TRAPEZOID, MoveShape, reference_at

ALL = pytest.mark.parametrize("profile", [TRAPEZOID, SCURVE, QUINTIC], ids=PROFILES)
NO_CRUISE = (0.0, math.pi / 2, 1.4, 0.7)
MOVES = [MoveShape(*move) for move in ((0.2, 1.3, 0.9, 0.3), (1.5, 0.0, 1.2, 0.18), NO_CRUISE)]
UNIFORM = st.floats(0, 1, exclude_max=True) | st.sampled_from([0.0, 1 - 2**-53])
UNIFORMS = st.lists(UNIFORM, min_size=DRAWS, max_size=DRAWS)


def path(profile: int, move: MoveShape, times: Floats) -> Floats:
    """Angles, speeds and accelerations of the reference, shape (3, n)."""
    return np.array([reference_at(profile, move, time) for time in times.tolist()]).T


class TestShape:
    @ALL
    @pytest.mark.parametrize("move", MOVES)
    def test_rests_moves_symmetrically_and_rests(self, profile: int, move: MoveShape):
        times, h = np.linspace(-0.1, 1.8, 997), 1e-5
        slopes = (path(profile, move, times + h) - path(profile, move, times - h))[:2] / (2 * h)
        # at the trapezoid's corners the acceleration jumps by up to 30 rad/s^2: h/4 times that
        np.testing.assert_allclose(path(profile, move, times)[1], slopes[0], atol=1e-4)
        corners = np.array([0, move.ramp_time, move.duration - move.ramp_time, move.duration])
        away = (np.abs(times[:, None] - corners) > h).all(axis=1)
        np.testing.assert_allclose(path(profile, move, times)[2][away], slopes[1][away], atol=1e-3)
        assert reference_at(profile, move, 0.0)[:2] == (move.start, 0.0)
        assert reference_at(profile, move, -0.3) == (move.start, 0.0, 0.0)
        for time in (move.duration + 1e-9, 10.0):
            np.testing.assert_allclose(reference_at(profile, move, time), [move.goal, 0.0, 0.0], atol=1e-12)
        np.testing.assert_allclose(reference_at(profile, move, move.duration)[:2], [move.goal, 0.0], atol=1e-12)
        angle, speed, _ = path(profile, move, np.linspace(0, move.duration, 501))
        direction = math.copysign(1, move.goal - move.start)
        assert (direction * speed[1:-1] > 0).all() and (direction * np.diff(angle) > 0).all()
        np.testing.assert_allclose(angle + angle[::-1], move.start + move.goal, atol=1e-12)

    def test_accelerations_that_jump_take_the_value_that_holds_from_then_on(self):
        move = MoveShape(0.0, 1.5, 2.0, 0.5)  # corners that floats hold exactly
        accelerations = [reference_at(TRAPEZOID, move, time).acceleration for time in (0.0, 0.5, 1.5, 2.0)]
        assert accelerations == [2.0, 0.0, -2.0, 0.0]

    @ALL
    @pytest.mark.parametrize("move", MOVES)
    def test_peaks(self, profile: int, move: MoveShape):
        length, cruise_time = abs(move.goal - move.start), move.duration - move.ramp_time
        factor = reference.SCURVE_PEAK_ACCELERATION if profile == SCURVE else 1.0
        highest, steepest = length / cruise_time, factor * length / cruise_time / move.ramp_time
        if profile == QUINTIC:
            highest = reference.QUINTIC_PEAK_SPEED * length / move.duration
            steepest = reference.QUINTIC_PEAK_ACCELERATION * length / move.duration**2
        _, speed, acceleration = path(profile, move, np.linspace(0, move.duration, 8001)[:-1])
        assert np.abs(speed).max() == pytest.approx(highest, rel=1e-6)
        assert np.abs(acceleration).max() == pytest.approx(steepest, rel=1e-4)
        assert profile == TRAPEZOID or np.abs(np.diff(acceleration)).max() < 0.0125 * steepest, "without jumps"


def draw(profile: int, uniforms: Any, **given_values: float) -> Floats:
    uniforms = np.atleast_2d(np.asarray(uniforms, dtype=np.float64))
    given_table = np.full((len(uniforms), 4), np.nan)
    for name, value in given_values.items():
        given_table[:, moves.MOVE_FIELDS.index(name)] = value
    return moves.draw_moves(profile, uniforms, given_table)


def rigid_torque(params: ArmParams, angle: Floats, speed: Floats, acceleration: Floats) -> Floats:
    """Motor torque [N m] for a motion of the rigid arm, from (5a) and (5b) with a belt that does not give."""
    gear, swing = params.gear_ratio, params.arm_inertia_swing
    m2 = params.arm_inertia + swing * np.sin(angle) ** 2
    at_joint = m2 * acceleration + swing * np.sin(angle) * np.cos(angle) * speed**2
    at_motor = gear * (params.motor_inertia * acceleration + params.motor_viscous_friction * speed)
    return at_motor + params.coulomb_friction * np.sign(speed) + at_joint / gear


class TestDrawnMoves:
    @ALL
    @examples(100)
    @given(
        uniforms=UNIFORMS,
        fixed=st.fixed_dictionaries({}, optional={"duration": st.floats(0.35, LONGEST_TIME)})
        | st.fixed_dictionaries({"ramp_time": st.floats(0.04, LONGEST_TIME / 2)}),
        end=st.dictionaries(st.sampled_from(["start", "goal"]), st.floats(0, WORKSPACE), max_size=1),
    )
    @example(uniforms=[0.0] * DRAWS, fixed={"ramp_time": 0.041015625}, end={})  # by rounding longer than allowed
    def test_are_feasible_and_within_bounds_whatever_values_are_given(
        self, profile: int, uniforms: list[float], fixed: dict[str, float], end: dict[str, float]
    ):
        assert moves.shortest_duration(profile, SHORTEST, 0.35) < 0.35, "else no move would be"
        assert peak_torque(profile, SHORTEST, 1.0, 0.04) < MOST_TORQUE, "else no move would be"
        given_values = fixed | ({} if "ramp_time" in fixed else end)
        table = draw(profile, uniforms, **given_values)
        check_moves(profile, table)
        for name, value in given_values.items():
            assert table[0, moves.MOVE_FIELDS.index(name)] == value
        move = MoveShape(*draw(profile, uniforms)[0].tolist())
        length = abs(move.goal - move.start)
        assert min(move.start, move.goal) >= 0 and max(move.start, move.goal) <= WORKSPACE + 1e-15
        assert length >= SHORTEST - 1e-15
        assert 0.5 <= move.duration <= 1.2 + 1e-12
        assert 0.15 - 1e-12 <= move.ramp_time / move.duration <= 0.35 + 1e-12
        assert peak_torque(profile, length, move.duration, move.ramp_time) <= MOST_TORQUE + 1e-12


class TestDistribution:
    MOVES = draw(TRAPEZOID, np.random.default_rng(7).random((20_000, DRAWS)))

    def test_start_and_goal_are_uniform_over_the_pairs_15_degrees_apart(self):
        pairs = WORKSPACE * np.random.default_rng(9).random((1_000_000, 2))
        pairs[:100_000, 0] = 0.4
        pairs = pairs[np.abs(pairs[:, 1] - pairs[:, 0]) >= SHORTEST]
        given_start = draw(TRAPEZOID, np.random.default_rng(8).random((5000, DRAWS)), start=0.4)
        drawn, free = self.MOVES[:, :2], pairs[:, 0] != 0.4
        for weights in ([1, 0], [0, 1], [1, 1], [1, -1]):
            assert kstest(drawn @ weights, pairs[free] @ weights).pvalue > 0.01
        assert kstest(given_start[:, 1], pairs[~free, 1]).pvalue > 0.01

    def test_directions_and_ramps(self):
        start, goal, duration, ramp_time = self.MOVES.T
        assert abs(np.mean(goal > start) - 0.5) < 4 * 0.5 / math.sqrt(len(start))
        share = ramp_time / duration
        assert kstest(share, "uniform", args=(0.15, 0.2)).pvalue > 0.01
        assert abs(np.corrcoef(share, start)[0, 1]) < 0.03


class TestFeasibility:
    @ALL
    @examples(60)
    @given(st.floats(SHORTEST, WORKSPACE), st.floats(0, 1), st.floats(0.3, 1.5), st.floats(0.02, 0.5))
    def test_torque_that_a_move_needs(self, profile: int, length: float, low: float, duration: float, share: float):
        assert pytest.approx(0.8 * 0.3) == MOST_TORQUE
        shortest = moves.shortest_duration(profile, length, share)
        assert peak_torque(profile, length, shortest, share * shortest) == pytest.approx(MOST_TORQUE, rel=1e-12)
        assert peak_torque(profile, length, 1.01 * shortest, share * 1.01 * shortest) < MOST_TORQUE
        start, share = low * (WORKSPACE - length), max(share, 0.1)
        claim = peak_torque(profile, length, duration, share * duration)
        rising = MoveShape(start, start + length, duration, share * duration)
        for move in (rising, rising._replace(start=rising.goal, goal=rising.start)):
            torque = rigid_torque(ArmParams(), *path(profile, move, np.linspace(0, duration, 200)))
            assert 0.5 * claim <= np.abs(torque).max() <= claim + 1e-9, "a claim, not just a large number"

    @ALL
    def test_moves_at_the_bounds_pass(self, profile: int):
        bounds = [
            *((0.2, 1.2, 1.0, 0.25), (1.2, 0.2, 1.0, 0.25), (0.0, math.pi / 2, 1.2, 0.4)),
            *((0.0, math.pi / 2, LONGEST_TIME, 0.3), (0.5, 0.5 + SHORTEST, 1.0, 0.5), (0.5 + SHORTEST, 0.5, 1.0, 0.2)),
            (0.0, 1.0, np.nextafter(LONGEST_TIME, 2), 0.5),  # a rounding error longer
        ]
        check_moves(profile, np.array(bounds))
        with pytest.raises(ValueError, match="duration"):
            check_moves(profile, np.array([*bounds, (0.0, 1.0, LONGEST_TIME + 1e-6, 0.5)]))

    @ALL
    def test_the_time_that_a_refusal_says_to_allow_is_enough(self, profile: int):
        with pytest.raises(ValueError, match="infeasible") as caught:
            check_moves(profile, np.array([[0.0, 1.5, 0.2, 0.05]]))
        duration = float(re.findall(r"allow ([\d.]+) s", str(caught.value))[0])
        check_moves(profile, np.array([[0.0, 1.5, duration, duration / 4]]))
        with pytest.raises(ValueError, match="infeasible"):
            check_moves(profile, np.array([[0.0, 1.5, 0.99 * duration, 0.99 * duration / 4]]))

    def test_the_arm_of_an_episode_does_not_matter(self):
        env, move = BeltArmEnv(), {"start": 0.2, "goal": 1.2, "duration": 0.8, "ramp_time": 0.25}
        env.reset(options={"move": move, "params": {"motor_inertia": 1e-4, "coulomb_friction": 0.2}})
        assert env.move == pytest.approx(move)
