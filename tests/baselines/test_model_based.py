"""What the model-based controllers are made of: simulation, linear models, plans, filters; and the controllers."""

import math
from dataclasses import asdict, replace
from typing import Any

import control
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import expm

from baselines import CONTROLLERS as CONTROLLERS_BY_NAME
from baselines.estimation.observer import QUANTUM, Noise, StickSlipObserver, kalman_gains
from baselines.gains import Gains, tunable, tuned
from baselines.models.linear import ANGLES, at_angle, linear_arm, linear_arms
from baselines.optimal.adaptive import AdaptiveController, AdaptiveGains
from baselines.optimal.preview import PreviewController, PreviewGains
from baselines.planning.plan import GAIN, TORQUE, Weights, planned, planned_torque, replanned
from baselines.reading import read
from baselines.yardsticks.privileged import PrivilegedController
from beltarm_env import CONTROL_PERIOD, EPISODE_STEPS, ArmParams, BeltArmVectorEnv, observation, state_space
from beltarm_env.arm import params_table
from beltarm_env.rollout import rollout
from beltarm_env.simulation import ArmSimulation
from beltarm_env.task.ranges import design_model

Floats = NDArray[np.float64]

GEAR = 88.0
SEED = 5_000_000
CONTROLLERS = [PreviewController, AdaptiveController]


def batch(count: int, seed: int = SEED, **settings: Any) -> BeltArmVectorEnv:
    env = BeltArmVectorEnv(count, autoreset_mode="Disabled", **settings)
    env.reset(seed=seed)
    return env


class TestSimulation:
    @pytest.mark.parametrize("model", ["lumped", "lagrangian"])
    def test_is_the_environment_bit_for_bit(self, model: str):
        env = batch(150, model=model, randomization="ideal")
        simulation = ArmSimulation(env.params, model=model)
        states, rng = env.state, np.random.default_rng(0)
        for _ in range(80):
            action = rng.uniform(-0.6, 0.6, (150, 1)).astype(np.float32)
            env.step(action)
            states = simulation.advance(states, 0.3 * action[:, 0].astype(np.float64))
        np.testing.assert_array_equal(states, env.state)

    @pytest.mark.parametrize("model", ["lumped", "lagrangian"])
    def test_with_drives_is_the_environment_bit_for_bit(self, model: str):
        rng = np.random.default_rng(0)
        env = batch(150, model=model, randomization="train")
        latency = rng.uniform(0, 3 * CONTROL_PERIOD, 150)
        latency[:4] = 0.0, CONTROL_PERIOD, 2 * CONTROL_PERIOD, 3 * CONTROL_PERIOD
        env.reset(seed=SEED, options={"params": {"friction_drift": 0.0, "command_latency": latency}})
        simulation = ArmSimulation(env.params, model=model)
        states = simulation.at_rest(env.state[:, 0])
        states[:, :4] = env.state
        for _ in range(80):
            action = rng.uniform(-0.6, 0.6, (150, 1)).astype(np.float32)
            env.step(action)
            before = states.copy()
            following = simulation.advance(states, 0.3 * action[:, 0].astype(np.float64))
            np.testing.assert_array_equal(states, before, "what was given is left alone")
            states = following
        np.testing.assert_array_equal(states[:, :4], env.state)

    def test_commands_under_way_are_states(self):
        late = ArmParams(command_latency=1.5 * CONTROL_PERIOD, torque_constant_error=0.1)
        simulation = ArmSimulation(late)
        states = simulation.at_rest(np.array([60.0]))
        for command in (0.1, 0.2, -0.1):
            states = simulation.advance(states, np.array([command]))
        np.testing.assert_allclose(states[0, 4:], [0.22, -0.11, 0.22, 0.11], rtol=1e-12)

    def test_ahead_is_what_comes_and_a_straight_line_between_samples(self):
        arms = [design_model(), ArmParams(), replace(design_model(), command_latency=0.004), design_model()]
        simulation, torques = ArmSimulation(arms), np.full(4, 0.1)
        states = simulation.at_rest(np.array([60.0, 61.0, 62.0, 63.0]))
        once = simulation.advance(states, torques)
        twice = simulation.advance(once, torques)
        found = simulation.ahead(states, torques, np.array([0.0, 1.0, 2.0, 1.25]))
        for arm, expected in enumerate((states, once, twice, once + 0.25 * (twice - once))):
            np.testing.assert_allclose(found[arm], expected[arm, :4], rtol=1e-13)

    def test_other_constants_take_effect(self):
        simulation = ArmSimulation(ArmParams(), 2)
        start = np.tile([60.0, 0.0, 0.05, 0.0], (2, 1))
        before = simulation.advance(start, np.zeros(2))
        simulation.set_table(params_table([ArmParams(), ArmParams(belt_stiffness=20.0)]))
        after = simulation.advance(start, np.zeros(2))
        np.testing.assert_array_equal(before[0], after[0])
        assert after[1, 2] != before[1, 2]

    def test_torque_is_cut_at_the_limit(self):
        simulation, start = ArmSimulation(ArmParams(), 1), np.array([[60.0, 0.0, 0.0, 0.0]])
        np.testing.assert_array_equal(
            simulation.advance(start, np.array([9.0])), simulation.advance(start, np.array([0.3]))
        )

    def test_mistakes_are_named(self):
        with pytest.raises(ValueError, match=r"states and torques must have shapes \(2, 4\) and \(2,\), got \(1, 4\)"):
            ArmSimulation(ArmParams(), 2).advance(np.zeros((1, 4)), np.zeros(2))
        with pytest.raises(ValueError, match=r"states and torques must have shapes \(1, 8\) and \(1,\), got \(1, 4\)"):
            ArmSimulation(design_model()).advance(np.zeros((1, 4)), np.zeros(1))
        with pytest.raises(ValueError, match="there is room for 136 arms, got 137"):
            ArmSimulation(ArmParams(), 2).set_table(params_table([ArmParams()] * 137))
        with pytest.raises(ValueError, match="model must be one of 'lumped', 'lagrangian', got 'mujoco'"):
            ArmSimulation(ArmParams(), model="mujoco")


class TestLinearModels:
    def test_are_the_exponential_of_the_continuous_model(self):
        arms = [ArmParams(), ArmParams(payload_mass=0.3, belt_stiffness=40.0, belt_damping_ratio=0.02)]
        tables = linear_arms(params_table(arms))
        for i, arm in enumerate(arms):
            for k in (0, 17, 45):
                a, b, _ = state_space(arm, float(ANGLES[k]))
                held = np.zeros((6, 6))
                held[:4, :4], held[:4, 4:5], held[3, 5] = a, b, 1.0
                stepped = expm(CONTROL_PERIOD * held)
                np.testing.assert_allclose(tables.transition[i, k], stepped[:4, :4], rtol=1e-11, atol=1e-13)
                np.testing.assert_allclose(tables.by_torque[i, k], stepped[:4, 4], rtol=1e-11)
                np.testing.assert_allclose(tables.by_acceleration[i, k], stepped[:4, 5], rtol=1e-9, atol=1e-13)

    def test_belt_has_its_mean_stiffness(self):
        for part, mean in zip(linear_arm(ArmParams(belt_stiffening=0.2)), linear_arm(ArmParams()), strict=True):
            np.testing.assert_array_equal(part, mean)

    def test_tables_are_interpolated_and_end_where_the_arm_does(self):
        table = linear_arm(ArmParams()).by_torque
        between = at_angle(table, np.array([0.5 * (ANGLES[3] + ANGLES[4]), -0.2, 1.8]))
        np.testing.assert_allclose(between, [0.5 * (table[3] + table[4]), table[0], table[-1]])


MOVE = np.array([[0.3, 1.1, 0.8, 0.2]])
WEIGHTS = Weights(0.3, 2.0, 20.0)


def linear_run(torques: Floats | None, gains: float = 1.0, weights: Weights = WEIGHTS) -> tuple[float, Floats]:
    """Cost of the plan's own problem, by simulating its linear model along the move: independent of its recursion."""
    arm = ArmParams()
    plan = planned(MOVE[0], arm.row(), weights)
    tables = linear_arm(arm)
    times = CONTROL_PERIOD * np.arange(EPISODE_STEPS + 1)
    env = batch(1)
    env.reset(options={"move": dict(zip(("start", "goal", "duration", "ramp_time"), MOVE[0].tolist(), strict=True))})
    references = np.array([np.ravel(env.reference(float(t)))[:2] for t in times])
    x, cost, applied, last = np.array([GEAR * MOVE[0, 0], 0.0, 0.0, 0.0]), 0.0, np.empty(EPISODE_STEPS), 0.0
    for k in range(EPISODE_STEPS):
        angle, speed = references[k]
        a, b, e = (at_angle(part, np.array([angle]))[0] for part in tables)
        m2 = 0.01 + 0.06 * math.sin(angle) ** 2
        torque = plan[k, TORQUE] - gains * plan[k, GAIN:TORQUE] @ np.append(x - plan[k, :GAIN], last)
        torque = torque if torques is None else torques[k]
        x = a @ x + b * torque + e * 0.06 * math.sin(angle) * math.cos(angle) * speed**2 / m2
        applied[k] = torque
        angle, speed = references[k + 1]
        z = x - [GEAR * angle, GEAR * speed, 0.0, 0.0]
        dphi, dphi_dot = z[0] / GEAR - z[2], z[1] / GEAR - z[3]
        reach, slope = 0.5 * math.cos(angle) + 0.1, -0.5 * math.sin(angle)
        position = slope * dphi, reach * z[2]
        velocity = slope * dphi_dot - 0.5 * math.cos(angle) * speed * dphi, reach * z[3] + slope * speed * z[2]
        cost += np.square(position).sum() / 0.01**2 + 0.3 * np.square(velocity).sum() / 0.2**2
        cost += weights.torque * torque**2 + weights.change * (torque - last) ** 2
        last = torque
    return float(cost), applied


class TestPlan:
    def test_is_the_optimum_of_its_problem(self):
        best, torques = linear_run(None)
        rng = np.random.default_rng(0)
        for _ in range(4):
            other = rng.normal(0, 1e-3, EPISODE_STEPS)
            costs = [linear_run(torques + s * other)[0] for s in (-1, 1)]
            assert min(costs) > best
            assert costs[0] - best == pytest.approx(costs[1] - best, rel=1e-3), "stationary: no slope, only curvature"
        assert linear_run(None, gains=0.8)[0] > best

    def test_gain_at_rest_is_that_of_the_infinite_horizon(self):
        plan = planned(np.array([0.3, 0.8, 0.5, 0.1]), ArmParams().row(), WEIGHTS)
        tables = linear_arm(ArmParams())
        by_state, by_torque = (at_angle(part, np.array([0.8]))[0] for part in tables[:2])
        a, b = np.eye(5), np.append(by_torque, 1.0)  # the last torque as fifth state, its change as input
        a[:4, :4], a[:4, 4] = by_state, by_torque
        radial, reach = 0.5 * math.sin(0.8), 0.5 * math.cos(0.8) + 0.1
        of_angles = [[-radial / GEAR, 0, radial, 0], [0, 0, reach, 0]]
        c = np.array([*of_angles, [0, -radial / GEAR, 0, radial], [0, 0, 0, reach]])
        q = np.zeros((5, 5))
        q[:4, :4], q[4, 4] = c.T @ np.diag([1e4, 1e4, 0.3 / 0.04, 0.3 / 0.04]) @ c, WEIGHTS.torque
        state_cost = a.T @ q @ a
        state_cost = (state_cost + state_cost.T) / 2
        price = np.array([[WEIGHTS.change + b @ q @ b]])
        gain, _, _ = control.dlqr(a, b[:, None], state_cost, price, (a.T @ q @ b)[:, None])
        np.testing.assert_allclose(plan[500, GAIN:TORQUE], np.asarray(gain)[0] - [0, 0, 0, 0, 1], rtol=1e-4)

    def test_is_read_between_samples(self):
        table = params_table([ArmParams()])
        plans = replanned(None, np.ones(1, np.bool_), MOVE, table, WEIGHTS)
        x, last = np.array([[GEAR * 0.4, 30.0, 0.01, 0.0]]), np.array([0.05])

        def torque(time: float) -> float:
            return float(planned_torque(plans, np.array([time]), x, last)[0])

        row = plans[0][100]
        assert torque(100.0) == pytest.approx(row[9] - row[4:9] @ np.append(x[0] - row[:4], last), rel=1e-12)
        assert torque(100.5) == pytest.approx(0.5 * (torque(100.0) + torque(101.0)), abs=1e-3)
        assert torque(1199.0) == torque(1300.0)

    def test_every_arm_has_its_own(self):
        table = params_table([ArmParams(), ArmParams(payload_mass=0.2)])
        moves = np.repeat(MOVE, 2, axis=0)
        both, second = (
            replanned(None, np.ones(2, np.bool_), moves, table, Weights()),
            planned(MOVE[0], table[1], Weights()),
        )
        np.testing.assert_array_equal(both[1], second)
        assert np.abs(both[0] - both[1])[:, TORQUE].max() > 1e-3


class TestObserver:
    def test_covariance_is_that_of_simulated_errors(self):
        # The linear arm driven by the noise that the filter is designed for, at 45 degrees.
        noise, k = Noise(1e-2, 30.0, 0.2), 22
        tables = [part[k] for part in linear_arm(ArmParams())]
        gain = kalman_gains(ArmParams(), noise)[k]
        transition = np.eye(5)
        transition[:4, :4], transition[:4, 4] = tables[0], tables[1]
        rng, count = np.random.default_rng(0), 4000
        error, squares = np.zeros((count, 5)), []
        for step in range(1500):
            error = error @ transition.T
            error[:, :4] += rng.normal(0, noise.torque, (count, 1)) * tables[1]
            error[:, :4] += rng.normal(0, noise.acceleration, (count, 1)) * tables[2]
            error[:, 4] += rng.normal(0, noise.disturbance * CONTROL_PERIOD**0.5, count)
            innovation = error[:, 0] + rng.normal(0, QUANTUM / 12**0.5, count)
            error -= innovation[:, None] * gain
            if step > 1400:
                squares.append(np.mean(error**2, axis=0))
        spread = np.sqrt(np.mean(squares, axis=0))
        worse = [np.sqrt(self.spread_of(gain * f, transition, tables, noise)) for f in (0.9, 1.0, 1.1)]
        np.testing.assert_allclose(spread, worse[1], rtol=0.05)
        assert (worse[1] < worse[0]).all() and (worse[1] < worse[2]).all(), "the Kalman gain is the best"

    @staticmethod
    def spread_of(gain: Floats, transition: Floats, tables: list[Floats], noise: Noise) -> Floats:
        """Steady-state variance of the estimate's errors under a gain, by iterating its Lyapunov equation."""
        drive = np.zeros((5, 5))
        drive[:4, :4] = noise.torque**2 * np.outer(tables[1], tables[1])
        drive[:4, :4] += noise.acceleration**2 * np.outer(tables[2], tables[2])
        drive[4, 4] = noise.disturbance**2 * CONTROL_PERIOD
        kept = np.eye(5) - np.outer(gain, [1, 0, 0, 0, 0])
        covariance = np.zeros((5, 5))
        for _ in range(6000):
            covariance = kept @ (transition @ covariance @ transition.T + drive) @ kept.T
            covariance += QUANTUM**2 / 12 * np.outer(gain, gain)
        return np.diag(covariance)

    def test_knows_the_torsion_behind_a_stuck_motor(self):
        env = batch(1, encoder_counts=4000)
        observer, estimate = StickSlipObserver(ArmParams()), None
        observations, _ = env.reset(seed=3)
        begins = np.array([True])
        rings = []
        for k in range(700):
            estimate = observer.update(estimate, read(observations, ArmParams()), begins)
            begins = np.array([False])
            if k > 400:
                assert env.state[0, 1] == 0.0, "stuck"
                rings.append((env.state[0, 2], estimate.state[0, 2]))
            torque = 0.12 if k < 150 else 0.0
            observations, *_ = env.step(np.array([[torque / 0.3]], np.float32))
        true, believed = np.array(rings).T
        assert np.ptp(true) > 0.01, "rings"
        assert np.abs(true - believed).max() < 0.03 * np.ptp(true)

    @staticmethod
    def observed(params: ArmParams, start: list[float], noise: Noise, command: Any, steps: int) -> list[Floats]:
        """True states, their estimates, and those for when a command acts: shapes (steps, 4)."""
        env = batch(1, encoder_counts=10_000_000)
        observations, _ = env.reset(options={"params": asdict(params), "state": start})
        observer, estimate, rows = StickSlipObserver(params, noise), None, []
        for k in range(steps):
            estimate = observer.update(estimate, read(observations, params), np.array([k == 0]))
            rows.append((env.state[0], estimate.state[0], estimate.ahead[0]))
            observations, *_ = env.step(np.array([[command(k) / 0.3]], np.float32))
        return [np.array(part) for part in zip(*rows, strict=True)]

    def test_finds_the_torsion_of_the_design_model_behind_its_drive(self):
        noise = Noise(torque=1e-4, acceleration=100.0, disturbance=1e-4)
        start = [GEAR * 0.8, 0.0, 0.03, 0.0]  # the observer begins without torsion
        true, found, _ = self.observed(design_model(), start, noise, lambda k: 0.12 * math.sin(0.02 * k), 900)
        errors = np.abs(found - true)
        assert errors[0, 2] == pytest.approx(0.03)
        assert errors[600:, 2].max() < 3e-4

    @pytest.mark.parametrize("latency", [0.0, 0.75, 1.0, 2.9])
    def test_state_ahead_is_the_one_that_comes(self, latency: float):
        params = replace(design_model(), command_latency=latency * CONTROL_PERIOD)
        start = [GEAR * 0.8, 0.0, 0.0, 0.0]
        true, found, ahead = self.observed(params, start, Noise(), lambda k: 0.15 if k < 60 else -0.15, 150)
        assert (np.abs(found - true).max(axis=0) < [1e-4, 0.02, 1e-5, 2e-3]).all()
        late = latency + params.current_loop_time_constant / CONTROL_PERIOD
        whole, part = int(late), late - int(late)
        for first in (20, 80):  # where the command has not changed for a while
            later = true[first + whole : first + whole + 30], true[first + whole + 1 : first + whole + 31]
            expected = later[0] + part * (later[1] - later[0])
            errors = np.abs(ahead[first : first + 30] - expected).max(axis=0)
            assert (errors < [1e-3, 0.02, 1e-5, 2e-3]).all()


class TestControllers:
    def test_a_torque_that_is_cut_much_does_not_go_on_ringing(self):
        """On this arm the optimal plan alone ends in a limit cycle between both limits, at a cost above 4000."""
        assert rollout(CONTROLLERS_BY_NAME["adaptive"](), 1, seed=5_700_796, randomization="ideal").cost[0] < 1000

    @pytest.mark.parametrize("make", CONTROLLERS)
    def test_batch_is_bit_for_bit_as_single_arms(self, make: Any):
        together = rollout(make(), 6, seed=SEED, randomization="ideal")
        for arm in (0, 3, 5):
            alone = rollout(make(), 1, seed=SEED + arm, randomization="ideal")
            np.testing.assert_array_equal(together.torque[:, arm], alone.torque[:, 0])

    @pytest.mark.parametrize("make", CONTROLLERS)
    def test_nothing_leaks_from_one_episode_into_the_next(self, make: Any):
        env, controller = batch(2, randomization="ideal"), make()
        first, _ = env.reset(seed=SEED)
        fresh, memory = controller.predict(first, None, np.array([True, True]))
        observations = first
        for _ in range(150):
            action, memory = controller.predict(observations, memory, np.array([False, False]))
            observations, *_ = env.step(action)
        observations[1] = first[1]
        again, memory = controller.predict(observations, memory, np.array([False, True]))
        assert again[1] == fresh[1]
        kept = (memory.belief if isinstance(controller, AdaptiveController) else memory.estimate).state[:, 2:]
        assert (kept[1] == 0).all() and (kept[0] != 0).any()

    @pytest.mark.parametrize("make", CONTROLLERS)
    def test_memory_is_not_changed_by_the_next_call(self, make: Any):
        env, controller = batch(2, randomization="ideal"), make()
        observations, _ = env.reset(seed=SEED)
        action, memory = controller.predict(observations)
        observations, *_ = env.step(action)
        once, _ = controller.predict(observations, memory)
        twice, _ = controller.predict(observations, memory)
        np.testing.assert_array_equal(once, twice)

    @pytest.mark.parametrize("make", CONTROLLERS)
    @pytest.mark.parametrize(("start", "goal"), [(0.0, 90.0), (90.0, 0.0), (10.0, 30.0), (80.0, 60.0)])
    def test_moves_the_nominal_arm_anywhere_to_within_millimetres(self, make: Any, start: float, goal: float):
        move = {"start": math.radians(start), "goal": math.radians(goal), "duration": 1.1, "ramp_time": 0.25}
        recording = rollout(make(), 1, seed=0, options={"move": move})
        assert np.abs(recording.tip_error[-200:]).max() < 2e-3
        assert np.abs(recording.tip_error).max() < 0.02

    def test_adaptive_beats_fixed_beats_paper_on_arms_that_differ(self):
        from baselines import PaperController

        costs = [
            rollout(make(), 40, seed=SEED, randomization="ideal").cost.mean()
            for make in (AdaptiveController, PreviewController, PaperController)
        ]
        assert costs[0] < 0.7 * costs[1] < 0.7 * 0.5 * costs[2]

    def test_privileged_is_the_yardstick(self):
        env = batch(30, randomization="ideal")
        yardstick = PrivilegedController(env.params)
        cost = rollout(yardstick, 30, seed=SEED, randomization="ideal", sensors="full").cost.mean()
        assert cost < rollout(AdaptiveController(), 30, seed=SEED, randomization="ideal").cost.mean()
        with pytest.raises(ValueError, match=r"shape \(n, 27\) or wider, got \(30, 25\): use .* sensors='full'"):
            yardstick.predict(np.zeros((30, observation.size()), np.float32))
        with pytest.raises(ValueError, match="this yardstick knows 30 arms, got observations of 4"):
            yardstick.predict(np.zeros((4, observation.size("full")), np.float32))


class TestGains:
    def test_range_is_checked_and_named(self):
        with pytest.raises(ValueError, match=r"PreviewGains.torque_weight must lie within 0.01 and 10000, got -1"):
            PreviewGains(torque_weight=-1)
        with pytest.raises(ValueError, match=r"AdaptiveGains.swing_doubt must lie within 0.05 and 1, got nan"):
            AdaptiveGains(swing_doubt=math.nan)
        with pytest.raises(TypeError, match=r"PreviewGains.torque_noise must be a number, got '3'"):
            replace(PreviewGains(), torque_noise="3")

    def test_untuned_gains_are_the_defaults(self):
        class Own(Gains):
            pass

        assert tuned("nobody", PreviewGains) == PreviewGains()
        assert isinstance(tuned("nobody", Own), Own)
        assert tunable(1.0, 0.0, 2.0).metadata == {"low": 0.0, "high": 2.0, "log": False}

    def test_observation_of_another_shape_is_refused(self):
        for make in CONTROLLERS:
            with pytest.raises(ValueError, match=r"observations must have shape \(n, 25\) or wider, got \(2, 7\)"):
                make().predict(np.zeros((2, 7), np.float32))
