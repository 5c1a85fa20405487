import math
import re
from typing import Any, Literal, NamedTuple

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from numpy.typing import NDArray
from properties import examples
from scipy.stats import kstest

from beltarm_env import CONTROL_PERIOD, ArmParams, BeltArmEnv, observation
from beltarm_env.task import reference as reference_module
from beltarm_env.task.moves import (
    DRAWS,
    LONGEST_TIME,
    MOST_TORQUE,
    MOVE_FIELDS,
    SHORTEST,
    WORKSPACE,
    check_moves,
    draw_moves,
    peak_torque,
    shortest_duration,
)
from beltarm_env.task.reference import PROFILES, QUINTIC, SCURVE, TRAPEZOID, MoveShape, reference_at

Floats = NDArray[np.float64]
Profile = Literal["trapezoid", "scurve", "quintic"]

NO_TORQUE = np.zeros(1, np.float32)
ALL = pytest.mark.parametrize("profile", [TRAPEZOID, SCURVE, QUINTIC], ids=PROFILES)
MOVES = [
    MoveShape(0.2, 1.3, 0.9, 0.3),
    MoveShape(1.5, 0.0, 1.2, 0.18),
    MoveShape(0.0, math.pi / 2, 1.4, 0.7),  # no cruise
]
SOME = pytest.mark.parametrize("move", MOVES)
UNIFORMS = st.lists(
    st.floats(0, 1, exclude_max=True) | st.sampled_from([0.0, 1 - 2**-53]), min_size=DRAWS, max_size=DRAWS
)


class Path(NamedTuple):
    """Reference at many times."""

    angle: Floats
    speed: Floats
    acceleration: Floats


def path(profile: int, move: MoveShape, times: Floats) -> Path:
    return Path(*np.array([reference_at(profile, move, time) for time in times.tolist()]).T)


def away_from_corners(move: MoveShape, times: Floats, margin: float) -> Floats:
    corners = np.array([0, move.ramp_time, move.duration - move.ramp_time, move.duration])
    return times[(np.abs(times[:, None] - corners) > margin).all(axis=1)]


class TestShape:
    @ALL
    @SOME
    def test_speed_is_the_change_of_the_angle(self, profile: int, move: MoveShape):
        times, h = np.linspace(-0.1, 1.8, 997), 1e-5
        slope = (path(profile, move, times + h).angle - path(profile, move, times - h).angle) / (2 * h)
        # at the trapezoid's corners the acceleration jumps by up to 30 rad/s^2: h/4 times that
        np.testing.assert_allclose(path(profile, move, times).speed, slope, atol=1e-4)

    @ALL
    @SOME
    def test_acceleration_is_the_change_of_the_speed(self, profile: int, move: MoveShape):
        h = 1e-5
        times = away_from_corners(move, np.linspace(-0.1, 1.8, 997), h)
        slope = (path(profile, move, times + h).speed - path(profile, move, times - h).speed) / (2 * h)
        np.testing.assert_allclose(path(profile, move, times).acceleration, slope, atol=1e-3)

    @ALL
    @SOME
    def test_begins_at_the_start_at_rest(self, profile: int, move: MoveShape):
        assert reference_at(profile, move, 0.0)[:2] == (move.start, 0.0)
        assert reference_at(profile, move, -0.3) == (move.start, 0.0, 0.0)

    @ALL
    @SOME
    def test_rests_at_the_goal_ever_after(self, profile: int, move: MoveShape):
        rest = [move.goal, 0.0, 0.0]
        for time in (move.duration + 1e-9, move.duration + 0.1, 1.8, 10.0):
            np.testing.assert_allclose(reference_at(profile, move, time), rest, atol=1e-12)
        np.testing.assert_allclose(reference_at(profile, move, move.duration)[:2], rest[:2], atol=1e-12)

    @ALL
    @SOME
    def test_is_monotone_and_symmetric(self, profile: int, move: MoveShape):
        times = np.linspace(0, move.duration, 501)
        angle, speed, acceleration = path(profile, move, times)
        direction = math.copysign(1, move.goal - move.start)
        assert (direction * speed[1:-1] > 0).all() and (direction * np.diff(angle) > 0).all()
        np.testing.assert_allclose(angle + angle[::-1], move.start + move.goal, atol=1e-12)
        np.testing.assert_allclose(speed, speed[::-1], atol=1e-11)
        inside = np.isin(times, away_from_corners(move, times, 1e-6))
        np.testing.assert_allclose(acceleration[inside], -acceleration[::-1][inside], atol=1e-9)

    @SOME
    def test_trapezoid_is_the_papers(self, move: MoveShape):
        cruise = (move.goal - move.start) / (move.duration - move.ramp_time)
        for share in (0.0, 0.25, 0.9):
            reference = reference_at(TRAPEZOID, move, share * move.ramp_time)
            assert reference.speed == pytest.approx(share * cruise)
            assert reference.acceleration == pytest.approx(cruise / move.ramp_time)
        middle = reference_at(TRAPEZOID, MOVES[0], 0.45)
        assert middle == pytest.approx((0.75, 1.1 / 0.6, 0.0))

    def test_accelerations_that_jump_take_the_value_that_holds_from_then_on(self):
        move = MoveShape(0.0, 1.5, 2.0, 0.5)  # corners that floats hold exactly
        found = [reference_at(TRAPEZOID, move, time).acceleration for time in (0.0, 0.5, 1.5, 2.0)]
        assert found == [2.0, 0.0, -2.0, 0.0]

    @pytest.mark.parametrize("profile", [SCURVE, QUINTIC])
    @SOME
    def test_smooth_profiles_have_no_jumps_of_acceleration(self, profile: int, move: MoveShape):
        acceleration = path(profile, move, np.linspace(-0.1, 1.8, 20_001)).acceleration
        assert np.abs(np.diff(acceleration)).max() < 0.005 * np.abs(acceleration).max()

    def test_quintic_ignores_the_ramp_time(self):
        times = np.linspace(0, 1.8, 100)
        short, long = (path(QUINTIC, MOVES[0]._replace(ramp_time=ramp_time), times) for ramp_time in (0.05, 0.4))
        np.testing.assert_array_equal(short, long)


def peaks(profile: int, move: MoveShape) -> tuple[float, float]:
    """Largest speed and acceleration of a finely sampled move."""
    _, speed, acceleration = path(profile, move, np.linspace(0, move.duration, 4001)[:-1])
    return float(np.abs(speed).max()), float(np.abs(acceleration).max())


class TestPeaks:
    @SOME
    def test_trapezoid_and_scurve(self, move: MoveShape):
        cruise = abs(move.goal - move.start) / (move.duration - move.ramp_time)
        for profile, factor in ((TRAPEZOID, 1.0), (SCURVE, reference_module.SCURVE_PEAK_ACCELERATION)):
            speed, acceleration = peaks(profile, move)
            assert speed == pytest.approx(cruise)
            assert acceleration == pytest.approx(factor * cruise / move.ramp_time, rel=1e-4)

    @SOME
    def test_quintic(self, move: MoveShape):
        length = abs(move.goal - move.start)
        speed, acceleration = peaks(QUINTIC, move)
        assert speed == pytest.approx(reference_module.QUINTIC_PEAK_SPEED * length / move.duration, rel=1e-6)
        expected = reference_module.QUINTIC_PEAK_ACCELERATION * length / move.duration**2
        assert acceleration == pytest.approx(expected, rel=1e-5)


class TestInTheEnvironment:
    @pytest.mark.parametrize("profile", PROFILES)
    def test_what_is_seen_ahead_comes_true(self, profile: Profile):
        env = BeltArmEnv(profile=profile)
        first, _ = env.reset(seed=3)
        seen = [observation.decode(first)]
        for _ in range(500):
            seen.append(observation.decode(env.step(NO_TORQUE)[0]))
        for ahead in observation.LOOKAHEADS:
            samples = round(ahead / CONTROL_PERIOD)
            if not math.isclose(samples * CONTROL_PERIOD, ahead):
                continue  # between two samples: see below
            for now, later in zip(seen, seen[samples:], strict=False):
                told = now[f"reference_speed_ahead_{1000 * ahead:.0f}ms"]
                assert told == pytest.approx(later["reference_speed"], abs=1e-6)
        assert sum(math.isclose(round(t / CONTROL_PERIOD) * CONTROL_PERIOD, t) for t in observation.LOOKAHEADS) >= 3

    @pytest.mark.parametrize("profile", PROFILES)
    def test_entries_are_the_reference_at_those_times(self, profile: Profile):
        env = BeltArmEnv(profile=profile)
        env.reset(seed=4)
        for _ in range(600):
            seen = observation.decode(env.step(NO_TORQUE)[0])
            now = env.reference(env.time)
            assert [seen[f"reference_{name}"] for name in now._fields] == pytest.approx(list(now), rel=1e-6, abs=1e-6)
            for ahead in observation.LOOKAHEADS:
                expected = env.reference(env.time + ahead)
                label = f"ahead_{1000 * ahead:.0f}ms"
                assert seen[f"reference_speed_{label}"] == pytest.approx(expected.speed, rel=1e-6, abs=1e-6)
                assert seen[f"reference_acceleration_{label}"] == pytest.approx(
                    expected.acceleration, rel=1e-6, abs=1e-5
                )

    @pytest.mark.parametrize("profile", PROFILES)
    def test_the_whole_reference_can_be_rebuilt_from_one_observation(self, profile: Profile):
        env = BeltArmEnv(profile=profile)
        first, _ = env.reset(seed=5)
        seen = observation.decode(first)
        move = MoveShape(*(float(seen[name]) for name in MOVE_FIELDS))
        for time in np.arange(0, 1.8, 0.0371):
            rebuilt = reference_at(PROFILES.index(profile), move, time)
            assert rebuilt[:2] == pytest.approx(env.reference(time)[:2], abs=1e-5)


def draw(profile: int, uniforms: Any, **given_values: float) -> Floats:
    uniforms = np.atleast_2d(np.asarray(uniforms, dtype=np.float64))
    given_table = np.full((len(uniforms), 4), np.nan)
    for name, value in given_values.items():
        given_table[:, MOVE_FIELDS.index(name)] = value
    return draw_moves(profile, uniforms, given_table)


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
    @given(uniforms=UNIFORMS)
    def test_are_within_bounds_and_feasible(self, profile: int, uniforms: list[float]):
        ((start, goal, duration, ramp_time),) = draw(profile, uniforms).tolist()
        length = abs(goal - start)
        assert min(start, goal) >= 0 and max(start, goal) <= WORKSPACE + 1e-15
        assert length >= SHORTEST - 1e-15
        assert 0.5 <= duration <= 1.2 + 1e-12
        assert 0.15 - 1e-12 <= ramp_time / duration <= 0.35 + 1e-12
        assert peak_torque(profile, length, duration, ramp_time) <= MOST_TORQUE + 1e-12
        check_moves(profile, np.array([[start, goal, duration, ramp_time]]))

    @ALL
    @examples(100)
    @given(uniforms=UNIFORMS, end=st.floats(0, WORKSPACE), which=st.sampled_from(["start", "goal"]))
    def test_with_one_end_given(self, profile: int, uniforms: list[float], end: float, which: str):
        table = draw(profile, uniforms, **{which: end})
        assert table[0, MOVE_FIELDS.index(which)] == end
        check_moves(profile, table)

    @ALL
    @examples(100)
    @given(uniforms=UNIFORMS)
    def test_rigid_arm_never_needs_more_than_they_claim(self, profile: int, uniforms: list[float]):
        (row,) = draw(profile, uniforms).tolist()
        move = MoveShape(*row)
        torque = rigid_torque(ArmParams(), *path(profile, move, np.linspace(0, move.duration, 400)))
        claim = peak_torque(profile, abs(move.goal - move.start), move.duration, move.ramp_time)
        assert np.abs(torque).max() <= claim + 1e-12
        assert np.abs(torque).max() >= 0.5 * claim, "a claim, not just a large number"

    def test_given_values_are_taken_as_they_are(self):
        values = {"start": 0.3, "goal": 1.1, "duration": 1.05, "ramp_time": 0.21}
        np.testing.assert_array_equal(draw(TRAPEZOID, [[0.5] * DRAWS], **values), [list(values.values())])
        for name, value in values.items():
            assert draw(TRAPEZOID, [[0.9] * DRAWS], **{name: value})[0, MOVE_FIELDS.index(name)] == value

    @ALL
    @examples(100)
    @given(
        uniforms=UNIFORMS,
        duration=st.floats(0.35, LONGEST_TIME),
        end=st.just({}) | st.dictionaries(st.sampled_from(["start", "goal"]), st.floats(0, WORKSPACE), max_size=1),
    )
    def test_with_a_given_duration_are_feasible(
        self, profile: int, uniforms: list[float], duration: float, end: dict[str, float]
    ):
        assert shortest_duration(profile, SHORTEST, 0.35) < 0.35, "else no move would be"
        check_moves(profile, draw(profile, uniforms, duration=duration, **end))

    @ALL
    @examples(100)
    @given(uniforms=UNIFORMS, ramp_time=st.floats(0.04, LONGEST_TIME / 2))
    @example(uniforms=[0.0] * DRAWS, ramp_time=0.041015625)  # the longest move, by rounding longer than allowed
    def test_with_a_given_ramp_time_are_feasible(self, profile: int, uniforms: list[float], ramp_time: float):
        assert peak_torque(profile, SHORTEST, 1.0, 0.04) < MOST_TORQUE, "else no move would be"
        check_moves(profile, draw(profile, uniforms, ramp_time=ramp_time))

    def test_long_ramps_are_given_the_time_they_need(self):
        table = draw(TRAPEZOID, np.random.default_rng(0).random((500, DRAWS)), ramp_time=0.45)
        assert (table[:, 2] >= 0.9).all()
        check_moves(TRAPEZOID, table)

    def test_the_longest_duration_may_be_a_rounding_error_longer(self):
        table = np.array([[0.0, 1.0, np.nextafter(LONGEST_TIME, 2), 0.5], [0.0, 1.0, LONGEST_TIME + 1e-6, 0.5]])
        check_moves(TRAPEZOID, table[:1])
        with pytest.raises(ValueError, match=r"duration must be positive and at most 1\.5 s"):
            check_moves(TRAPEZOID, table)

    @ALL
    def test_durations_scale_with_the_length(self, profile: int):
        table = draw(profile, np.random.default_rng(0).random((4000, DRAWS)))
        length, duration = np.abs(table[:, 1] - table[:, 0]), table[:, 2]
        short, long = duration[length < math.radians(25)], duration[length > math.radians(75)]
        assert short.mean() < 0.7 < 0.9 < long.mean()


@pytest.fixture(scope="module")
def ends() -> Floats:
    """Start and goal of many moves."""
    return draw(TRAPEZOID, np.random.default_rng(7).random((20_000, DRAWS)))[:, :2]


class TestDistribution:
    """Start and goal are to be uniform over the pairs at least 15 degrees apart."""

    @staticmethod
    def room(end: Floats) -> Floats:
        """Length of what the workspace leaves for the other end."""
        return np.maximum(end - SHORTEST, 0) + np.maximum(WORKSPACE - SHORTEST - end, 0)

    def test_both_directions_alike(self, ends: Floats):
        rising = np.mean(ends[:, 1] > ends[:, 0])
        assert abs(rising - 0.5) < 4 * 0.5 / math.sqrt(len(ends))

    @pytest.mark.parametrize("column", [0, 1])
    def test_each_end_is_as_likely_as_it_leaves_room(self, ends: Floats, column: int):
        grid = np.linspace(0, WORKSPACE, 20_001)
        density = self.room(grid)
        cumulative = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2)])
        assert kstest(ends[:, column], lambda x: np.interp(x, grid, cumulative / cumulative[-1])).pvalue > 0.01

    @pytest.mark.parametrize("which", [0, 1])
    def test_the_other_end_is_uniform_over_that_room(self, ends: Floats, which: int):
        end, other = ends[:, which], ends[:, 1 - which]
        below = np.maximum(end - SHORTEST, 0)
        place = np.where(other < end, other, other - end - SHORTEST + below) / self.room(end)
        assert kstest(place, "uniform").pvalue > 0.01

    @pytest.mark.parametrize("end", [0.0, 0.4, math.pi / 4, math.pi / 2])
    def test_the_other_end_of_a_given_one_is_uniform(self, end: float):
        goals = draw(TRAPEZOID, np.random.default_rng(8).random((5000, DRAWS)), start=end)[:, 1]
        below = max(end - SHORTEST, 0)
        place = np.where(goals < end, goals, goals - end - SHORTEST + below) / self.room(np.array([end]))
        assert kstest(place, "uniform").pvalue > 0.01

    def test_pace_and_ramps_are_uniform_and_independent(self):
        uniforms = np.random.default_rng(9).random((5000, DRAWS))
        table = draw(TRAPEZOID, uniforms)
        share = table[:, 3] / table[:, 2]
        assert kstest(share, "uniform", args=(0.15, 0.2)).pvalue > 0.01
        assert abs(np.corrcoef(share, table[:, 0])[0, 1]) < 0.06


class TestFeasibility:
    @ALL
    @examples(100)
    @given(length=st.floats(SHORTEST, WORKSPACE), share=st.floats(0.02, 0.5))
    def test_shortest_duration_needs_just_the_torque_allowed(self, profile: int, length: float, share: float):
        duration = shortest_duration(profile, length, share)
        assert peak_torque(profile, length, duration, share * duration) == pytest.approx(MOST_TORQUE, rel=1e-12)
        longer = 1.01 * duration
        assert peak_torque(profile, length, longer, share * longer) < MOST_TORQUE

    def test_torque_allowed_is_four_fifths_of_the_limit(self):
        assert pytest.approx(0.8 * 0.3) == MOST_TORQUE

    @ALL
    @examples(60)
    @given(
        length=st.floats(SHORTEST, WORKSPACE),
        low=st.floats(0, 1),
        duration=st.floats(0.3, 1.5),
        share=st.floats(0.1, 0.5),
    )
    def test_claim_holds_for_any_move(self, profile: int, length: float, low: float, duration: float, share: float):
        start = low * (WORKSPACE - length)
        claim = peak_torque(profile, length, duration, share * duration)
        rising = MoveShape(start, start + length, duration, share * duration)
        for move in (rising, rising._replace(start=rising.goal, goal=rising.start)):
            torque = rigid_torque(ArmParams(), *path(profile, move, np.linspace(0, duration, 200)))
            assert np.abs(torque).max() <= claim + 1e-9


GOOD = MoveShape(0.2, 1.2, 1.0, 0.25)
BAD: list[tuple[dict[str, float], str]] = [
    ({"start": -0.01}, r"start must lie within 0 and pi/2 rad, got \(start=-0\.01, goal=1\.2,"),
    ({"start": 1.6, "goal": 0.5}, r"start must lie within 0 and pi/2 rad, got \(start=1\.6,"),
    ({"goal": 1.6}, r"goal must lie within 0 and pi/2 rad, got .*goal=1\.6"),
    ({"goal": -1e-3}, r"goal must lie within 0 and pi/2 rad, got .*goal=-0\.001"),
    ({"goal": 0.4}, r"start and goal must be at least 0\.2618 rad \(15 degrees\) apart, got .*goal=0\.4"),
    ({"goal": 0.2}, r"at least 0\.2618 rad"),
    ({"duration": 0.0}, r"duration must be positive and at most 1\.5 s, got .*duration=0,"),
    ({"duration": -1.0}, r"duration must be positive"),
    ({"duration": 1.51}, r"duration must be positive and at most 1\.5 s, got .*duration=1\.51"),
    ({"ramp_time": 0.0}, r"ramp_time must be positive and at most half the duration, got .*ramp_time=0\)"),
    ({"ramp_time": 0.51}, r"ramp_time must be positive and at most half the duration, got .*ramp_time=0\.51\)"),
    ({"ramp_time": 0.02}, r"infeasible move .*ramp_time=0\.02\).*needs .* N m, more than 80% of its limit, 0\.240 N m"),
    ({"duration": 0.4, "ramp_time": 0.15}, r"infeasible move .*duration=0\.4.*; with ramps of the same share, allow "),
    ({"start": math.nan}, r"all values must be finite, got \(start=nan"),
    ({"duration": math.inf}, r"all values must be finite, got .*duration=inf"),
]


class TestCheckMoves:
    @ALL
    def test_good_ones_pass(self, profile: int):
        check_moves(profile, np.array([GOOD, GOOD._replace(start=1.2, goal=0.2), (0.0, math.pi / 2, 1.2, 0.4)]))

    @pytest.mark.parametrize(("change", "message"), BAD)
    def test_bad_ones_are_named(self, change: dict[str, float], message: str):
        table = np.array([GOOD, GOOD._replace(**change), GOOD])
        with pytest.raises(ValueError, match=message):
            check_moves(TRAPEZOID, table)

    @pytest.mark.parametrize(
        "move",
        [(0.0, math.pi / 2, LONGEST_TIME, 0.3), (0.5, 0.5 + SHORTEST, 1.0, 0.5), (0.5 + SHORTEST, 0.5, 1.0, 0.2)],
    )
    def test_bounds_themselves_are_allowed(self, move: tuple[float, ...]):
        check_moves(TRAPEZOID, np.array([move]))

    @ALL
    @pytest.mark.parametrize("length", [0.3, 0.7, 1.1, 1.5])
    def test_the_time_it_says_to_allow_is_enough(self, profile: int, length: float):
        with pytest.raises(ValueError, match="infeasible") as caught:
            check_moves(profile, np.array([[0.0, length, 0.2, 0.05]]))
        (advice,) = re.findall(r"allow ([\d.]+) s", str(caught.value))
        duration = float(advice)
        check_moves(profile, np.array([[0.0, length, duration, duration / 4]]))
        shorter = 0.99 * duration
        with pytest.raises(ValueError, match="infeasible"):
            check_moves(profile, np.array([[0.0, length, shorter, shorter / 4]]))

    def test_the_arm_of_an_episode_does_not_matter(self):
        # Feasible is what the nominal arm can do: the same moves are allowed whatever was drawn.
        env = BeltArmEnv()
        move = {"start": 0.2, "goal": 1.2, "duration": 0.8, "ramp_time": 0.25}
        env.reset(options={"move": move, "params": {"motor_inertia": 1e-4, "coulomb_friction": 0.2}})
        assert env.move == pytest.approx(move)
