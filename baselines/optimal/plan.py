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
from numpy.typing import NDArray

from baselines.models.linear import LinearArms, linear_arms, place
from baselines.optimal.tip_error import add_tip_cost, bounded_sine, error_weights
from beltarm_env import CONTROL_PERIOD, EPISODE_STEPS
from beltarm_env.arm import plant_of
from beltarm_env.jit import compiled
from beltarm_env.physics.plant import Plant
from beltarm_env.task.reference import TRAPEZOID, sample_references

Floats = NDArray[np.float64]


class Weights(NamedTuple):
    """What the plan weighs against what."""

    velocity: float = 0.3  # w_v, of the tip's velocity error against its position error
    torque: float = 1.0  # rho [1/(N m)^2]


class Plan(NamedTuple):
    """Optimal control of n moves: tau = torque - gain (x - reference), Coulomb friction left out."""

    reference: Floats  # x_ref, shape (n, 1200, 4)
    gain: Floats  # K, shape (n, 1200, 4)
    torque: Floats  # tau_ff [N m], shape (n, 1200)


@compiled
def _plan_move(
    task: Floats,
    plant: Plant,
    tables: tuple[Floats, Floats, Floats],
    weights: tuple[float, float, float],
    reference: Floats,
    gain: Floats,
    torque: Floats,
) -> None:
    states = np.zeros((len(task), 4))
    states[:, 0], states[:, 1] = plant.gear * task[:, 0], plant.gear * task[:, 1]
    reference[:] = states[:-1]
    to_go, slope = np.zeros((4, 4)), np.zeros(4)
    for k in range(len(gain) - 1, -1, -1):
        angle, speed = task[k + 1, 0], task[k + 1, 1]
        add_tip_cost(to_go, angle, speed, bounded_sine(angle), plant, (weights[0], weights[1]))
        angle, speed = task[k, 0], task[k, 1]
        row, weight = place(angle)
        a = tables[0][row] * (1.0 - weight) + tables[0][row + 1] * weight
        b = tables[1][row] * (1.0 - weight) + tables[1][row + 1] * weight
        e = tables[2][row] * (1.0 - weight) + tables[2][row + 1] * weight
        m2 = plant.inertia + plant.inertia_swing * np.sin(angle) ** 2
        centrifugal = plant.inertia_swing * np.sin(angle) * np.cos(angle) * speed * speed / m2
        drift, pb, pa, pd = np.zeros(4), np.zeros(4), np.zeros((4, 4)), np.zeros(4)
        for i in range(4):
            drift[i] = e[i] * centrifugal - states[k + 1, i]
            for j in range(4):
                drift[i] += a[i, j] * states[k, j]
                pb[i] += to_go[i, j] * b[j]
        for i in range(4):
            pd[i] = slope[i]
            for j in range(4):
                pd[i] += to_go[i, j] * drift[j]
                for m in range(4):
                    pa[i, j] += to_go[i, m] * a[m, j]
        effect, target = weights[2], 0.0
        for i in range(4):
            effect += b[i] * pb[i]
            target += b[i] * pd[i]
        torque[k] = -target / effect
        for j in range(4):
            gain[k, j] = (pb[0] * a[0, j] + pb[1] * a[1, j] + pb[2] * a[2, j] + pb[3] * a[3, j]) / effect
        for i in range(4):
            slope[i] = 0.0
            for m in range(4):
                slope[i] += a[m, i] * (pd[m] + pb[m] * torque[k])
        for i in range(4):
            for j in range(i + 1):
                value = 0.0
                for m in range(4):
                    value += a[m, i] * (pa[m, j] - pb[m] * gain[k, j])
                to_go[i, j] = to_go[j, i] = value


@compiled
def _plan_moves(
    tasks: Floats,
    table: Floats,
    models: LinearArms,
    weights: tuple[float, float, float],
    reference: Floats,
    gain: Floats,
    torque: Floats,
) -> None:
    for i in range(len(tasks)):
        own = i if len(table) > 1 else 0
        tables = models[0][own], models[1][own], models[2][own]
        _plan_move(tasks[i], plant_of(table[own]), tables, weights, reference[i], gain[i], torque[i])


def plan_moves(moves: Floats, table: Floats, weights: Weights) -> Plan:
    """Plan n moves.

    Args:
        moves: Start, goal [rad], duration, ramp time [s]; shape (n, 4).
        table: Constants of the arms, columns as `ArmParams`: shape (n, 12), or (1, 12) for one arm in all of them.
        weights: Of the errors and of the torque.
    """
    count = len(moves)
    plan = Plan(
        np.empty((count, EPISODE_STEPS, 4)), np.empty((count, EPISODE_STEPS, 4)), np.empty((count, EPISODE_STEPS))
    )
    tasks = np.empty((count, EPISODE_STEPS + 1, 3))
    sample_references(TRAPEZOID, np.ascontiguousarray(moves), CONTROL_PERIOD, tasks)
    _plan_moves(tasks, table, linear_arms(table), (*error_weights(weights.velocity), weights.torque), *plan)
    return plan


Plans = list[Floats]
"""Plans of n arms, each of shape (1200, 9), a row a sample: reference, gain, torque. A list, so that a new plan for
some arms leaves those of the others where they are; never changed in place, since a memory that was returned must stay
what it was."""


def replanned(plans: Plans | None, which: NDArray[np.bool_], moves: Floats, table: Floats, weights: Weights) -> Plans:
    """The plans with those of some arms made anew; `table` has a row for every arm, or one for all."""
    if plans is not None and not which.any():
        return plans
    new = plan_moves(moves[which], table[which] if len(table) > 1 else table, weights)
    rows = np.concatenate([new.reference, new.gain, new.torque[:, :, None]], axis=2)
    merged = [np.empty(0)] * len(which) if plans is None else plans.copy()
    for arm, of_arm in zip(np.flatnonzero(which), rows, strict=True):
        merged[arm] = of_arm.copy()  # a view would keep the plans of all arms alive
    return merged


def planned_torque(plans: Plans, step: NDArray[np.intp], state: Floats) -> Floats:
    """tau_ff - K (x - x_ref) [N m] of n arms, each at its step of the episode and in its state, shape (n, 4)."""
    rows = np.array([plan[k] for plan, k in zip(plans, np.minimum(step, EPISODE_STEPS - 1), strict=True)])
    feedback = rows[:, 4:8] * (state - rows[:, :4])
    return rows[:, 8] - (feedback[:, 0] + feedback[:, 1] + feedback[:, 2] + feedback[:, 3])
