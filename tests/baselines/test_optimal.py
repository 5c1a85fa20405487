"""Optimal feedback: LQG's gains against Riccati, MPC's against a general solver, robust LQ's against Lyapunov."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are, solve_discrete_lyapunov, sqrtm
from scipy.optimize import lsq_linear

from baselines import CONTROLLERS
from baselines.estimation.observer import Noise
from baselines.loops.models import closed_poles, loop_at
from baselines.models.linear import ANGLES, dead_time, linear_arm
from baselines.optimal import robust
from baselines.optimal.active_set import MOST_ROUNDS, SIZE, empty_problem, minimise
from baselines.optimal.lqg import feedback_gains
from baselines.optimal.mpc import _set_up, horizon
from baselines.optimal.robust import RobustController
from baselines.planning.plan import GAIN, TORQUE, Weights, planned
from baselines.planning.tip_error import bounded_sine, write_tip_errors
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arrays import Floats
from beltarm_env.physics.sampled import sampled_state_space
from beltarm_env.simulation import ArmSimulation
from beltarm_env.task.ranges import design_model
from beltarm_env.task.reference import TRAPEZOID, MoveShape, reference_at

GEAR = 88.0


def tip_errors(angle: float, speed: float = 0.0) -> Floats:
    """C of the nominal arm, about a joint at this angle [rad] that turns at this speed [rad/s]."""
    errors = np.empty((4, 4))
    write_tip_errors(angle, speed, bounded_sine(angle), ArmParams().plant(), errors)
    return errors


def with_last_torque(transition: Floats, by_torque: Floats) -> tuple[Floats, Floats]:
    """The arm with its last torque as a further state, and the change of the torque as input."""
    size = len(by_torque)
    a, b = np.eye(size + 1), np.append(by_torque, 1.0)
    a[:size, :size], a[:size, size] = transition, by_torque
    return a, b


def prices(weights: Weights, angle: float, size: int = 5) -> Floats:
    """Cost of the state at an angle [rad], whose last entry is the torque."""
    c, q = tip_errors(angle), np.zeros((size, size))
    q[:4, :4] = c.T @ np.diag([1e4, 1e4, weights.velocity / 0.04, weights.velocity / 0.04]) @ c
    q[-1, -1] = weights.torque
    return q


class TestFeedbackGains:
    @pytest.mark.parametrize("weights", [Weights(), Weights(0.05, 100.0, 3.0)])
    def test_are_the_optimum_of_the_riccati_equation(self, weights: Weights):
        tables, gains = linear_arm(ArmParams()), feedback_gains(ArmParams(), weights)
        for k in (0, 22, 45):
            a, b = with_last_torque(tables.transition[k], tables.by_torque[k])
            cost = solve_discrete_are(a, b[:, None], prices(weights, float(ANGLES[k])), np.array([[weights.change]]))
            expected = b @ cost @ a / (weights.change + b @ cost @ b) - [0, 0, 0, 0, 1]  # of the torque, not its change
            np.testing.assert_allclose(gains[k], expected, rtol=1e-5, atol=1e-6 * np.abs(expected).max())

    def test_are_those_of_a_plan_at_rest(self):
        plan = planned(np.array([0.3, ANGLES[22], 0.5, 0.1]), ArmParams().row(), Weights(0.3, 2.0, 20.0))
        gains = feedback_gains(ArmParams(), Weights(0.3, 2.0, 20.0))
        np.testing.assert_allclose(plan[500, GAIN:TORQUE], gains[22], rtol=1e-4)

    @pytest.mark.parametrize("speed", [0.0, 1.7])
    def test_errors_are_the_tips(self, speed: float):
        # Finite differences of the exact tip, in a frame that turns with the reference, at 40 degrees.
        angle, step = math.radians(40.0), 1e-6
        reference = np.array([GEAR * angle, GEAR * speed, 0.0, 0.0])

        def tip(deviation: Floats) -> Floats:
            (theta, omega), (torsion, rate) = (reference + deviation)[:2] / GEAR, deviation[2:]
            reach = 0.5 * math.cos(theta - torsion) + 0.1
            reach_rate = -0.5 * math.sin(theta - torsion) * (omega - rate)
            return np.array([reach, reach * torsion, reach_rate, reach_rate * torsion + reach * rate])

        slopes = np.column_stack([(tip(step * unit) - tip(-step * unit)) / (2 * step) for unit in np.eye(4)])
        np.testing.assert_allclose(tip_errors(angle, speed), slopes, atol=1e-8)

    @pytest.mark.parametrize(("latency", "k"), [(0.0, 20), (0.75, 0), (1.5, 20), (2.9, 45)])
    def test_feedback_on_the_state_ahead_is_as_good_as_on_the_actuators_states(self, latency: float, k: int):
        params = replace(design_model(), command_latency=latency * CONTROL_PERIOD, belt_stiffening=0.0)
        weights, angle = Weights(0.3, 1.0, 30.0), float(ANGLES[k])
        transition, by_command, _ = sampled_state_space(params, angle)
        a, b = with_last_torque(transition, by_command[:, 0])
        q = prices(weights, angle, len(a))
        to_go = solve_discrete_are(a, b[:, None], q, np.array([[weights.change]]))
        late = dead_time(params) / CONTROL_PERIOD
        step = np.linalg.matrix_power(a, int(late))  # with the last command held
        ahead = step + (late - int(late)) * (a @ step - step)
        gain = feedback_gains(params, weights)[k] + [0, 0, 0, 0, 1]
        gain = gain[:4] @ ahead[:4] + gain[4] * np.eye(len(a))[-1]
        loop = a - np.outer(b, gain)
        cost = solve_discrete_lyapunov(loop.T, q + weights.change * np.outer(gain, gain))
        pushed = np.zeros(len(a))
        pushed[:4] = 0.01, 1.0, 1e-3, 0.05
        assert 1 - 1e-9 < pushed @ cost @ pushed / (pushed @ to_go @ pushed) < 1.0001


def random_problem(generator: np.random.Generator, steps: int, limit: float):
    problem = empty_problem(steps)
    problem.transition[:] = np.eye(SIZE) + 0.2 * generator.normal(size=(steps, SIZE, SIZE))
    problem.transition[:, 4] = np.eye(SIZE)[4]
    problem.offset[:] = 0.3 * generator.normal(size=(steps, SIZE))
    problem.offset[:, 4] = 0.0
    roots = generator.normal(size=(steps + 1, SIZE, 2))
    weights = roots @ roots.transpose(0, 2, 1)
    problem.weight[:], problem.final[:] = weights[:-1], weights[-1]
    problem.target[:] = generator.normal(size=SIZE)
    problem.low[:], problem.high[:] = -limit, 0.8 * limit
    return problem


def condensed(problem, change_weight: float, first: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same cost as |matrix u - vector|^2, by following the dynamics under unit inputs."""

    def residuals(u: np.ndarray) -> np.ndarray:
        z, rows = first.copy(), []
        for k in range(len(u)):
            rows.append([np.sqrt(change_weight) * (u[k] - z[4])])
            z = problem.transition[k] @ z + problem.transition[k, :, 4] * (u[k] - z[4]) + problem.offset[k]
            rows.append(np.real(sqrtm(problem.weight[k])) @ z)
        rows.append(np.real(sqrtm(problem.final)) @ (z - problem.target))
        return np.concatenate(rows)

    steps = len(problem.constant)
    at_zero = residuals(np.zeros(steps))
    return np.stack([residuals(unit) - at_zero for unit in np.eye(steps)], axis=1), -at_zero


@pytest.mark.filterwarnings("ignore:Matrix is singular")
@pytest.mark.parametrize("limit", [np.inf, 2.0, 0.5, 0.1])
def test_active_set_finds_the_minimum_of_the_quadratic_program(limit: float):
    generator = np.random.default_rng(0)
    for _ in range(5):
        problem, first, u = random_problem(generator, 12, limit), generator.normal(size=SIZE), np.empty(12)
        first[4] = 0.1
        rounds = minimise(problem, 0.7, first, u)
        exact = lsq_linear(*condensed(problem, 0.7, first), (problem.low, problem.high), method="bvls", tol=1e-14)
        assert rounds <= MOST_ROUNDS and (rounds == 1 or limit < np.inf)
        np.testing.assert_allclose(u, exact.x, atol=1e-6)


def test_prediction_is_the_arm_without_friction():
    params = ArmParams(coulomb_friction=0.0)
    ahead = horizon(params, Weights(0.3, 0.0, 1.0))
    move, time = MoveShape(0.3, 1.2, 0.8, 0.2), 0.1
    problem, simulation = empty_problem(len(ahead.lengths)), ArmSimulation(params)
    _set_up(problem, ahead, move, time, 0.0)
    deviation, torque = np.array([0.5, 3.0, 0.004, 0.05]), 0.15

    def wanted() -> Floats:
        angle, speed, _ = reference_at(TRAPEZOID, move, time)
        return np.array([88 * angle, 88 * speed, 0.0, 0.0])

    for k, length in enumerate(ahead.lengths):
        state = wanted() + deviation
        for _ in range(length):
            state = simulation.advance(state[None], np.array([torque]))[0]
        time += length * CONTROL_PERIOD
        predicted = problem.transition[k] @ [*deviation, torque] + problem.offset[k]
        # The nonlinear arm moves a hundred times as far.
        assert (np.abs(predicted[:4] - (state - wanted())) < [1e-5, 1e-3, 3e-5, 3e-3]).all()


DESIGN, WEIGHTS = design_model(), Weights(1.0, 10.0, 20.0)
NOISE, LOUD = Noise(5e-3, 0.3, 1e-3), Noise(0.014, 1.7, 0.01)


class TestRobust:
    @pytest.mark.parametrize("k", [0, 20, 45])
    def test_loops_have_the_poles_of_the_law_on_each_arm(self, k: int):
        controller = RobustController()
        loops = robust.loops_at(DESIGN, k, controller.gains.weights(), controller.gains.noise(), 0.1)
        for arm, matrix in zip(robust.arms_around(DESIGN), robust.closed(controller.feedback()[k], loops), strict=True):
            expected, actual = closed_poles(loop_at(controller, k, arm)), np.linalg.eigvals(matrix)
            assert all(np.abs(actual - pole).min() < 1e-6 for pole in expected[np.abs(expected) > 0.05])

    def test_lyapunovs_equation_is_solved_as_scipy_does(self):
        loops = robust.loops_at(DESIGN, 20, WEIGHTS, NOISE, 0.1)
        a = robust.closed(feedback_gains(DESIGN, WEIGHTS)[20], loops)
        actual = robust.lyapunov(a, loops.noise)
        assert actual is not None and robust.lyapunov(np.array([[[1.001, 0.0], [0.0, 0.5]]]), np.eye(2)[None]) is None
        for single, matrix, noise in zip(actual, a, loops.noise, strict=True):
            expected = solve_discrete_lyapunov(matrix, noise)
            scale = np.sqrt(np.outer(expected.diagonal(), expected.diagonal())) + 1e-30
            assert (np.abs(single - expected) / scale).max() < 1e-6

    @pytest.mark.parametrize(("k", "noise"), [(0, NOISE), (20, NOISE), (45, NOISE), (45, LOUD)])
    def test_its_gain_costs_less_over_the_corners_than_lqgs_and_no_step_aside_costs_less(self, k: int, noise: Noise):
        """Also where LQG's does not hold them all, and costs without end."""
        loops, start = robust.loops_at(DESIGN, k, WEIGHTS, noise, 0.1), feedback_gains(DESIGN, WEIGHTS)[k]
        before, gain = robust.mean_cost(start, loops)[0], robust.least_cost_gain(start, loops)
        cost = robust.mean_cost(gain, loops)[0]
        assert cost < 0.99 * before and (before == math.inf) == (noise is LOUD)
        for step in 0.1 * np.diag(start):
            assert all(robust.mean_cost(gain + sign * step, loops)[0] > 0.999 * cost for sign in (1, -1))

    def test_stored_gains_are_what_the_design_finds(self, tmp_path: Path):
        robust.write_gains(tmp_path / "robust.json")
        anew, stored = (json.loads(path.read_text()) for path in (tmp_path / "robust.json", robust.FILE))
        assert anew["design"] == stored["design"], "call `write_gains()` of baselines.optimal.robust"
        np.testing.assert_allclose(anew["gains"], stored["gains"], rtol=1e-6)

    def test_stored_gains_are_of_one_design_alone(self, monkeypatch: pytest.MonkeyPatch):
        found = np.arange(5.0 * 10).reshape(10, 5)
        monkeypatch.setattr(robust.Design, "gains", lambda _: found)
        design = CONTROLLERS["robust"]().design
        for other in (
            design._replace(params=replace(design.params, payload_mass=0.11)),
            design._replace(weights=design.weights._replace(change=201.0)),
            design._replace(noise=design.noise._replace(torque=0.011)),
            design._replace(stopped=0.2),
        ):
            np.testing.assert_array_equal(robust.robust_gains(other)[::5], found)
        robust.robust_gains.cache_clear()
        monkeypatch.setattr(robust, "CORNERS", dict(list(robust.CORNERS.items())[1:]))
        np.testing.assert_array_equal(robust.robust_gains(design)[::5], found)
        robust.robust_gains.cache_clear()
