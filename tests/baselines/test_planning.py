"""Plans: optimal for their linear problem, improved for the task's own cost, made anew; and those of oracles."""

import math
from dataclasses import asdict, astuple, replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from refusals import refused

from baselines import tuned_controller
from baselines.models.linear import at_angle, linear_arm
from baselines.optimal.adaptive import AdaptiveController
from baselines.planning.plan import GAIN, TORQUE, Plans, Weights, planned, problem_of, torque_of_plan
from baselines.planning.replanning import PlanCache, Situation
from baselines.planning.task_plan import PlanRoom, Start, _cost, plan_task
from baselines.yardsticks.clairvoyant import Replay, optimum, shift_optimum
from baselines.yardsticks.privileged import PrivilegedController
from beltarm_env import CONTROL_PERIOD, EPISODE_STEPS, ArmParams, BeltArmVectorEnv
from beltarm_env.arm import params_table, plant_of
from beltarm_env.arrays import Floats
from beltarm_env.observation import size
from beltarm_env.physics.kinematics import tip_errors
from beltarm_env.rollout import rollout
from beltarm_env.simulation import ArmSimulation
from beltarm_env.task.cost import POSITION_SCALE, TORQUE_RATE_WEIGHT, VELOCITY_SCALE
from beltarm_env.task.reference import TRAPEZOID, MoveShape, reference_at, sampled_moves

GEAR = 88.0
MOVE = np.array([[0.3, 1.1, 0.8, 0.2]])
WEIGHTS = Weights(0.3, 2.0, 20.0)


def linear_run(torques: Floats | None, gains: float = 1.0, weights: Weights = WEIGHTS) -> tuple[float, Floats]:
    """Cost of the plan's own problem, by simulating its linear model along the move: independent of its recursion."""
    arm, plan = ArmParams(), planned(MOVE[0], ArmParams().row(), weights)
    tables, move = linear_arm(arm), MoveShape(*MOVE[0])
    references = [reference_at(TRAPEZOID, move, CONTROL_PERIOD * k)[:2] for k in range(EPISODE_STEPS + 1)]
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
        (best, torques), rng = linear_run(None), np.random.default_rng(0)
        for _ in range(4):
            other = rng.normal(0, 1e-3, EPISODE_STEPS)
            costs = [linear_run(torques + s * other)[0] for s in (-1, 1)]
            assert min(costs) > best
            assert costs[0] - best == pytest.approx(costs[1] - best, rel=1e-3), "stationary: no slope, only curvature"
        assert linear_run(None, gains=0.8)[0] > best

    def test_is_read_between_samples(self):
        rows = planned(MOVE[0], ArmParams().row(), WEIGHTS)
        x, last = np.array([GEAR * 0.4, 30.0, 0.01, 0.0]), 0.05

        def torque(time: float) -> float:
            return torque_of_plan(rows, time, x, last)

        row = rows[100]
        assert torque(100.0) == pytest.approx(row[9] - row[4:9] @ np.append(x - row[:4], last), rel=1e-12)
        assert torque(100.5) == pytest.approx(0.5 * (torque(100.0) + torque(101.0)), abs=1e-3)
        assert torque(1199.0) == torque(1300.0)


MOVES = np.array([[0.2, 1.0, 0.7, 0.2], [1.3, 0.3, 0.8, 0.25], [0.05, 0.7, 0.6, 0.16]])
ARM = ArmParams(coulomb_friction=0.0)
TABLE = np.repeat(params_table([ARM]), len(MOVES), axis=0)
RESTS = np.column_stack([ARM.gear_ratio * MOVES[:, 0], np.zeros((3, 3))])
TASK_WEIGHTS = Weights(0.5, 10.0, 0.0)


def task_plans(steps: int, time: float = 0.0) -> Plans:
    """Plans after some steps of improvement, for arms that rest at their start at that time."""
    plans, room = [np.empty((1200, 10)) for _ in MOVES], PlanRoom(linear_arm(ARM), np.zeros((1200, 6)))
    for move, row, rest, plan in zip(MOVES, TABLE, RESTS, plans, strict=True):
        plan_task(MoveShape(*move), row, TASK_WEIGHTS, Start(0, time, rest, steps), room, plan)
    return plans


def simulated_costs(plans) -> np.ndarray:
    """Costs, as the task has them, of the plans' laws on the nonlinear arm, by the environment's integrator."""
    simulation, states, tasks = ArmSimulation([ARM] * len(MOVES)), RESTS, sampled_moves(MOVES)
    costs, last = np.zeros(len(MOVES)), np.zeros(len(MOVES))
    for k in range(1000):
        torque = [torque_of_plan(*of, float(k), x, before) for *of, x, before in zip(plans, states, last, strict=True)]
        torque = np.clip(torque, -ARM.torque_limit, ARM.torque_limit)
        states = simulation.advance(states, torque)
        for i in range(len(MOVES)):
            (error,) = tip_errors(states[i : i + 1], tasks[i, k + 1 : k + 2, :2], plant_of(TABLE[i]), None)
            costs[i] += np.hypot(error[0], error[1]) / POSITION_SCALE + np.hypot(error[2], error[3]) / VELOCITY_SCALE
        costs += TORQUE_RATE_WEIGHT * np.abs(torque - last) / ARM.torque_limit
        last = torque
    return costs


def test_improvement_lowers_the_tasks_cost_on_the_nonlinear_arm_within_the_torque_limit():
    before, after = simulated_costs(task_plans(0)), simulated_costs(task_plans(6))
    assert (after < 0.97 * before).all(), (before, after)
    for plan in task_plans(30):
        assert np.abs(plan[:-1, 9]).max() <= ARM.torque_limit


def test_nothing_is_left_to_improve_at_the_end():
    for plan, move, row in zip(task_plans(6, 1199.0), MOVES, TABLE, strict=True):
        assert (plan == planned(move, row, TASK_WEIGHTS)).all()


class TestReplanning:
    @staticmethod
    def situation(step: int, *logs: float) -> Situation:
        steps = np.full(3, step)
        return Situation(MOVES, steps, steps + 1.4, RESTS.copy(), np.reshape(logs, (3, 1)), TABLE)

    def begun(self, now: Situation | None = None) -> PlanCache:
        now = now or self.situation(0, 0.0, 0.0, 0.0)
        return PlanCache.empty(np.zeros_like(now.logs)).begun(np.ones(len(now.logs), np.bool_), now, TASK_WEIGHTS)

    def test_arms_that_begin_alike_share_a_plan_that_is_the_one_of_each(self):
        now, later = (self.situation(0, 0.0, 0.0, 0.0) for _ in range(2))
        later.time[1] += 0.1
        parts: Any = map(np.concatenate, zip(astuple(now)[:-1], astuple(later)[:-1], strict=True))
        both = Situation(*parts)
        plans = self.begun(both).plans
        assert plans[3] is plans[0] and plans[4].tobytes() != plans[1].tobytes()
        for plan, alone in zip(plans, [*self.begun().plans, *self.begun(later).plans], strict=True):
            assert plan.tobytes() == alone.tobytes()

    def test_plans_are_made_anew_where_the_arm_is_another_but_not_between_times(self):
        before, begins = self.begun(), np.array([True, False, True])
        after = before.renewed(self.situation(20, 0.03, 0.01, -0.03), TASK_WEIGHTS)
        assert after.logs.tolist() == [[0.03], [0.0], [-0.03]]
        for other in (after, before.begun(begins, self.situation(0, 1.0, 1.0, 1.0), TASK_WEIGHTS)):
            assert [new is old for new, old in zip(other.plans, before.plans, strict=True)] == [False, True, False]
        assert before.renewed(self.situation(19, 0.5, 0.5, 0.5), TASK_WEIGHTS) is before

    def test_plans_around_the_end_are_made_from_where_the_arm_is_and_improved(self):
        before, step = self.begun(), int(MOVES[1, 2] / 0.0015) // 20 * 20
        now = self.situation(step, 0.0, 0.0, 0.0)
        now.states[1] = ARM.gear_ratio * MOVES[1, 1] + 0.3, 0.0, 0.01, 0.1
        squares, improved = (before.renewed(now, TASK_WEIGHTS, steps).plans[1] for steps in (0, 2))
        assert improved is not before.plans[1] and improved[step + 5, TORQUE] != squares[step + 5, TORQUE]
        np.testing.assert_array_equal(improved[step:, GAIN:TORQUE], squares[step:, GAIN:TORQUE])
        problem, rest = problem_of(MoveShape(*MOVES[1]), TABLE[1], linear_arm(ARM), TASK_WEIGHTS), np.zeros((1200, 6))
        costs = [_cost(plan, rest, step + 2, 0.0, problem) for plan in (squares, improved)]
        assert costs[1] < costs[0]


def costs_of_beginnings(params: ArmParams, move: MoveShape, actions: np.ndarray) -> np.ndarray:
    """Costs of the first T samples of n episodes, replayed, under actions of shape (n, T)."""
    count, steps = actions.shape
    whole = np.zeros((count, EPISODE_STEPS), np.float32)
    whole[:, :steps] = actions
    options = {"params": asdict(params), "move": move._asdict()}
    played = rollout(Replay(whole), count, seed=0, options=options)
    tip, speed = (np.linalg.norm(e[:steps], axis=2).sum(axis=0) for e in (played.tip_error, played.tip_velocity_error))
    change = np.abs(np.diff(whole[:, :steps].astype(np.float64), prepend=0)).sum(axis=1)
    return tip / 0.01 + speed / 0.2 + 0.1 * change


def test_a_short_problem_ends_at_the_least_cost_from_anywhere():
    """An independent nonlinear program of this problem, multiple shooting with IPOPT, came to 60.6444."""
    move = MoveShape(0.8, 1.2, 0.6, 0.15)
    for share in (0.3, 1.0):
        actual = optimum(ArmParams(), move, np.full(120, share))
        assert actual.cost == pytest.approx(60.6444, rel=1e-4)
        replayed = costs_of_beginnings(ArmParams(), move, actual.actions[None])
        assert replayed == pytest.approx(actual.cost, rel=1e-9)


def test_a_drive_is_met_as_it_is_built():
    env, rng = BeltArmVectorEnv(1, randomization="train"), np.random.default_rng(0)
    env.reset(seed=5_000_004)
    (params,), (move,) = env.params, [MoveShape(*row) for row in env.moves.tolist()]
    actual = optimum(params, move, np.full(120, 0.5))
    knots = rng.normal(0, 1, (60, 13)) * np.logspace(-4, -1, 60)[:, None]
    nearby = [actual.actions + np.interp(np.arange(120), np.arange(0, 130, 10), row) for row in knots]
    costs = costs_of_beginnings(params, move, np.clip([actual.actions, *nearby], -1, 1))
    assert costs[0] == pytest.approx(actual.cost, rel=1e-9)
    assert costs[1:].min() > 0.999 * actual.cost


def test_torques_of_a_shift_cost_the_same_when_they_are_replayed_and_no_controller_costs_less():
    """The second move begins with the state and the command with which the optimum of the first one ended.

    From the torques of `privileged` alone, its search ends at 149; from those of `adaptive` at 128.
    """
    task = {"num_arms": 1, "seed": 8, "randomization": "train", "moves": 2}
    tuned = rollout(tuned_controller("adaptive"), **task)
    arms = [[ArmParams.from_row(row)] for row in tuned.params]
    known = rollout(PrivilegedController(*arms), sensors="full", **task)
    found = shift_optimum(known, tuned)
    replayed = rollout(Replay(np.concatenate([best.actions for best in found])[None]), **task)
    least = [best.cost for best in found]
    np.testing.assert_array_equal(replayed.params, tuned.params)
    np.testing.assert_array_equal(replayed.state[-1], [best.end[:4] for best in found])
    assert replayed.cost == pytest.approx(least, rel=1e-9)
    assert found[0].actions[-1] != 0 and (least < tuned.cost).all() and (least < known.cost).all()
    several = rollout(tuned_controller("adaptive"), 2, seed=8, moves=2)
    refused(ValueError, ("one arm", "recording of 2"), partial(shift_optimum, known, several))


def test_who_knows_arm_and_equations_costs_less_and_the_privileged_one_knows_its_own_arms_alone():
    env = BeltArmVectorEnv(4, autoreset_mode="Disabled", randomization="ideal")
    env.reset(seed=5_000_000)
    oracle = PrivilegedController(env.params)
    cost = rollout(oracle, 4, seed=5_000_000, randomization="ideal", sensors="full").cost
    assert (cost < rollout(AdaptiveController(), 4, seed=5_000_000, randomization="ideal").cost).all()
    arms = {"seed": 5_000_000, "randomization": "ideal", "model": "lagrangian"}  # of two links
    known = rollout(PrivilegedController(env.params, model="lagrangian"), 4, sensors="full", **arms)
    told, blind = (rollout(AdaptiveController(model=model), 4, **arms) for model in ("lagrangian", "lumped"))
    assert (known.cost < told.cost).all() and told.cost.mean() < 0.9 * blind.cost.mean()
    for shape, words in (((4, size()), ("sensors='full'",)), ((3, size("full")), ("4 arms", "3"))):
        refused(ValueError, words, partial(oracle.predict, np.full(shape, 0.5, np.float32)))
    refused(ValueError, ("'full'",), partial(rollout, oracle, 4, sensors="accelerometer"))


def test_the_privileged_one_knows_torque_constant_and_drift_of_its_arms():
    """Its motors give the torque that those of the nominal constant give, and its costs are no higher with drift."""
    nominal = ArmParams(current_loop_time_constant=1e-4)
    strong, drifting = replace(nominal, torque_constant_error=0.2), replace(nominal, friction_drift=0.3)
    runs = {}
    for name, arm in (("nominal", nominal), ("strong", strong), ("drifting", drifting)):
        options = {"params": asdict(arm), "move": {"start": 0.3, "goal": 1.1, "duration": 0.8}}
        runs[name] = rollout(PrivilegedController([arm]), 1, seed=0, options=options, sensors="full")
    np.testing.assert_allclose(1.2 * runs["strong"].torque, runs["nominal"].torque, atol=1e-7)
    assert runs["drifting"].cost < 1.01 * runs["nominal"].cost
