"""Plans for the task's own cost, and plans made anew."""

from dataclasses import astuple

import numpy as np

from baselines.planning.plan import Plans, Weights, plan_cost, planned_torque, replanned
from baselines.planning.replanning import STEPS, PlanCache, Situation
from baselines.planning.task_plan import anchor, improve, plan_room, plan_squares, plan_task, problem_of
from beltarm_env import ArmParams
from beltarm_env.arm import params_table, plant_of
from beltarm_env.physics.kinematics import tip_errors
from beltarm_env.simulation import ArmSimulation
from beltarm_env.task.cost import POSITION_SCALE, TORQUE_RATE_WEIGHT, VELOCITY_SCALE
from beltarm_env.task.reference import MoveShape, sampled_moves

MOVES = np.array([[0.2, 1.0, 0.7, 0.2], [1.3, 0.3, 0.8, 0.25], [0.05, 0.7, 0.6, 0.16]])
ARM = ArmParams(coulomb_friction=0.0)
TABLE = np.repeat(params_table([ARM]), len(MOVES), axis=0)
WEIGHTS = Weights(0.5, 10.0, 0.0)
ALL = np.ones(len(MOVES), np.bool_)


def planned(steps: int, time: float = 0.0) -> Plans:
    """Plans after some steps of improvement, for arms that rest at their start at that time."""
    plans, rest = [], np.array([ARM.gear_ratio, 0.0, 0.0, 0.0])
    for move, row in zip(MOVES, TABLE, strict=True):
        plans.append(np.empty((1200, 10)))
        plan_task(MoveShape(*move), row, plan_cost(WEIGHTS), time, move[0] * rest, steps, plan_room(), plans[-1])
    return plans


def simulated_costs(plans) -> np.ndarray:
    """Costs, as the task has them, of the plans' laws on the nonlinear arm, by the environment's integrator."""
    simulation, states = ArmSimulation([ARM] * len(MOVES)), np.zeros((len(MOVES), 4))
    states[:, 0] = ARM.gear_ratio * MOVES[:, 0]
    tasks = sampled_moves(MOVES)
    costs, last = np.zeros(len(MOVES)), np.zeros(len(MOVES))
    for k in range(1000):
        torque = planned_torque(plans, np.full(len(MOVES), float(k)), states, last)
        torque = np.clip(torque, -ARM.torque_limit, ARM.torque_limit)
        states = simulation.advance(states, torque)
        for i in range(len(MOVES)):
            (error,) = tip_errors(states[i : i + 1], tasks[i, k + 1 : k + 2, :2], plant_of(TABLE[i]))
            costs[i] += np.hypot(error[0], error[1]) / POSITION_SCALE + np.hypot(error[2], error[3]) / VELOCITY_SCALE
        costs += TORQUE_RATE_WEIGHT * np.abs(torque - last) / ARM.torque_limit
        last = torque
    return costs


def test_improvement_lowers_the_tasks_cost_on_the_nonlinear_arm():
    before, after = simulated_costs(planned(0)), simulated_costs(planned(6))
    assert (after < 0.97 * before).all(), (before, after)


def test_improved_plans_keep_within_the_torque_limit():
    for plan in planned(30):
        assert np.abs(plan[:-1, 9]).max() <= ARM.torque_limit


def test_anchoring_changes_nothing_about_the_law():
    rng = np.random.default_rng(3)
    before = replanned(None, ALL, MOVES, TABLE, WEIGHTS)
    time = np.array([40.3, 200.0, 610.8])
    there = np.array([plan[int(t), :4] for plan, t in zip(before, time, strict=True)])
    there += rng.normal(0, [0.1, 1.0, 1e-3, 0.02], there.shape)
    after, room = [plan.copy() for plan in before], plan_room()
    for arm, move in enumerate(MOVES):
        plan_squares(MoveShape(*move), TABLE[arm], plan_cost(WEIGHTS), 0, room, np.empty((1200, 10)))
        anchor(after[arm], time[arm], there[arm], problem_of(MoveShape(*move), TABLE[arm]), room.model)
    for later in (1, 2, 100):
        whole = np.floor(time) + later
        x = np.array([plan[int(t), :4] for plan, t in zip(before, whole, strict=True)])
        x += rng.normal(0, [0.1, 1.0, 1e-3, 0.02], x.shape)
        torques = [planned_torque(plans, whole, x, np.zeros(3)) for plans in (before, after)]
        np.testing.assert_allclose(*torques, rtol=1e-9)
    for arm, plan in enumerate(after):
        k, share = int(time[arm]), time[arm] % 1
        now = plan[k, :4] + share * (plan[k + 1, :4] - plan[k, :4])
        assert (np.abs(now - there[arm]) < [0.02, 0.3, 1e-4, 5e-3]).all()


def test_what_is_past_stays():
    (before, *_), room, move = planned(0), plan_room(), MoveShape(*MOVES[0])
    plan_squares(move, TABLE[0], plan_cost(WEIGHTS), 0, room, np.empty((1200, 10)))
    after = before.copy()
    assert improve(after, 101, problem_of(move, TABLE[0]), room)
    assert (after[:101, 9] == before[:101, 9]).all() and (after[:102, :4] == before[:102, :4]).all()
    assert not (after[101:, 9] == before[101:, 9]).all()


def test_nothing_is_left_to_improve_at_the_end():
    for plan, squares in zip(planned(6, 1199.0), replanned(None, ALL, MOVES, TABLE, WEIGHTS), strict=True):
        assert (plan == squares).all()


class TestReplanning:
    @staticmethod
    def situation(step: int, logs: np.ndarray) -> Situation:
        steps = np.full(3, step)
        rest = np.column_stack([ARM.gear_ratio * MOVES[:, 0], np.zeros((3, 3))])
        return Situation(MOVES, steps, steps + 1.4, rest, logs, TABLE)

    @staticmethod
    def begun(steps: int = STEPS) -> PlanCache:
        nothing = np.zeros((3, 1))
        return PlanCache.empty(nothing).begun(ALL, TestReplanning.situation(0, nothing), WEIGHTS, steps)

    def test_first_plan_is_that_of_the_tasks_cost(self):
        before, after = simulated_costs(self.begun(0).plans), simulated_costs(self.begun().plans)
        assert (after < 0.97 * before).all(), (before, after)

    def test_arms_that_begin_alike_share_a_plan(self):
        """One whose command acts later, or that begins no episode, has another."""
        nothing, now = np.zeros((6, 1)), self.situation(0, np.zeros((3, 1)))
        twice = Situation(*(np.concatenate([part, part]) for part in astuple(now)))
        twice.time[4] += 0.1
        begins = np.array([True, True, True, True, True, False])
        plans = PlanCache.empty(nothing).begun(begins, twice, WEIGHTS).plans
        assert plans[3] is plans[0] and plans[4] is not plans[1] and plans[5].size == 0
        for plan, alone in zip(plans[:3], self.begun().plans, strict=True):
            assert plan.tobytes() == alone.tobytes()
        later = self.situation(0, np.zeros((3, 1)))
        later.time[1] += 0.1
        expected = PlanCache.empty(np.zeros((3, 1))).begun(ALL, later, WEIGHTS).plans[1]
        assert plans[4].tobytes() == expected.tobytes() != plans[1].tobytes()

    def test_plans_are_made_anew_where_the_arm_is_another(self):
        before = self.begun()
        after = before.renewed(self.situation(20, np.array([[0.03], [0.01], [-0.03]])), WEIGHTS)
        assert [new is old for new, old in zip(after.plans, before.plans, strict=True)] == [False, True, False]
        assert after.logs.tolist() == [[0.03], [0.0], [-0.03]]

    def test_what_does_not_begin_stays(self):
        begins, before = np.array([True, False, True]), self.begun()
        after = before.begun(begins, self.situation(0, np.ones((3, 1))), WEIGHTS)
        assert [new is old for new, old in zip(after.plans, before.plans, strict=True)] == [False, True, False]
        assert after.logs.tolist() == [[1.0], [0.0], [1.0]]

    def test_plans_are_not_made_anew_between_times(self):
        before = self.begun()
        assert before.renewed(self.situation(19, np.full((3, 1), 0.5)), WEIGHTS) is before
