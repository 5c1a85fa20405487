"""Observers and the identification against the truth, with the encoder alone and with an accelerometer."""

from dataclasses import asdict, replace
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from episodes import memory_after
from scipy.linalg import solve_discrete_are

from baselines.estimation import believed_arm as arm_of
from baselines.estimation.accelerometer import SPREAD, acceleration_slopes, steady_accelerometer_gain, unfiltered
from baselines.estimation.believed_arm import DELAY, GIVING, IDENTIFIED, LOGS, NOMINAL_DEFLECTION, nominal_row
from baselines.estimation.filter_design import _ARM_DOUBT, _PART_DOUBT, PART
from baselines.estimation.identification import ArmIdentifier, Belief
from baselines.estimation.observer import AHEAD, QUANTUM, Noise, kalman_gains
from baselines.gains import tuned
from baselines.models.linear import ANGLES, linear_arm
from baselines.optimal.adaptive import AdaptiveController, AdaptiveGains, tuned_identifier
from baselines.reading import Reading, read
from baselines.registry import CONTROLLERS, WITH_ACCELEROMETER
from beltarm_env import CONTROL_PERIOD, EPISODE_STEPS, ArmParams, BeltArmVectorEnv, design_model
from beltarm_env.arm import COLUMN, FIELDS
from beltarm_env.arrays import Flags, Floats
from beltarm_env.observation import decode
from beltarm_env.rollout import rollout
from beltarm_env.task.accelerometer import BIAS, RANGE
from beltarm_env.task.ranges import PART_MASS, PRESLIDING, TRAIN_RANGES

GEAR = 88.0
SEED = 5_210_000  # of the gains' search
STEPS = 1200


class TestObserver:
    @pytest.mark.parametrize("k", [0, 22, 45])
    def test_gain_is_that_of_riccatis_equation(self, k: int):
        noise, (transition, by_torque, by_noise) = Noise(1e-2, 30.0, 0.2), (part[k] for part in linear_arm(ArmParams()))
        a, process = np.eye(5), np.zeros((5, 5))
        a[:4, :4], a[:4, 4] = transition, by_torque  # a load on the motor is the fifth state
        process[:4, :4] = noise.torque**2 * np.outer(by_torque, by_torque)
        process[:4, :4] += noise.acceleration**2 * np.outer(by_noise, by_noise)
        process[4, 4] = noise.disturbance**2 * CONTROL_PERIOD
        before = solve_discrete_are(a.T, np.eye(5)[:, :1], process, np.array([[QUANTUM**2 / 12]]))
        expected = before[:, 0] / (before[0, 0] + QUANTUM**2 / 12)
        np.testing.assert_allclose(kalman_gains(ArmParams(), noise)[k], expected, rtol=1e-4)

    @staticmethod
    def observed(params: ArmParams, command: Any, steps: int, encoder_counts: int = 10_000_000) -> list[Floats]:
        """True states, their estimates, and those for when a command acts: shapes (steps, 4)."""
        env = BeltArmVectorEnv(1, autoreset_mode="Disabled", encoder_counts=encoder_counts)
        observations, _ = env.reset(options={"params": asdict(params), "state": [GEAR * 0.8, 0.0, 0.0, 0.0]})
        controller, memory, rows = CONTROLLERS["lqg"](params), None, []
        for k in range(steps):
            _, memory = controller.predict(observations, memory)
            rows.append((env.state[0], memory[0, :4], memory[0, AHEAD]))
            observations, *_ = env.step(np.array([[command(k) / 0.3]], np.float32))
        return [np.array(part) for part in zip(*rows, strict=True)]

    def test_knows_the_torsion_behind_a_stuck_motor(self):
        true, believed, _ = self.observed(ArmParams(), lambda k: 0.12 if k < 150 else 0.0, 700, 4000)
        assert (true[400:, 1] == 0.0).all(), "stuck"
        rings = np.ptp(true[400:, 2])
        assert rings > 0.01 and np.abs(true - believed)[400:, 2].max() < 0.03 * rings

    @pytest.mark.parametrize("latency", [0.0, 0.75, 2.9])
    def test_state_ahead_is_the_one_that_comes(self, latency: float):
        params = replace(design_model(), command_latency=latency * CONTROL_PERIOD)
        true, actual, ahead = self.observed(params, lambda k: 0.15 if k < 60 else -0.15, 150)
        assert (np.abs(actual - true).max(axis=0) < [1e-4, 0.02, 1e-5, 2e-3]).all()
        late = latency + params.current_loop_time_constant / CONTROL_PERIOD
        whole, part = int(late), late - int(late)
        for first in (20, 80):  # where the command has not changed for a while
            later = true[first + whole : first + whole + 30], true[first + whole + 1 : first + whole + 31]
            expected = later[0] + part * (later[1] - later[0])
            errors = np.abs(ahead[first : first + 30] - expected).max(axis=0)
            assert (errors < [1e-3, 0.02, 1e-5, 2e-3]).all()


@cache
def followed() -> tuple[Floats, Floats, Floats, Any]:
    """States and readings of drawn arms at every sample, their constants, and the controller's memory at the end."""
    arms = 6
    env = BeltArmVectorEnv(arms, autoreset_mode="Disabled", randomization="train", sensors="accelerometer")
    observation, _ = env.reset(seed=SEED)
    controller, memory, states, felt = WITH_ACCELEROMETER["adaptive"](), None, [], []
    for _ in range(STEPS - 1):
        seen = decode(observation, "accelerometer")
        felt.append(np.stack([seen["tip_acceleration_along"], seen["tip_acceleration_across"]], axis=1))
        states.append(env.state)
        action, memory = controller.predict(observation, memory, np.full(arms, memory is None))
        observation = env.step(action)[0]
    return np.array(states), np.array(felt), env.params_table, memory


def tip(states: Floats, table: Floats) -> Floats:
    """Position of the end by the planar arm's kinematics, the joint's kinematic error included; (..., n, 2) [m]."""
    angle, torsion = states[..., 0] / table[:, COLUMN.gear_ratio], states[..., 2]
    error = table[:, COLUMN.kinematic_error] * np.sin(2 * states[..., 0] + table[:, COLUMN.kinematic_error_phase])
    reach = 2 * table[:, COLUMN.link_length] * np.cos(angle - torsion) + table[:, COLUMN.hand_length]
    return np.stack([reach * np.cos(torsion + error), reach * np.sin(torsion + error)], axis=-1)


class TestMeasurementEquation:
    def test_readings_are_accelerations_of_the_tip_with_a_constant_and_white_noise(self):
        """Of drawn arms that move: the tip's velocity by finite differences of its place."""
        states, felt, table, _ = followed()
        moved = states.copy()
        moved[..., 0], moved[..., 2] = states[..., 1], states[..., 3]  # rates of the angles
        moved[..., 1] = moved[..., 3] = 0.0
        velocity = (tip(states + 1e-6 * moved, table) - tip(states - 1e-6 * moved, table)) / 2e-6
        mean, place = np.diff(velocity, axis=0) / CONTROL_PERIOD, tip(states[1:], table)
        along = place / np.linalg.norm(place, axis=-1, keepdims=True)
        turned = np.stack([(mean * along).sum(-1), mean[..., 1] * along[..., 0] - mean[..., 0] * along[..., 1]], -1)
        errors = np.array([unfiltered(now, before)[0] for before, now in pairwise(felt)]) - turned
        assert np.abs(turned[..., 1]).max() > 30 * SPREAD and np.abs(turned[..., 0]).max() > 10 * SPREAD
        assert np.abs(errors.mean(0)).max() < BIAS
        assert errors.std(0) == pytest.approx(SPREAD, rel=0.08)
        white = errors - errors.mean(0)
        assert np.abs((white[1:] * white[:-1]).mean(0) / white.var(0)).max() < 0.2

    def test_a_reading_that_is_cut_off_tells_nothing(self):
        now = np.array([[1.0, RANGE], [1.0, 2.0]])
        _, variance = unfiltered(now, np.ones((2, 2)))
        assert variance[:, 0] == pytest.approx(SPREAD**2)
        assert variance[1, 1] == pytest.approx(SPREAD**2) and variance[0, 1] > 1e5


def test_gains_are_those_of_a_filter_that_also_keeps_the_state_before():
    """A Kalman filter of [z[k]; z[k-1]], run until it is steady, has uncorrelated noise and no such formula."""
    k, params, spread = 20, design_model(), (SPREAD, 3 * SPREAD)
    arm, slopes = linear_arm(params).at(k), acceleration_slopes(ANGLES[k], params.plant())
    single, process = np.eye(5), np.zeros((5, 5))
    single[:4, :4], single[:4, 4] = arm.transition, arm.by_torque
    for by_noise, deviation in ((arm.by_torque, 5e-3), (arm.by_acceleration, 0.3)):
        process[:4, :4] += deviation**2 * np.outer(by_noise, by_noise)
    process[4, 4] = 1e-6 * CONTROL_PERIOD
    transition, both = np.zeros((10, 10)), np.zeros((10, 10))
    transition[:5, :5], transition[5:, :5], both[:5, :5] = single, np.eye(5), process
    seen = np.zeros((3, 10))
    seen[0, 0], seen[1:, :4], seen[1:, 5:9] = 1.0, slopes, -slopes
    measured = np.diag([QUANTUM**2 / 12, *np.square(spread)])
    after, gain = np.diag([1e-6, 1e-2, 1e-6, 1e-2, 1e-4, *[0.0] * 5]), np.empty(0)
    for _ in range(6000):
        before = transition @ after @ transition.T + both
        gain = before @ seen.T @ np.linalg.inv(seen @ before @ seen.T + measured)
        after = before - gain @ seen @ before
    actual = steady_accelerometer_gain(arm, slopes, Noise(5e-3, 0.3, 1e-3), 1.0, spread)
    np.testing.assert_allclose(actual / np.abs(actual).max(0), gain[:5] / np.abs(actual).max(0), atol=1e-5)


def test_preview_measures_the_zero_g_output_once_an_episode():
    make, env = WITH_ACCELEROMETER["preview"], batch(4, moves=2, sensors="accelerometer", randomization="train")
    first, last = (memory_after(make(), env, steps, seed=SEED).rows[:, -3:-1] for steps in (1, EPISODE_STEPS + 2))
    assert np.array_equal(first, last) and np.abs(first).max() < BIAS + 0.2


def test_kinematic_error_and_zero_g_output_are_found():
    _, felt, table, memory = followed()
    size, phase = table[:, COLUMN.kinematic_error], table[:, COLUMN.kinematic_error_phase]
    z = memory.belief.tracks.mean.T
    np.testing.assert_allclose(z[arm_of.ERROR_SINE], size * np.cos(phase), atol=8e-6)
    np.testing.assert_allclose(z[arm_of.ERROR_COSINE], size * np.sin(phase), atol=8e-6)
    assert size.max() > 2e-4
    bias = slice(arm_of.BIAS, arm_of.ACCELEROMETER_SIZE)
    np.testing.assert_allclose(z[bias].T, felt[0], atol=4 * SPREAD)  # at rest, but for its noise
    assert np.sqrt(memory.belief.tracks.covariance[:, bias, bias].diagonal(0, 1, 2)).max() < 0.5 * SPREAD


TRAIN_SEED = 5_000_000
ROWS = [FIELDS.index(name) for name in IDENTIFIED]
VARIATION = COLUMN.friction_variation, COLUMN.friction_variation_phase  # of friction over the turn


def batch(count: int, seed: int = TRAIN_SEED, **settings: Any) -> BeltArmVectorEnv:
    env = BeltArmVectorEnv(count, autoreset_mode="Disabled", **settings)
    env.reset(seed=seed)
    return env


def believed_after(controller: AdaptiveController, env: BeltArmVectorEnv, steps: int = EPISODE_STEPS) -> Belief:
    """What a controller believes of arms after so many samples from their start."""
    return memory_after(controller, env, steps, seed=TRAIN_SEED).belief


def true_delays(env: BeltArmVectorEnv) -> Floats:
    table = env.params_table
    return (table[:, COLUMN.command_latency] + table[:, COLUMN.current_loop_time_constant]) / CONTROL_PERIOD


def true_logs(env: BeltArmVectorEnv, nominal: ArmParams) -> Floats:
    """Logarithms of `IDENTIFIED` over their nominal values, as seen through the torque constant; shape (n, 6)."""
    table = env.params_table
    swing = [arm.plant().inertia_swing for arm in env.params]
    true = np.column_stack([swing, *(table[:, FIELDS.index(name)] for name in IDENTIFIED[1:])])
    return np.log(true / (1 + table[:, [COLUMN.torque_constant_error]]) / nominal_row(nominal)[ROWS])


class TestIdentification:
    def test_finds_the_constants_of_drawn_arms_and_is_right_within_what_it_says_of_itself(self):
        env, controller = batch(64, randomization="train"), AdaptiveController()
        belief = believed_after(controller, env, 600)
        error = belief.tracks.mean[:, LOGS] - true_logs(env, controller.params)
        assert (np.sqrt(np.mean(error**2 / belief.tracks.covariance.diagonal(0, 1, 2)[:, LOGS], axis=0)) < 2.0).all()
        most = {"arm_inertia_swing": 0.13, "belt_stiffness": 0.1, "motor_inertia": 0.05, "coulomb_friction": 0.1}
        for name, bound in most.items():
            assert np.sqrt(np.mean(error[:, IDENTIFIED.index(name)] ** 2)) < bound, name
        assert np.sqrt(np.mean((belief.tracks.mean[:, DELAY] - true_delays(env)) ** 2)) < 0.1  # samples
        tables, (size, phase) = (env.params_table, ArmIdentifier(design_model()).estimate(belief).table), VARIATION
        true, believed = (table[:, size] * np.exp(1j * table[:, phase]) for table in tables)
        assert np.median(np.abs(believed - true)) < 0.03

    @pytest.mark.parametrize("deflection", [0.0005, 0.004, 0.02])
    def test_presliding_is_found_where_the_encoder_shows_it_and_the_motor_does_not_hunt(self, deflection: float):
        ranges = {**TRAIN_RANGES, "presliding_deflection": (deflection, deflection)}
        env, controller = batch(12, randomization=ranges), AdaptiveController(tuned("adaptive", AdaptiveGains))
        seen, memory, angles = env.reset(seed=TRAIN_SEED)[0], None, []
        for _ in range(EPISODE_STEPS):
            action, memory = controller.predict(seen, memory)
            seen = env.step(action)[0]
            angles.append(env.state[:, 0])
        assert memory is not None
        found = NOMINAL_DEFLECTION * np.exp(memory.belief.tracks.mean[:, GIVING])
        if deflection > 0.002:  # the encoder shows a smaller one hardly at all: its counts are of 1.6 mrad
            assert np.median(np.abs(np.log(found / deflection))) < np.log(2.5)
        swing = np.ptp(angles[-240:], axis=0)  # of the motors, in the last 0.36 s
        assert np.median(swing) < 2 * deflection + 0.005

    @pytest.mark.parametrize(
        ("nominal", "delay", "counts"), [(ArmParams(), 0.0, 1500), (design_model(), 1.5, 1000)], ids=["ideal", "late"]
    )
    def test_finds_delay_and_resolution_whatever_it_is_told(self, nominal: ArmParams, delay: float, counts: int):
        env = batch(24, randomization="train", delay=delay, encoder_counts=counts)
        belief = believed_after(AdaptiveController(params=nominal), env, 150)
        assert np.sqrt(np.mean((belief.tracks.mean[:, DELAY] - true_delays(env) - delay) ** 2)) < 0.2
        np.testing.assert_allclose(belief.counts, 2 * np.pi / counts, rtol=0.05)


class TestParts:
    def test_opens_the_swing_by_what_a_part_may_change(self):
        """Against the formula in NumPy: a part is placed, picked, exchanged, and placed; all else stays as it was."""
        identifier, env, swing = tuned_identifier(), batch(4, randomization="train"), LOGS.start
        doubts, memory = identifier.uncertainty, memory_after(AdaptiveController(), env, 200, seed=TRAIN_SEED)
        belief, going = memory.belief, np.zeros(4, np.bool_)
        reading = read(env.reset(seed=TRAIN_SEED)[0], identifier.params)._replace(motor_angle=belief.angle)
        nominal = nominal_row(identifier.params)[COLUMN.arm_inertia_swing]
        known = np.full(4, np.log(identifier.params.arm_inertia_swing / nominal))
        doubt, held = np.full(4, (_ARM_DOUBT * doubts.swing) ** 2 + doubts.torque_constant**2), True
        for holds in (False, True, True, False, False):
            unmoved = identifier.update(belief, reading._replace(step=np.ones(4, np.intp)), going)
            belief = identifier.update(belief, reading._replace(holds_part=np.full(4, float(holds))), going)
            mean, covariance = unmoved.tracks.mean, unmoved.tracks.covariance
            if held:
                covariance[:, swing] = covariance[:, :, swing] = 0.0
                mean[:, swing], covariance[:, swing, swing] = known, doubt
            known, doubt = mean[:, swing].copy(), covariance[:, swing, swing].copy()
            if holds:
                own, lever = nominal * np.exp(known), 4 * identifier.params.link_length**2
                loaded = own + lever * PART
                covariance[:, swing] *= (own / loaded)[:, None]
                covariance[:, :, swing] *= (own / loaded)[:, None]
                covariance[:, swing, swing] += (lever * _PART_DOUBT * doubts.swing / loaded) ** 2
                mean[:, swing] = np.log(loaded / nominal)
            np.testing.assert_allclose(belief.tracks.mean, mean, rtol=1e-12, atol=1e-15)
            np.testing.assert_allclose(belief.tracks.covariance, covariance, rtol=1e-12, atol=1e-18)
            held = holds

    @pytest.mark.parametrize("accelerometer", [False, True])
    def test_an_arm_that_begins_without_a_part_has_the_swing_of_the_data_sheet(self, accelerometer: bool):
        identifier, env = ArmIdentifier(design_model(), accelerometer=accelerometer), batch(2, sensors="accelerometer")
        reading = read(env.reset(seed=0)[0], identifier.params, "accelerometer")
        reading = reading._replace(holds_part=np.array([0.0, 1.0]))
        belief = identifier.update(None, reading, np.ones(2, np.bool_))
        swing = identifier.estimate(belief).table[:, COLUMN.arm_inertia_swing]
        assert swing == pytest.approx([design_model().arm_inertia_swing, design_model().plant().inertia_swing])
        assert np.diff(belief.tracks.covariance[:, LOGS.start, LOGS.start]) > 0

    def test_a_shift_costs_less_with_what_is_known_from_its_moves(self):
        """Moves two to four of 10 arms, against controllers that begin anew and do not know of parts."""

        class Forgetful(AdaptiveController):
            remembers = False

            def law(self, reading: Reading, begins: Flags, memory: Any) -> Any:
                return super().law(reading._replace(holds_part=np.ones(len(begins))), begins, memory)

        gains, ranges = tuned("adaptive", AdaptiveGains), {**TRAIN_RANGES, **PRESLIDING, "payload_mass": PART_MASS}
        settings: dict[str, Any] = {"seed": TRAIN_SEED, "moves": 4, "randomization": ranges}
        costs = [rollout(kind(gains), 10, **settings).cost[10:].mean() for kind in (AdaptiveController, Forgetful)]
        assert costs[0] < 0.9 * costs[1]


class TestTrust:
    def test_begins_anew_where_what_it_believes_is_wrong(self):
        class Misled(AdaptiveController):
            def _identified(self, reading: Reading, begins: Flags, belief: Belief | None) -> Belief:
                new = super()._identified(reading, begins, belief)
                new.tracks.mean[begins, 6:9] = [0.5, -1.5, -1.5]  # a heavy motor without friction, of which it is sure
                new.tracks.covariance[begins, 4:, 4:] *= 1e-8
                return new

        settings: dict[str, Any] = {name: (value, value) for name, value in asdict(design_model()).items()}
        misled, sound = (
            rollout(kind(), 16, seed=TRAIN_SEED, randomization=settings) for kind in (Misled, AdaptiveController)
        )
        assert misled.finished.all() and misled.cost.mean() < 1.35 * sound.cost.mean()

    @pytest.mark.parametrize(("torsion", "variance"), [(2.0, 1e-4), (0.0, 1e300)], ids=["torsion", "variance"])
    def test_begins_anew_at_rest_where_it_is_beyond_bounds_behind_a_dead_encoder(self, torsion: float, variance: float):
        env, identifier = batch(8), tuned_identifier()
        belief = believed_after(AdaptiveController(), env, 60)
        reading = read(env.reset(seed=TRAIN_SEED)[0], identifier.params)
        reading = reading._replace(motor_angle=np.zeros(8), last_command=np.zeros(8))
        belief.tracks.mean[:, 2:4] = [torsion, 100 * torsion]  # as after a jump of the encoder by a hundred radians
        belief.tracks.covariance[:, 2, 2] = variance
        for _ in range(EPISODE_STEPS):
            belief = identifier.update(belief, reading, np.zeros(8, np.bool_))
            assert np.isfinite(belief.tracks.mean).all() and (belief.tracks.covariance[:, 2, 2] <= 4).all()
        assert (np.sqrt(belief.tracks.covariance[:, 2, 2]) < 0.02).all() and (abs(belief.state[:, 2]) < 0.02).all()
