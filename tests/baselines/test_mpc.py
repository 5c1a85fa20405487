from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import sqrtm
from scipy.optimize import lsq_linear

from baselines import PaperController
from baselines.models.linear import ANGLES
from baselines.optimal.active_set import MOST_ROUNDS, SIZE, empty_problem, minimise
from baselines.optimal.horizon import _set_up, horizon, plan
from baselines.optimal.mpc import MpcController, MpcGains
from baselines.planning.plan import Weights
from beltarm_env import CONTROL_PERIOD, ArmParams, BeltArmVectorEnv
from beltarm_env.rollout import rollout
from beltarm_env.simulation import ArmSimulation
from beltarm_env.task.reference import TRAPEZOID, MoveShape, reference_at

SEED = 5_000_000


@pytest.fixture(scope="module")
def controller() -> MpcController:
    return MpcController()


def observations(count: int = 6, steps: int = 300) -> np.ndarray:
    """What a few arms observe under random torques, shape (steps, count, size)."""
    env = BeltArmVectorEnv(count, randomization="ideal")
    seen = [env.reset(seed=SEED)[0]]
    torques = np.random.default_rng(0).uniform(-0.4, 0.4, (steps, count, 1)).repeat(10, axis=0)[:steps]
    seen += [env.step(torque)[0] for torque in torques]
    return np.stack(seen)


def random_problem(generator: np.random.Generator, steps: int, limit: float):
    """A problem over random dynamics and weights."""
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


def test_without_limits_in_reach_the_plan_is_lqr():
    ahead = horizon(ArmParams(), Weights(0.3, 2.0, 1.0), np.ones(30, np.int64))
    row = 28
    move = np.array([[0.1, ANGLES[row], 0.7, 0.15]])
    z = np.array([0.1, 0.2, 1e-3, 0.01, 0.02])
    states = z[None, :4] + [88 * ANGLES[row], 0, 0, 0]
    planned = plan(ahead, states, z[4:], np.ones(1), move, 0.0)[0]
    transition = ahead.transition[0, row]
    problem = empty_problem(30)
    _set_up(problem, ahead, MoveShape(*move[0]), 1.0, 0.0)
    cost = ahead.final[row] + problem.weight[0]
    by_change = transition[:, 4]
    gain = by_change @ cost @ transition / (1.0 + by_change @ cost @ by_change)
    assert np.abs(planned).max() < 0.3
    for torque in planned:
        v = -gain @ z
        assert torque == pytest.approx(z[4] + v, abs=1e-12)
        z = transition @ z + by_change * v


def test_prediction_is_the_arm_without_friction():
    params = ArmParams(coulomb_friction=0.0)
    ahead = horizon(params, Weights(0.3, 0.0, 1.0))
    move, time = MoveShape(0.3, 1.2, 0.8, 0.2), 0.1
    problem = empty_problem(len(ahead.lengths))
    _set_up(problem, ahead, move, time, 0.0)
    simulation = ArmSimulation(params)
    for k, length in enumerate(ahead.lengths):
        reference = reference_at(TRAPEZOID, move, time)
        around = np.array([88 * reference.angle, 88 * reference.speed, 0.0, 0.0])
        deviation, torque = np.array([0.5, 3.0, 0.004, 0.05]), 0.15
        state = around + deviation
        for _ in range(length):
            state = simulation.advance(state[None], np.array([torque]))[0]
        time += length * CONTROL_PERIOD
        reference = reference_at(TRAPEZOID, move, time)
        predicted = problem.transition[k] @ [*deviation, torque] + problem.offset[k]
        actual = state - [88 * reference.angle, 88 * reference.speed, 0.0, 0.0]
        assert (np.abs(predicted[:4] - actual) < [1e-5, 1e-3, 3e-5, 3e-3]).all()  # the nonlinear arm moves 100-fold


def test_torque_limit_is_planned_for():
    tight = 0.1  # the move needs more for a while
    options = {
        "params": {"torque_limit": tight},
        "move": {"start": 0.2, "goal": 1.3, "duration": 0.9, "ramp_time": 0.2},
    }
    controller = MpcController(params=ArmParams(torque_limit=tight))
    planned = rollout(controller, 1, seed=SEED, options=options)
    controller._ahead = controller._ahead._replace(plant=controller._ahead.plant._replace(torque_limit=np.inf))
    cut = rollout(controller, 1, seed=SEED, options=options)
    for run in (planned, cut):
        assert np.abs(run.torque).max() == pytest.approx(tight)
        assert run.metrics()["saturated_share"][0] > 0.05
    assert planned.cost[0] < 0.97 * cut.cost[0]


def test_batch_is_so_many_single_controllers(controller: MpcController):
    seen, alone = observations(steps=150), MpcController()
    batch, single = None, [None] * seen.shape[1]
    for step in seen:
        actions, batch = controller.predict(step, batch)
        for arm in range(len(step)):
            action, single[arm] = alone.predict(step[arm : arm + 1], single[arm])
            np.testing.assert_array_equal(action[0], actions[arm])


def test_nothing_is_remembered_beyond_an_episode(controller: MpcController):
    first, second = observations(steps=50), observations(steps=50)[::-1]
    memory = fresh = None
    for step in first:
        _, memory = controller.predict(step, memory)
    for k, step in enumerate(second):
        start = np.full(len(step), k == 0)
        used, memory = controller.predict(step, memory, start)
        new, fresh = controller.predict(step, fresh, start)
        np.testing.assert_array_equal(used, new)


def test_memory_passed_in_is_left_alone(controller: MpcController):
    seen = observations(steps=5)
    _, memory = controller.predict(seen[0])
    before = memory.added.copy(), memory.estimate.arm.copy(), memory.estimate.disturbance.copy()
    controller.predict(seen[1], memory)
    after = memory.added, memory.estimate.arm, memory.estimate.disturbance
    for one, other in zip(before, after, strict=True):
        np.testing.assert_array_equal(one, other)


def test_estimated_torsion_follows_the_true_one_on_the_nominal_arm():
    env = BeltArmVectorEnv(8, autoreset_mode="Disabled")
    seen, _ = env.reset(seed=SEED)
    controller, memory = MpcController(params=ArmParams()), None
    errors, true = [], []
    for _ in range(400):
        action, memory = controller.predict(seen, memory)
        true.append(env.state[:, 2:])
        errors.append(memory.estimate.state[:, 2:] - env.state[:, 2:])
        seen, *_ = env.step(action)
    assert (np.std(errors, axis=(0, 1)) < 0.1 * np.std(true, axis=(0, 1))).all()


def test_it_costs_a_fraction_of_the_papers_controller(controller: MpcController):
    mine = rollout(controller, 16, seed=SEED, randomization="ideal").cost
    papers = rollout(PaperController(), 16, seed=SEED, randomization="ideal").cost
    assert np.median(mine) < 0.4 * np.median(papers)


@pytest.mark.parametrize("name, value", [("velocity_weight", 0.0), ("friction_share", float("nan"))])
def test_gains_out_of_range_are_refused(name: str, value: float):
    with pytest.raises(ValueError, match=rf"MpcGains.{name} must lie within .* got {value!r}"):
        MpcGains(**{name: value})
