"""Improvement of a plan for the task's own cost, step by step.

The plan of `baselines.planning.plan` minimises squares. What the task charges are norms, of the tip's exact errors, and
the torque's change; and the motor's torque is limited, of which friction takes its share:

    min  sum_k |e_p| / 10 mm + |e_v| / 200 mm/s + 0.1 |tau_k - tau_(k-1)| / limit,   |tau_k| <= limit - friction

From the state that the plan has reached, its torques are improved by the step of `baselines.planning.norm_optimal`, as
far along it as the cost falls (a Gauss-Newton step with line search; W. Li, E. Todorov: Iterative linear quadratic
regulator design for nonlinear biological movement systems, ICINCO 2004). The arm is the plan's, linear about the
reference, without friction, which is compensated.

Of the plan's law only the feed-forward and the motion that belongs to it change: tau = tau_k - K [x - x_k] keeps the
gain of the squares. So the loop, and its margins, are those of the plan.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from baselines.models.linear import LinearArms, linear_arms
from baselines.planning.norm_optimal import Trial, followed, norm_weights, optimal_change
from baselines.planning.plan import Plans, set_step
from baselines.planning.tip_error import bounded_sine, write_tip_errors
from beltarm_env import EPISODE_STEPS
from beltarm_env.arm import COLUMN, Plant, plant_of
from beltarm_env.arrays import Flags, Floats
from beltarm_env.jit import compiled, inlined
from beltarm_env.physics.kinematics import tip_errors
from beltarm_env.task.cost import POSITION_SCALE, TORQUE_RATE_WEIGHT, VELOCITY_SCALE
from beltarm_env.task.reference import Reference, sampled_moves

_SOFT = 0.01, 0.05  # shares of the errors' scales, and of the torque limit, below which norms count as squares
_EFFORT = 1.0  # [1/(N m)^2] on a step's change of the torque: which keeps the step's problem well posed
_SHORTEST = 0.05  # of a step, before it is given up
_LAST = EPISODE_STEPS - 3  # sample from which there is nothing left to plan


class _Problem(NamedTuple):
    """What the samples from one on charge, for one arm."""

    task: Floats  # reference angle, speed, acceleration at each sample (rad, s), shape (T + 1, 3)
    plant: Plant
    model: LinearArms
    room: float  # torque that the limit leaves beside friction [N m]


@inlined
def _reference(problem: _Problem, k: int) -> Reference:
    """Reference at a sample."""
    return Reference(problem.task[k, 0], problem.task[k, 1], problem.task[k, 2])


@compiled
def _cost(errors: Floats, torque: Floats, before: float, problem: _Problem) -> float:
    """Sum up what the task charges; errors of shape (T, 4), torques [N m] of shape (T,)."""
    total, last = 0.0, before
    for k in range(len(torque)):
        total += np.hypot(errors[k, 0], errors[k, 1]) / POSITION_SCALE
        total += np.hypot(errors[k, 2], errors[k, 3]) / VELOCITY_SCALE
        total += TORQUE_RATE_WEIGHT * abs(torque[k] - last) / problem.plant.torque_limit
        last = torque[k]
    return total


@compiled
def _trial(errors: Floats, problem: _Problem) -> Trial:
    """Linear problem about a motion with these errors; the arm is that of the plan."""
    steps = len(errors)
    transition, by_torque, of_state = np.empty((steps, 4, 4)), np.empty((steps, 4)), np.empty((steps, 4, 4))
    unused = np.empty(4)
    for k in range(steps):
        now, after = _reference(problem, k), _reference(problem, k + 1)
        set_step(now, after, problem.plant, problem.model, transition[k], by_torque[k], unused)
        write_tip_errors(after.angle, after.speed, bounded_sine(after.angle), problem.plant, of_state[k])
    return Trial(transition, by_torque, errors, of_state)


@compiled
def _anchor(rows: Floats, share: float, state: Floats, problem: _Problem) -> None:
    """Write down where the law of a plan leads to from a state: within the torque limit, that leaves the law as it is.

    Args:
        rows: Reference, gain, torque; shape (T + 1, 10).
        share: Of the first sample, at which the state is.
        state: x, shape (4,).
        problem: Of these samples.
    """
    a, b, d, z, following = np.empty((4, 4)), np.empty(4), np.empty(4), np.empty(4), np.empty(4)
    for i in range(4):
        z[i] = state[i] - (rows[0, i] + share * (rows[1, i] - rows[0, i]))
    for k in range(-1, len(rows) - 1):
        now = max(k, 0)
        after = _reference(problem, now + 1)
        set_step(_reference(problem, now), after, problem.plant, problem.model, a, b, d)
        torque = rows[now, 9]
        for i in range(4):
            torque -= rows[now, 4 + i] * z[i]
        torque = min(max(torque, -problem.room), problem.room)
        for i in range(4):
            following[i] = b[i] * torque + d[i]
            for j in range(4):
                following[i] += a[i, j] * z[j]
        if k < 0:  # first back to the sample, by as much as the arm moves within one
            z -= share * (following - z)
        else:
            rows[k, :4] += z
            rows[k, 9] = torque
            z[:] = following


@compiled
def _improve(rows: Floats, problem: _Problem) -> bool:
    """Improve all rows of a plan but the first, in place; tell whether there was anything to gain.

    Args:
        rows: Reference, gain, torque; shape (T + 2, 10).
        problem: Of these samples but the first.
    """
    before, torque, states = rows[0, 9], rows[1:-1, 9].copy(), rows[2:, :4].copy()
    task, plant, jumps = problem.task[1:, :2], problem.plant, np.empty(len(torque))
    for k in range(len(torque)):
        jumps[k] = torque[k] - rows[k, 9]
    errors = tip_errors(states, task, plant)
    cost, trial = _cost(errors, torque, before, problem), _trial(errors, problem)
    weights = norm_weights(errors, jumps, plant.torque_limit, _EFFORT, _SOFT)
    change, gain = optimal_change(trial, weights, torque, problem.room, before)
    change, away = followed(trial, change, gain)
    share = 1.0
    while share >= _SHORTEST:
        there, torques = states + share * away, torque + share * change
        if _cost(tip_errors(there, task, plant), torques, before, problem) < cost:
            rows[1:-1, 9], rows[2:, :4] = torques, there
            return True
        share *= 0.5
    return False


def _problem(move: Floats, row: Floats, first: int) -> _Problem:
    """Problem of one arm, with a row of constants, from a sample on."""
    task, models, plant = sampled_moves(move[None])[0], linear_arms(row[None]), plant_of(row)
    friction = plant.coulomb_friction * (1 + float(row[COLUMN.friction_variation]))
    room = max(plant.torque_limit - friction, 0.1 * plant.torque_limit)
    return _Problem(task[first:], plant, LinearArms(*(part[0] for part in models)), room)


def anchored(plans: Plans, which: Flags, time: Floats, states: Floats, moves: Floats, table: Floats) -> Plans:
    """Plans whose reference is the motion that their law leads to from here, within the torque limit, for some arms.

    Args:
        plans: Of n arms, without a weight of the torque's change.
        which: Arms that are asked for, shape (n,).
        time: Since the episode's start [samples], shape (n,).
        states: x at that time, shape (n, 4).
        moves: Start, goal [rad], duration, ramp time [s]; shape (n, 4).
        table: Constants of the arms, columns as `ArmParams`, shape (n, len(FIELDS)).
    """
    result = plans.copy()
    for arm in np.flatnonzero(which & (time < _LAST)):
        first = int(time[arm])
        result[arm] = plans[arm].copy()
        _anchor(result[arm][first:], time[arm] - first, states[arm], _problem(moves[arm], table[arm], first))
    return result


def improved(
    plans: Plans, which: Flags, time: Floats, moves: Floats, table: Floats, steps: int = 1
) -> tuple[Plans, Flags]:
    """Plans after some steps of improvement for some arms, from the sample after this time on.

    Args:
        plans: Of n arms; those asked for are `anchored`.
        which: Arms that are asked for, shape (n,).
        time: Since the episode's start [samples], shape (n,).
        moves: Start, goal [rad], duration, ramp time [s]; shape (n, 4).
        table: Constants of the arms, columns as `ArmParams`, shape (n, len(FIELDS)).
        steps: At most; fewer where there is nothing left to gain.

    Returns:
        Plans, and for which arms there was something to gain, shape (n,).
    """
    result, gained = plans.copy(), np.zeros(len(which), np.bool_)
    for arm in np.flatnonzero(which & (time < _LAST)):
        first = int(time[arm])
        result[arm] = plans[arm].copy()
        rows, problem = result[arm][first:], _problem(moves[arm], table[arm], first + 1)
        for _ in range(steps):
            if not _improve(rows, problem):
                break
            gained[arm] = True
    return result, gained
