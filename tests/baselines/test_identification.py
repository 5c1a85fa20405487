"""The identification: constants of the arm and of its drive, delay and resolution of its encoder."""

from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
import pytest

from baselines import CONTROLLERS
from baselines.estimation.believed_arm import IDENTIFIED, LOGS, nominal_row
from baselines.estimation.identification import ArmIdentifier, Belief
from baselines.estimation.uncertainty import Uncertainty
from baselines.optimal.adaptive import AdaptiveController, AdaptiveGains, tuned_identifier
from baselines.reading import Reading, read
from beltarm_env import CONTROL_PERIOD, EPISODE_STEPS, ArmParams, BeltArmVectorEnv, design_model
from beltarm_env.arm import COLUMN, FIELDS
from beltarm_env.arrays import Flags, Floats
from beltarm_env.rollout import rollout
from beltarm_env.task.ranges import TRAIN_RANGES

SEED = 5_000_000
ROWS = [FIELDS.index(name) for name in IDENTIFIED]


def batch(count: int, seed: int = SEED, **settings: Any) -> BeltArmVectorEnv:
    env = BeltArmVectorEnv(count, autoreset_mode="Disabled", **settings)
    env.reset(seed=seed)
    return env


def followed(controller: AdaptiveController, env: BeltArmVectorEnv, steps: int = EPISODE_STEPS) -> Belief:
    """What a controller believes of arms after so many samples from their start."""
    observations, memory = env.reset(seed=SEED)[0], None
    for _ in range(steps):
        action, memory = controller.predict(observations, memory)
        observations, *_ = env.step(action)
    assert memory is not None
    return memory.belief


def true_delays(env: BeltArmVectorEnv) -> Floats:
    """Latency and current loop [samples]."""
    table = env.params_table
    return (table[:, COLUMN.command_latency] + table[:, COLUMN.current_loop_time_constant]) / CONTROL_PERIOD


def true_logs(env: BeltArmVectorEnv, nominal: ArmParams) -> Floats:
    """Logarithms of `IDENTIFIED` over their nominal values, as seen through the torque constant; shape (n, 6)."""
    table = env.params_table
    swing = [arm.plant().inertia_swing for arm in env.params]
    true = np.column_stack([swing, *(table[:, FIELDS.index(name)] for name in IDENTIFIED[1:])])
    return np.log(true / (1 + table[:, [COLUMN.torque_constant_error]]) / nominal_row(nominal)[ROWS])


class TestArm:
    def test_finds_payload_and_stiffness_while_moving(self):
        payload, stiffness = np.array([0.0, 0.0, 0.2, 0.2]), np.array([28.0, 38.0, 28.0, 38.0])
        move = {"start": 0.2, "goal": 1.4, "duration": 1.0, "ramp_time": 0.2}
        arms = {name: np.full(4, value) for name, value in asdict(design_model()).items()}
        params = {**arms, "payload_mass": payload, "belt_stiffness": stiffness}
        env = batch(4)
        observations, _ = env.reset(seed=0, options={"params": params, "move": move})
        controller, memory = AdaptiveController(), None
        for _ in range(EPISODE_STEPS):
            action, memory = controller.predict(observations, memory)
            observations, *_ = env.step(action)
        assert memory is not None
        table = ArmIdentifier(design_model()).table(memory.belief)
        np.testing.assert_allclose(table[:, COLUMN.belt_stiffness], stiffness, rtol=0.12)
        np.testing.assert_allclose(table[:, COLUMN.arm_inertia_swing], 0.06 + 0.25 * payload, rtol=0.2)

    def test_knows_motor_and_friction_afterwards_and_is_right_within_what_it_says_of_itself(self):
        env, controller = batch(64, randomization="train"), AdaptiveController()
        belief = followed(controller, env, 600)
        error = belief.logs - true_logs(env, controller.params)
        assert (np.sqrt(np.mean(error**2 / belief.variance[:, LOGS], axis=0)) < 2.0).all()
        for name, most in (("motor_inertia", 0.05), ("coulomb_friction", 0.1)):
            assert np.sqrt(np.mean(error[:, IDENTIFIED.index(name)] ** 2)) < most, name

    def test_learns_nothing_from_an_arm_at_rest(self):
        env = batch(1)
        observations, _ = env.reset(seed=1)
        identifier, belief = ArmIdentifier(design_model()), None
        for _ in range(200):
            belief = identifier.update(belief, read(observations, design_model()), np.array([belief is None]))
            observations, *_ = env.step(np.zeros((1, 1), np.float32))
        assert belief is not None
        np.testing.assert_allclose(belief.logs, 0.0, atol=1e-6)
        np.testing.assert_allclose(identifier.table(belief)[0, ROWS], nominal_row(design_model())[ROWS], rtol=1e-6)


class TestDrive:
    @pytest.mark.parametrize("nominal", [design_model(), ArmParams()])
    def test_finds_the_delay_of_drives_as_they_are_built(self, nominal: ArmParams):
        env = batch(64, randomization="train")
        error = followed(AdaptiveController(params=nominal), env, 300).delay - true_delays(env)
        assert np.sqrt(np.mean(error**2)) < 0.2

    def test_finds_how_friction_varies_over_the_turn(self):
        env = batch(32, randomization={**TRAIN_RANGES, "friction_variation": (0.2, 0.25)})
        belief, table = followed(AdaptiveController(), env, 600), env.params_table
        actual = ArmIdentifier(design_model()).table(belief)
        of = COLUMN.friction_variation, COLUMN.friction_variation_phase
        true, believed = (t[:, of[0]] * np.exp(1j * t[:, of[1]]) for t in (table, actual))
        assert np.median(np.abs(believed - true)) < 0.03


class TestTrust:
    def test_begins_anew_where_what_it_believes_is_wrong(self):
        controller, n = AdaptiveController(), 16

        class Misled(AdaptiveController):
            def _identified(self, reading: Reading, begins: Flags, belief: Belief | None) -> Belief:
                new = super()._identified(reading, begins, belief)
                wrong = new.constants
                wrong[:, 2:5] = [0.5, -1.5, -1.5]  # a heavy motor without friction, of which it is sure
                return new.with_constants(begins, wrong, 1e-8 * new.covariance[:, 4:, 4:])

        nominal = {name: (value, value) for name, value in asdict(design_model()).items()}
        reported = rollout(Misled(), n, seed=SEED, randomization=nominal)
        untold = rollout(controller, n, seed=SEED, randomization=nominal)
        assert reported.finished.all()
        assert reported.cost.mean() < 1.35 * untold.cost.mean()

    @pytest.mark.parametrize(("torsion", "variance"), [(2.0, 1e-4), (0.0, 1e300)], ids=["torsion", "variance"])
    def test_begins_anew_at_rest_where_its_state_is_beyond_bounds_behind_a_dead_encoder(
        self, torsion: float, variance: float
    ):
        controller = AdaptiveController()
        env = batch(8)
        belief, observations = followed(controller, env, 60), env.reset(seed=SEED)[0]
        reading, identifier = read(observations, controller.params), tuned_identifier(controller.params)
        dead, none, going = np.zeros(8), np.zeros(8), np.zeros(8, np.bool_)
        belief.tracks.mean[:, 2:4] = [torsion, 100 * torsion]  # as after a jump of the encoder by a hundred radians
        belief.covariance[:, 2, 2] = variance
        for _ in range(EPISODE_STEPS):
            belief = identifier.update(belief, reading._replace(motor_angle=dead, last_command=none), going)
            assert np.isfinite(belief.tracks.mean).all()
            assert (belief.variance[:, 2] <= 4).all()
        assert (np.sqrt(belief.variance[:, 2]) < 0.02).all()
        assert (abs(belief.state[:, 2]) < 0.02).all()

    def test_is_nowhere_much_worse_than_the_design_model_alone(self):
        @dataclass(frozen=True)
        class Held(AdaptiveGains):
            def uncertainty(self) -> Uncertainty:
                names = {field.name for field in fields(Uncertainty)}
                noise = {"torque", "acceleration", "memory", "disturbance"}
                return Uncertainty(**{**dict.fromkeys(names - noise, 0.0), "disturbance": 5e-3})

        actual = rollout(AdaptiveController(), 64, seed=SEED, randomization="train").cost
        held = rollout(AdaptiveController(Held()), 64, seed=SEED, randomization="train").cost
        assert actual.mean() < 0.7 * held.mean()
        assert np.mean(actual > 1.2 * held) < 0.1


class TestEncoder:
    @pytest.mark.parametrize(("delay", "counts"), [(0.0, 1500), (1.5, 1000)])
    def test_finds_delay_and_resolution_of_the_encoder_on_arms_that_differ(self, delay: float, counts: int):
        env = batch(24, randomization="train", delay=delay, encoder_counts=counts)
        belief = followed(AdaptiveController(), env, 150)
        assert np.sqrt(np.mean((belief.delay - true_delays(env) - delay) ** 2)) < 0.3
        np.testing.assert_allclose(belief.count, 2 * np.pi / counts, rtol=0.05)

    def test_a_late_coarse_encoder_costs_it_little(self):
        good = rollout(CONTROLLERS["adaptive"](), 24, seed=SEED, randomization="ideal").cost
        bad = rollout(
            CONTROLLERS["adaptive"](), 24, seed=SEED, randomization="ideal", delay=2, encoder_counts=1000
        ).cost
        assert bad.mean() < 1.15 * good.mean()
