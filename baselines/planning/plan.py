"""Optimal tracking with preview: a linear-quadratic plan for a whole move that is known beforehand.

Along the reference, z = x - x_ref with x_ref = (G theta_ref, G theta_ref', 0, 0) obeys z[k+1] = A z + b tau + d with
the sampled linear arm at theta_ref[k] and d = A x_ref[k] - x_ref[k+1] + e M2' theta_ref'^2 / (2 M2). To first order the
errors e_p, e_v of the tip, in position and velocity, are linear in z (`baselines.planning.tip_error`). What is
minimised is the sum over the episode of

    |e_p / 10 mm|^2 + w_v |e_v / 200 mm/s|^2 + rho tau^2 + R (tau - tau_last)^2,

the squares of what the environment's cost adds up. The change of the torque is the input, which makes the last torque a
fifth state. Backwards from the end, by `baselines.planning.riccati`, this gives tau = tau_ff - K [z; tau_last], optimal
from any state: a feed-forward that acts before the reference does, and the feedback that belongs to it. See B. D. O.
Anderson, J. B. Moore: Optimal Control, 1990, ch. 4.

The plan is of the torque at the motor, without friction, and knows no dead time. A command that acts later is read off
it at that time, for the state of the arm then (O. J. M. Smith: Closer control of loops with dead time, 1957): as good
as states of the actuator's own in the plan, for the command held over the dead time is known.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from baselines.models.linear import LinearArm, between, linear_arm_of, place, turning_load
from baselines.planning.riccati import CostToGo, PricedStep, free_input, no_cost, slope_in_input, step_back
from baselines.planning.tip_error import add_tip_cost, bounded_sine, error_weights, write_tip_errors
from beltarm_env import CONTROL_PERIOD, EPISODE_STEPS
from beltarm_env.arm import COLUMN, Plant, plant_of
from beltarm_env.arrays import Flags, Floats
from beltarm_env.engine import compiled, inlined
from beltarm_env.engine.threads import each_in_threads
from beltarm_env.task.reference import TRAPEZOID, MoveShape, Reference, reference_at

GAIN, TORQUE = 4, 9
"""Columns of a plan's row at which the gain and the torque begin; the reference comes first."""
PLAN_COLUMNS = 10


class Weights(NamedTuple):
    """Weights of the plan's cost, relative to the tip's position error."""

    velocity: float = 0.3  # w_v, of the tip's velocity error
    torque: float = 1.0  # rho, of the torque [1/(N m)^2]
    change: float = 1.0  # R, of its change from sample to sample [1/(N m)^2]


class Problem(NamedTuple):
    """Move and arm that a plan is for, and what it minimises."""

    move: MoveShape
    plant: Plant
    left: float  # torque that the limit leaves beside friction [N m]
    model: LinearArm
    weights: Weights
    rest: int  # sample from which the reference rests: the steps from there on are alike, and set once


@inlined
def problem_of(move: MoveShape, row: Floats, model: LinearArm, weights: Weights) -> Problem:
    """Problem of an arm with a row of constants, shape (len(FIELDS),), and their linear model."""
    plant = plant_of(row)
    friction = plant.coulomb_friction * (1 + float(row[COLUMN.friction_variation]))
    rest = math.ceil(move.duration / CONTROL_PERIOD)
    return Problem(move, plant, max(plant.torque_limit - friction, 0.1 * plant.torque_limit), model, weights, rest)


@inlined
def reference_of(problem: Problem, k: int) -> Reference:
    """Reference at a sample of the move."""
    return reference_at(TRAPEZOID, problem.move, k * CONTROL_PERIOD)


@inlined
def set_step(problem: Problem, now: Reference, after: Reference, a: Floats, b: Floats, d: Floats) -> None:
    """Write A (4, 4), b and d (4,) of the step between two samples of the reference."""
    gear, model = problem.plant.gear, problem.model
    row, weight = place(now.angle)
    m2, turning = turning_load(now.angle, now.speed, problem.plant)
    for i in range(4):
        b[i] = between(model.by_torque[row, i], model.by_torque[row + 1, i], weight)
        d[i] = between(model.by_acceleration[row, i], model.by_acceleration[row + 1, i], weight) * (turning / m2)
        for j in range(4):
            a[i, j] = between(model.transition[row, i, j], model.transition[row + 1, i, j], weight)
    for i in range(4):
        d[i] += gear * (a[i, 0] * now.angle + a[i, 1] * now.speed)
    d[0] -= gear * after.angle
    d[1] -= gear * after.speed


@compiled
def plan_backwards(problem: Problem, to_go: CostToGo, first: int, last: int, rows: Floats) -> None:
    """Plan samples `first` to `last` - 1 of a move, the last one first; so a plan may be made piece by piece.

    Args:
        problem: Move and arm.
        to_go: Cost after sample `last` - 1: `no_cost` at the end of the plan. Turned into that before `first`.
        first: Sample, from 0 on.
        last: Sample, up to the number of rows.
        rows: A sample each, [x_ref, K, tau_ff] of tau = tau_ff - K [x - x_ref; tau_last], dry friction left out; shape
            (1200, 10), written.
    """
    plant, weights = problem.plant, problem.weights
    of_errors = error_weights(weights.velocity)
    f, g, h, slope, errors = np.zeros((5, 5)), np.ones(5), np.zeros(5), np.empty(7), np.empty((4, 4))
    f[4, 4] = 1.0
    after = reference_of(problem, last)
    for k in range(last - 1, first - 1, -1):
        now = reference_of(problem, k)
        if k < problem.rest or k == last - 1:
            write_tip_errors(after.angle, after.speed, bounded_sine(after.angle), plant, errors)
            set_step(problem, now, after, f, g, h)
        add_tip_cost(to_go.matrix, errors, of_errors)
        to_go.matrix[4, 4] += weights.torque
        for i in range(4):
            f[i, 4] = g[i]
        slope_in_input(5, to_go, PricedStep(f, g, h, weights.change, 0.0), slope)
        gain = rows[k, GAIN:TORQUE]
        rows[k, TORQUE] = free_input(5, slope, gain)
        step_back(5, to_go, f, slope, gain, rows[k, TORQUE])
        gain[4] -= 1.0  # from a law for the change to one for the torque
        rows[k, 0], rows[k, 1] = plant.gear * now.angle, plant.gear * now.speed
        rows[k, 2], rows[k, 3] = 0.0, 0.0
        after = now


@compiled
def plan_move(move: MoveShape, row: Floats, model: LinearArm, weights: Weights, rows: Floats) -> None:
    """Plan a move of an arm at once; arguments as of `problem_of` and `plan_backwards`."""
    plan_backwards(problem_of(move, row, model, weights), no_cost(5), 0, len(rows), rows)


@inlined
def torque_between(low: Floats, high: Floats, share: float, x: Floats, last: float) -> float:
    """Torque tau_ff - K [x - x_ref; tau_last] [N m] by a plan between two of its rows, a share of their time apart."""
    feedback = 0.0
    for i in range(4):
        gain = low[GAIN + i] + share * (high[GAIN + i] - low[GAIN + i])
        feedback += gain * (x[i] - (low[i] + share * (high[i] - low[i])))
    of_last = low[TORQUE - 1] + share * (high[TORQUE - 1] - low[TORQUE - 1])
    return low[TORQUE] + share * (high[TORQUE] - low[TORQUE]) - feedback - of_last * last


@inlined
def step_of_plan(time: float) -> tuple[int, float]:
    """Row of a plan at or before a time since the move's start [samples], and how far the time is beyond it."""
    step = min(int(time), EPISODE_STEPS - 2)
    return step, min(time - step, 1.0)


@inlined
def torque_of_plan(rows: Floats, time: float, x: Floats, last: float) -> float:
    """Torque [N m] by the plan of one arm at a time since the move's start [samples], see `torque_between`."""
    step, share = step_of_plan(time)
    return torque_between(rows[step], rows[step + 1], share, x, last)


Plans = list[Floats]
"""Plans of n arms, each of shape (1200, 10) as `plan_backwards` writes them. A list, so that a new plan for some arms
leaves those of the others where they are; never changed in place, since a memory that was returned stays valid."""


def planned(move: Floats, row: Floats, weights: Weights, model: LinearArm | None = None) -> Floats:
    """Plan of one move, shape (1200, 10).

    Args:
        move: Start, goal [rad], duration, ramp time [s]; shape (4,).
        row: Constants of the arm, as the fields of `ArmParams`.
        weights: Of the errors and of the torque.
        model: Linear models of the arm, if they are known already.
    """
    rows = np.empty((EPISODE_STEPS, PLAN_COLUMNS))
    plan_move(MoveShape(*map(float, move)), row, model or linear_arm_of(row), weights, rows)
    return rows


def replaced(plans: Plans | None, which: Flags, plan: Callable[[int], Floats]) -> Plans:
    """Plans with new ones, as `plan` makes them, for some arms; all of them where there are none."""
    if plans is not None and not which.any():
        return plans
    merged = [np.empty(0)] * len(which) if plans is None else plans.copy()

    def replace(arm: int) -> None:
        merged[arm] = plan(arm)

    each_in_threads(replace, np.flatnonzero(which).tolist())
    return merged


def rows_at(plans: Plans, time: Floats) -> Floats:
    """Rows of n plans before and after their times [samples], shape (n, 2, 10)."""
    steps = np.minimum(time.astype(np.intp), EPISODE_STEPS - 2)  # see `step_of_plan`
    return np.array([plan[k : k + 2] for plan, k in zip(plans, steps.tolist(), strict=True)])
