"""Improvement of a plan for the task's own cost, step by step.

The plan of `baselines.planning.plan` minimises squares. What the task charges are norms, of the tip's exact errors, and
the torque's change; and the motor's torque is limited, of which friction takes its share:

    min  sum_k |e_p| / 10 mm + |e_v| / 200 mm/s + 0.1 |tau_k - tau_(k-1)| / limit,   |tau_k| <= limit - friction

From the state that the plan has reached, its torques are improved by the step of `baselines.planning.norm_optimal`, as
far along it as the cost falls (a Gauss-Newton step with line search; W. Li, E. Todorov: Iterative linear quadratic
regulator design for nonlinear biological movement systems, ICINCO 2004). The arm is the plan's, linear about the
reference, without friction, which is compensated.

Nothing but the law of the step is stored for all samples: what belongs to one is computed where it is needed.

Of the plan's law only the feed-forward and the motion that belongs to it change: tau = tau_k - K [x - x_k] keeps the
gain of the squares. So the loop, and its margins, are those of the plan.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from baselines.models.linear import LinearArm, empty_linear_arm
from baselines.planning.norm_optimal import (
    Prices,
    Sample,
    deviate,
    empty_sample,
    followed_change,
    sample_change,
    weigh_jump,
    weigh_norms,
)
from baselines.planning.plan import GAIN, TORQUE, Problem, Weights, plan_backwards, problem_of, reference_of, set_step
from baselines.planning.riccati import no_cost
from baselines.planning.tip_error import bounded_sine, write_tip_errors
from beltarm_env import EPISODE_STEPS
from beltarm_env.arm import Plant
from beltarm_env.arrays import Floats
from beltarm_env.engine import compiled, inlined
from beltarm_env.physics.kinematics import tip_error, tip_motion
from beltarm_env.physics.state import ArmState
from beltarm_env.task.cost import POSITION_SCALE, TORQUE_RATE_WEIGHT, VELOCITY_SCALE
from beltarm_env.task.reference import MoveShape, Reference

_SOFT, _SOFT_JUMP = 0.01, 0.05  # of the errors' scales, and of the torque limit: below, norms count as squares
_EFFORT = 1.0  # [1/(N m)^2] on a step's change of the torque: which keeps the step's problem well posed
_SHORTEST = 0.05  # of a step, before it is given up
_LAST = EPISODE_STEPS - 3  # sample from which there is nothing left to plan
_CHANGE = 4  # column of `PlanRoom.steps` with the change of the torque, after the four of the motion's


class Start(NamedTuple):
    """Where a plan begins, and how often it is improved."""

    first: int  # sample since the move's start
    time: float  # when commands begin to act, since the move's start [samples]
    state: Floats  # x then, shape (4,)
    improvements: int  # steps at most; fewer where there is nothing left to gain


class PlanRoom(NamedTuple):
    """Room for making the plan of one arm; what it holds between two calls does not matter."""

    model: LinearArm  # of the arm
    steps: Floats  # law of a step of improvement in each sample, and then what it changes; shape (1200, 6)


def plan_room() -> PlanRoom:
    """Room for making a plan."""
    return PlanRoom(empty_linear_arm(), np.zeros((EPISODE_STEPS, 6)))


@inlined
def _write_errors(x: ArmState, task: Reference, plant: Plant, errors: Floats) -> None:
    """Write the errors of the tip in a state, shape (4,)."""
    error = tip_error(tip_motion(x, plant, None), task.angle, task.speed, plant)
    errors[0], errors[1], errors[2], errors[3] = error.x, error.y, error.x_speed, error.y_speed


@inlined
def _charge(errors: Floats, jump: float, plant: Plant) -> float:
    """What the task charges for a sample."""
    position = math.sqrt(errors[0] * errors[0] + errors[1] * errors[1])
    velocity = math.sqrt(errors[2] * errors[2] + errors[3] * errors[3])
    charge = position / POSITION_SCALE + velocity / VELOCITY_SCALE
    return charge + TORQUE_RATE_WEIGHT * abs(jump) / plant.torque_limit


@compiled
def _cost(rows: Floats, steps: Floats, first: int, share: float, problem: Problem) -> float:
    """Sum up what the task charges from a sample on, a share of a step along."""
    total, errors = 0.0, np.empty(4)
    for k in range(len(rows) - 2, first - 1, -1):
        x = ArmState._make(rows[k + 1, i] + share * steps[k, i] for i in range(4))
        _write_errors(x, reference_of(problem, k + 1), problem.plant, errors)
        before = rows[k - 1, TORQUE] + (share * steps[k - 1, _CHANGE] if k > first else 0.0)
        total += _charge(errors, rows[k, TORQUE] + share * steps[k, _CHANGE] - before, problem.plant)
    return total


@compiled
def anchor(rows: Floats, time: float, state: Floats, problem: Problem) -> None:
    """Write down where the law of a plan leads to from a state: within the torque limit, that leaves the law as it is.

    Args:
        rows: Reference, gain, torque; shape (1200, 10). Changed.
        time: At which the state is, since the move's start [samples].
        state: x, shape (4,).
        problem: Arm and move.
    """
    first = int(time)
    share = time - first
    a, b, d, z, following = np.empty((4, 4)), np.empty(4), np.empty(4), np.empty(4), np.empty(4)
    for i in range(4):
        z[i] = state[i] - (rows[first, i] + share * (rows[first + 1, i] - rows[first, i]))
    for k in range(first - 1, len(rows) - 1):
        now = max(k, first)
        if k <= max(first, problem.rest):
            set_step(problem, reference_of(problem, now), reference_of(problem, now + 1), a, b, d)
        torque = rows[now, TORQUE]
        for i in range(4):
            torque -= rows[now, GAIN + i] * z[i]
        torque = min(max(torque, -problem.left), problem.left)
        for i in range(4):
            following[i] = b[i] * torque + d[i]
            for j in range(4):
                following[i] += a[i, j] * z[j]
        if k < first:  # first back to the sample, by as much as the arm moves within one
            for i in range(4):
                z[i] -= share * (following[i] - z[i])
        else:
            rows[k, TORQUE] = torque
            for i in range(4):
                rows[k, i] += z[i]
                z[i] = following[i]


@compiled
def _solve(rows: Floats, steps: Floats, first: int, problem: Problem, sample: Sample) -> float:
    """Write the law of a step of improvement into `PlanRoom.steps`, K and, in the last column, c of each sample.

    Returns what the task charges for the plan as it is.
    """
    total, to_go, errors, plant = 0.0, no_cost(5), sample.errors, problem.plant
    after = reference_of(problem, len(rows) - 1)
    for k in range(len(rows) - 2, first - 1, -1):
        now, torque = reference_of(problem, k), rows[k, TORQUE]
        if k < problem.rest or k == len(rows) - 2:
            set_step(problem, now, after, sample.transition, sample.by_input, sample.slope)
            write_tip_errors(after.angle, after.speed, bounded_sine(after.angle), plant, sample.of_state)
        x = ArmState._make(rows[k + 1, i] for i in range(4))
        _write_errors(x, after, plant, errors)
        jump = torque - rows[k - 1, TORQUE]
        total += _charge(errors, jump, plant)
        weigh_norms(errors, _SOFT, sample.weights)
        smoothness = weigh_jump(jump, plant.torque_limit, _SOFT_JUMP)
        prices = Prices(_EFFORT, smoothness, jump, -problem.left - torque, problem.left - torque)
        steps[k, 5] = sample_change(5, sample, prices, to_go, steps[k, :5])
        after = now
    return total


@compiled
def _follow(steps: Floats, first: int, problem: Problem, sample: Sample) -> None:
    """Replace the law of a step by what it changes: the state after each sample, and the torque."""
    away, following, last = np.zeros(4), np.zeros(4), 0.0
    now = reference_of(problem, first)
    for k in range(first, len(steps) - 1):
        after = reference_of(problem, k + 1)
        if k <= max(first, problem.rest):
            set_step(problem, now, after, sample.transition, sample.by_input, sample.slope)
        last = followed_change(4, steps[k, 5], steps[k, :5], away, last)
        deviate(4, sample.transition, sample.by_input, away, last, following)
        for i in range(4):
            away[i] = steps[k, i] = following[i]
        steps[k, _CHANGE] = last
        now = after


@compiled
def improve(rows: Floats, first: int, problem: Problem, steps: Floats) -> bool:
    """Improve an anchored plan from a sample on, 1 at least; tell whether there was anything to gain."""
    sample = empty_sample(5)
    cost = _solve(rows, steps, first, problem, sample)
    _follow(steps, first, problem, sample)
    share = 1.0
    while share >= _SHORTEST:
        if _cost(rows, steps, first, share, problem) < cost:
            for k in range(first, len(rows) - 1):
                rows[k, TORQUE] += share * steps[k, _CHANGE]
                for i in range(4):
                    rows[k + 1, i] += share * steps[k, i]
            return True
        share *= 0.5
    return False


@compiled
def refine(problem: Problem, start: Start, steps: Floats, rows: Floats) -> None:
    """Improve the rest of a plan for the task's own cost; `steps` is `PlanRoom.steps`."""
    if start.time < _LAST:
        anchor(rows, start.time, start.state, problem)
        for _ in range(start.improvements):
            if not improve(rows, int(start.time) + 1, problem, steps):
                break


@compiled
def plan_task(move: MoveShape, row: Floats, weights: Weights, start: Start, room: PlanRoom, rows: Floats) -> None:
    """Plan a move for squares and refine the plan, with the linear models of the arm in `room.model`."""
    problem = problem_of(move, row, room.model, weights)
    plan_backwards(problem, no_cost(5), start.first, len(rows), rows)
    refine(problem, start, room.steps, rows)
