"""Optimal tracking with preview: a linear-quadratic plan for a whole move that is known beforehand.

Along the reference, z = x - x_ref with x_ref = (G theta_ref, G theta_ref', 0, 0) obeys z[k+1] = A z + b tau + d with
the sampled linear arm at theta_ref[k] and d = A x_ref[k] - x_ref[k+1] + e M2' theta_ref'^2 / (2 M2). To first order the
errors e_p, e_v of the tip, in position and velocity, are linear in z (`baselines.optimal.tip_error`). What is minimised
is the sum over the episode of |e_p / 10 mm|^2 + w_v |e_v / 200 mm/s|^2 + rho tau^2, the squares of what the
environment's cost adds up. Backwards from the end (P = 0, s = 0), with P~ = P + Q:

    K = b'P~A / (rho + b'P~b)        tau_ff = -b'(P~ d + s) / (rho + b'P~b)
    P <- A'P~(A - bK)                s <- A'(P~ d + s + P~ b tau_ff)

so that tau = tau_ff - K z is optimal from any state: a feed-forward that acts before the reference does, and the
feedback that belongs to it. See B. D. O. Anderson, J. B. Moore: Optimal Control, 1990, ch. 4.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from baselines.models.linear import LinearArms, between, linear_arms, place, turning_load
from baselines.optimal.riccati import free_input, no_cost, slope_in_input, step_back
from baselines.optimal.tip_error import add_tip_cost, bounded_sine, error_weights
from beltarm_env import CONTROL_PERIOD, EPISODE_STEPS
from beltarm_env.arm import Plant, plant_of
from beltarm_env.arrays import Flags, Floats, Integers
from beltarm_env.jit import compiled, inlined
from beltarm_env.task.reference import TRAPEZOID, sample_references

Triple = tuple[float, float, float]


class Weights(NamedTuple):
    """Weights of the plan's cost, relative to the tip's position error."""

    velocity: float = 0.3  # w_v, of the tip's velocity error
    torque: float = 1.0  # rho [1/(N m)^2]


class Plan(NamedTuple):
    """Optimal control of n moves: tau = torque - gain (x - reference), Coulomb friction left out."""

    reference: Floats  # x_ref, shape (n, 1200, 4)
    gain: Floats  # K, shape (n, 1200, 4)
    torque: Floats  # tau_ff [N m], shape (n, 1200)


@inlined
def _set_step(now: Floats, after: Floats, plant: Plant, model: LinearArms, a: Floats, b: Floats, d: Floats) -> None:
    """Write A, b and d of the step between two samples of the reference, each an angle and a speed."""
    row, weight = place(now[0])
    m2, turning = turning_load(now[0], now[1], plant)
    for i in range(4):
        b[i] = between(model.by_torque[row, i], model.by_torque[row + 1, i], weight)
        d[i] = between(model.by_acceleration[row, i], model.by_acceleration[row + 1, i], weight) * (turning / m2)
        for j in range(4):
            a[i, j] = between(model.transition[row, i, j], model.transition[row + 1, i, j], weight)
    for i in range(4):
        d[i] += plant.gear * (a[i, 0] * now[0] + a[i, 1] * now[1])
    d[0] -= plant.gear * after[0]
    d[1] -= plant.gear * after[1]


@compiled
def _plan_move(task: Floats, plant: Plant, model: LinearArms, weights: Triple, plan: Plan) -> None:
    to_go, slope = no_cost(4), np.empty(6)
    a, b, d = np.empty((4, 4)), np.empty(4), np.empty(4)
    for k in range(len(plan.torque) - 1, -1, -1):
        angle, speed = task[k + 1, 0], task[k + 1, 1]
        add_tip_cost(to_go.matrix, angle, speed, bounded_sine(angle), plant, (weights[0], weights[1]))
        _set_step(task[k], task[k + 1], plant, model, a, b, d)
        slope_in_input(4, to_go, a, b, d, (weights[2], 0.0), slope)
        plan.torque[k] = free_input(4, slope, plan.gain[k])
        step_back(4, to_go, a, slope, plan.gain[k], plan.torque[k])
        plan.reference[k, 0], plan.reference[k, 1] = plant.gear * task[k, 0], plant.gear * task[k, 1]
        plan.reference[k, 2] = plan.reference[k, 3] = 0.0


@compiled
def _plan_moves(tasks: Floats, table: Floats, models: LinearArms, weights: Triple, plans: Plan) -> None:
    for i in range(len(tasks)):
        own = i if len(table) > 1 else 0
        model = LinearArms(models.transition[own], models.by_torque[own], models.by_acceleration[own])
        plan = Plan(plans.reference[i], plans.gain[i], plans.torque[i])
        _plan_move(tasks[i], plant_of(table[own]), model, weights, plan)


def plan_moves(moves: Floats, table: Floats, weights: Weights) -> Plan:
    """Plan n moves.

    Args:
        moves: Start, goal [rad], duration, ramp time [s]; shape (n, 4).
        table: Constants of the arms, columns as `ArmParams`: shape (n, len(FIELDS)), or of one row for all of them.
        weights: Of the errors and of the torque.
    """
    count = len(moves)
    plan = Plan(
        np.empty((count, EPISODE_STEPS, 4)), np.empty((count, EPISODE_STEPS, 4)), np.empty((count, EPISODE_STEPS))
    )
    tasks = np.empty((count, EPISODE_STEPS + 1, 3))
    sample_references(TRAPEZOID, np.ascontiguousarray(moves), CONTROL_PERIOD, tasks)
    _plan_moves(tasks, table, linear_arms(table), (*error_weights(weights.velocity), weights.torque), plan)
    return plan


Plans = list[Floats]
"""Plans of n arms, each of shape (1200, 9), a row a sample: reference, gain, torque. A list, so that a new plan for
some arms leaves those of the others where they are; never changed in place, since a memory that was returned stays
valid."""


def replanned(plans: Plans | None, which: Flags, moves: Floats, table: Floats, weights: Weights) -> Plans:
    """Plans with new ones for some arms; `table` has a row for every arm, or one for all."""
    if plans is not None and not which.any():
        return plans
    new = plan_moves(moves[which], table[which] if len(table) > 1 else table, weights)
    rows = np.concatenate([new.reference, new.gain, new.torque[:, :, None]], axis=2)
    merged = [np.empty(0)] * len(which) if plans is None else plans.copy()
    for arm, of_arm in zip(np.flatnonzero(which), rows, strict=True):
        merged[arm] = of_arm.copy()  # a view would keep the plans of all arms alive
    return merged


def planned_torque(plans: Plans, step: Integers, state: Floats) -> Floats:
    """tau_ff - K (x - x_ref) [N m] of n arms, each at its step of the episode and in its state, shape (n, 4)."""
    rows = np.array([plan[k] for plan, k in zip(plans, np.minimum(step, EPISODE_STEPS - 1), strict=True)])
    feedback = rows[:, 4:8] * (state - rows[:, :4])
    return rows[:, 8] - (feedback[:, 0] + feedback[:, 1] + feedback[:, 2] + feedback[:, 3])
