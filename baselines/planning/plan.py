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

from typing import NamedTuple

import numpy as np

from baselines.models.linear import LinearArms, between, linear_arms, place, turning_load
from baselines.planning.riccati import free_input, no_cost, slope_in_input, step_back
from baselines.planning.tip_error import add_tip_cost, bounded_sine, error_weights
from beltarm_env import EPISODE_STEPS
from beltarm_env.arm import Plant, plant_of
from beltarm_env.arrays import Flags, Floats
from beltarm_env.jit import compiled, inlined
from beltarm_env.task.reference import sampled_moves

Quadruple = tuple[float, float, float, float]


class Weights(NamedTuple):
    """Weights of the plan's cost, relative to the tip's position error."""

    velocity: float = 0.3  # w_v, of the tip's velocity error
    torque: float = 1.0  # rho, of the torque [1/(N m)^2]
    change: float = 1.0  # R, of its change from sample to sample [1/(N m)^2]


class Plan(NamedTuple):
    """Optimal control of n moves: tau = torque - gain [x - reference; tau_last], dry friction left out."""

    reference: Floats  # x_ref, shape (n, 1200, 4)
    gain: Floats  # K, shape (n, 1200, 5)
    torque: Floats  # tau_ff [N m], shape (n, 1200)


@inlined
def set_step(now: Floats, after: Floats, plant: Plant, model: LinearArms, a: Floats, b: Floats, d: Floats) -> None:
    """Write A (4, 4), b and d (4,) of the step between two samples of the reference, each an angle and a speed."""
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
def _plan_move(task: Floats, plant: Plant, model: LinearArms, weights: Quadruple, plan: Plan) -> None:
    to_go, slope = no_cost(5), np.empty(7)
    f, g, h = np.zeros((5, 5)), np.ones(5), np.zeros(5)
    f[4, 4] = 1.0
    for k in range(len(plan.torque) - 1, -1, -1):
        angle, speed = task[k + 1, 0], task[k + 1, 1]
        add_tip_cost(to_go.matrix, angle, speed, bounded_sine(angle), plant, (weights[0], weights[1]))
        to_go.matrix[4, 4] += weights[2]
        set_step(task[k], task[k + 1], plant, model, f, g, h)
        for i in range(4):
            f[i, 4] = g[i]
        slope_in_input(5, to_go, f, g, h, (weights[3], 0.0), slope)
        plan.torque[k] = free_input(5, slope, plan.gain[k])
        step_back(5, to_go, f, slope, plan.gain[k], plan.torque[k])
        plan.gain[k, 4] -= 1.0  # from a law for the change to one for the torque
        plan.reference[k, 0], plan.reference[k, 1] = plant.gear * task[k, 0], plant.gear * task[k, 1]
        plan.reference[k, 2] = plan.reference[k, 3] = 0.0


@compiled
def _plan_moves(tasks: Floats, table: Floats, models: LinearArms, weights: Quadruple, plans: Plan) -> None:
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
        np.empty((count, EPISODE_STEPS, 4)), np.empty((count, EPISODE_STEPS, 5)), np.empty((count, EPISODE_STEPS))
    )
    of_cost = (*error_weights(weights.velocity), weights.torque, weights.change)
    _plan_moves(sampled_moves(moves), table, linear_arms(table), of_cost, plan)
    return plan


Plans = list[Floats]
"""Plans of n arms, each of shape (1200, 10), a row a sample: reference, gain, torque. A list, so that a new plan for
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


def planned_torque(plans: Plans, time: Floats, ahead: Floats, last: Floats) -> Floats:
    """Torque tau_ff - K [x - x_ref; tau_last] [N m] of n arms, each at its time; between samples interpolated.

    Args:
        plans: Of the arms.
        time: At which the torque acts, since the episode's start [samples], shape (n,).
        ahead: State x then, shape (n, 4).
        last: Torque before it, that of the plan [N m], shape (n,).
    """
    step = np.minimum(time.astype(np.intp), EPISODE_STEPS - 2)
    share = np.minimum(time - step, 1.0)[:, None]
    pairs = np.array([plan[k : k + 2] for plan, k in zip(plans, step, strict=True)])
    rows = pairs[:, 0] + share * (pairs[:, 1] - pairs[:, 0])
    feedback = rows[:, 4:8] * (ahead - rows[:, :4])
    return rows[:, 9] - (feedback[:, 0] + feedback[:, 1] + feedback[:, 2] + feedback[:, 3]) - rows[:, 8] * last
