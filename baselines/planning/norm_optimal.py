"""Norm-optimal changes of the torque: from one trial to the next, nearer to the task.

A trial is made by an arm, in iterative learning, or simulated, in a search for the best plan.

About the motion x_k of a trial under torques tau_k the arm is linear,

    dx[k+1] = A_k dx[k] + b_k v[k]

with v the change of the torque, and A_k, b_k by differences of the arm's own simulation, friction included: where the
motor sticks, b_k = 0. Behind a real drive, the torque that acts, the commands under way and the deflection of
a motor that gives are states too (`beltarm_env.simulation`). Errors follow as e_k + C_k dx_k. Of the next trial is
asked

    min  sum_k (e_k + C_k dx_k)' W_k (e_k + C_k dx_k) + R v[k]^2 + r_k (D_k + v[k] - v[k-1])^2

with D_k = tau_k - tau_(k-1), over all v at once: the lifted least squares of a whole trial. It is solved exactly,
backwards over z_k = [dx_k; v[k-1]] (`baselines.planning.riccati`), the input being v[k] - v[k-1], as feed-forward
and feedback v[k] = c[k] - K[k] z_k. Torques have a limit: where on the trial's own path (z_k = 0) v[k] would pass it,
the law is v[k] = what is left to the limit, whatever z_k (Y. Tassa, N. Mansard, E. Todorov: Control-limited
differential dynamic programming, ICRA 2014).

A benchmark that charges norms |e|, not squares, is met by weights computed for every trial, W = 1 / (2 |e|) with the
errors of the trial before (iteratively reweighted least squares): the sum then has the norms' slope at that trial.

Sources: N. Amann, D. H. Owens, E. Rogers: Iterative learning control using optimal feedback and feedforward actions,
Int. J. Control 65, 1996; S. Gunnarsson, M. Norrlof: On the design of ILC algorithms using optimization, Automatica 37,
2001; D. A. Bristow, M. Tharayil, A. G. Alleyne: A survey of iterative learning control, IEEE CSM 26, 2006.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from baselines.planning.riccati import CostToGo, PricedStep, free_input, no_cost, slope_in_input, step_back
from beltarm_env import ArmParams
from beltarm_env.arm import COLUMN, plant_of
from beltarm_env.arrays import Floats
from beltarm_env.engine import compiled, inlined
from beltarm_env.physics.drive import real_drive_of
from beltarm_env.physics.friction import SLIPS
from beltarm_env.physics.kinematics import tip_errors
from beltarm_env.simulation import DRIVE_STATES, ArmSimulation, X
from beltarm_env.task.cost import POSITION_SCALE, TORQUE_RATE_WEIGHT, VELOCITY_SCALE

_MOVES = np.array([1e-3, 1e-2, 1e-5, 1e-3])  # of x, for the differences
_TORQUE_MOVE = 1e-4  # of torques: of the motor, of commands under way, of the command
_DEFLECTION_MOVE = 1e-6  # of a motor that gives before it slips


class Trial(NamedTuple):
    """Linear problem about one trial of T samples, of an arm of n states, which begin with x.

    Row k is of sample k, errors are of the state after it.
    """

    transition: Floats  # A, shape (T, n, n)
    by_torque: Floats  # b, shape (T, n)
    errors: Floats  # e, shape (T, 4): tip along and across, position [m] and velocity [m/s]
    of_state: Floats  # C by x, shape (T, 4, 4)


class Weights(NamedTuple):
    """Weights of the next trial's cost."""

    errors: Floats  # diagonals of W, shape (T, 4)
    smoothness: Floats  # r [1/(N m)^2], shape (T,)
    effort: float  # R [1/(N m)^2]


class Change(NamedTuple):
    """Law v[k] = c[k] - K[k] z_k of the next trial."""

    change: Floats  # c [N m], shape (T,)
    gain: Floats  # K, shape (T, n + 1)
    curvature: Floats  # half that of the cost to go in each torque, on the trial's own path [1/(N m)^2], shape (T,)


class Sample(NamedTuple):
    """Problem of one sample, of n states, and room for its solution."""

    transition: Floats  # [A 0; 0 1], shape (n + 1, n + 1); then its last column is changed
    by_input: Floats  # [b; 1], shape (n + 1,)
    nothing: Floats  # zeros, shape (n + 1,)
    errors: Floats  # e, shape (4,)
    of_state: Floats  # C, shape (4, 4)
    weights: Floats  # diagonal of W, shape (4,)
    slope: Floats  # of the cost, shape (n + 3,)


@compiled
def empty_sample(size: int) -> Sample:
    """Room for the problem of one sample; `size` is n + 1, a literal."""
    return Sample(
        np.zeros((size, size)),
        np.zeros(size),
        np.zeros(size),
        np.zeros(4),
        np.zeros((4, 4)),
        np.zeros(4),
        np.zeros(size + 2),
    )


class Prices(NamedTuple):
    """What a change of the torque costs in one sample, and how far it may go."""

    effort: float  # R [1/(N m)^2]
    smoothness: float  # r [1/(N m)^2]
    jump: float  # D, of the torque before it is changed [N m]
    lowest: float  # change [N m]
    highest: float  # [N m]


@inlined
def sample_change(size: int, sample: Sample, prices: Prices, to_go: CostToGo, gain: Floats) -> float:
    """Go back by one sample: write the gain K of the optimal change, shape (n + 1,), and return its constant c [N m].

    `size` is n + 1, a literal. The cost after the sample, `to_go`, becomes that before it. Half the curvature of the
    cost to go is the last entry of the sample's slope then.
    """
    states = size - 1
    for error in range(4):
        for i in range(4):
            weighted = sample.weights[error] * sample.of_state[error, i]
            to_go.vector[i] += weighted * sample.errors[error]
            for j in range(4):
                to_go.matrix[i, j] += weighted * sample.of_state[error, j]
    to_go.matrix[states, states] += prices.effort
    for i in range(states):
        sample.transition[i, states] = sample.by_input[i]
        sample.transition[states, i] = 0.0
    sample.transition[states, states] = sample.by_input[states] = 1.0
    pull = prices.smoothness * prices.jump
    step = PricedStep(sample.transition, sample.by_input, sample.nothing, prices.smoothness, pull)
    slope_in_input(size, to_go, step, sample.slope)
    change = free_input(size, sample.slope, gain)
    left = min(max(change, prices.lowest), prices.highest)
    if left != change:
        change = left
        for i in range(states):
            gain[i] = 0.0
        gain[states] = 1.0
    step_back(size, to_go, sample.transition, sample.slope, gain, change)
    gain[states] -= 1.0  # from a law for v[k] - v[k-1] to one for v[k]
    return change


@inlined
def followed_change(states: int, change: float, gain: Floats, away: Floats, last: float) -> float:
    """Return v = c - K [dx; last] [N m]; dx of shape (n,)."""
    v = change - gain[states] * last
    for j in range(states):
        v -= gain[j] * away[j]
    return v


@inlined
def deviate(states: int, transition: Floats, by_torque: Floats, away: Floats, v: float, following: Floats) -> None:
    """Write dx after a sample, A dx + b v; A may have more rows and columns, b more entries."""
    for i in range(states):
        following[i] = by_torque[i] * v
        for j in range(states):
            following[i] += transition[i, j] * away[j]


@inlined
def weigh_norms(errors: Floats, soft: float, weights: Floats) -> None:
    """Write weights that give the squares of errors, shape (4,), the slope of |e_p| / 10 mm + |e_v| / 200 mm/s.

    Norms over their scale that are below `soft` count as it.
    """
    position = max(math.sqrt(errors[0] * errors[0] + errors[1] * errors[1]) / POSITION_SCALE, soft)
    velocity = max(math.sqrt(errors[2] * errors[2] + errors[3] * errors[3]) / VELOCITY_SCALE, soft)
    weights[0] = weights[1] = 0.5 / (position * (POSITION_SCALE * POSITION_SCALE))
    weights[2] = weights[3] = 0.5 / (velocity * (VELOCITY_SCALE * VELOCITY_SCALE))


@inlined
def weigh_jump(jump: float, limit: float, soft: float) -> float:
    """Weight that gives the square of a jump [N m] of the torque the slope of 0.1 |jump| / limit; see `weigh_norms`."""
    return 0.5 * TORQUE_RATE_WEIGHT / (max(abs(jump) / limit, soft) * (limit * limit))


class Torques(NamedTuple):
    """Torques of a trial, and between which they may be changed."""

    torque: Floats  # tau [N m], shape (T,)
    limit: float  # of the next trial's torques [N m]
    before: float  # torque before the first sample [N m]


@compiled
def optimal_change(
    trial: Trial, weights: Weights, torque: Floats, limit: float = np.inf, before: float = 0.0
) -> Change:
    """Minimise the cost of the next trial.

    Args:
        trial: Of one arm.
        weights: Of errors and torque.
        torque: tau [N m], shape (T,).
        limit: Of the next trial's torques [N m].
        before: Torque before the first sample [N m].
    """
    steps, states = trial.by_torque.shape
    result = Change(np.empty(steps), np.empty((steps, states + 1)), np.empty(steps))
    if states == 4:
        _solve(5, trial, weights, Torques(torque, limit, before), result)  # a literal: loops are unrolled
    else:
        _solve(states + 1, trial, weights, Torques(torque, limit, before), result)
    return result


@compiled
def _solve(size: int, trial: Trial, weights: Weights, torques: Torques, result: Change) -> None:
    """Write the law, backwards; `size` counts the states of the arm and the last change."""
    states, to_go, sample, (torque, limit, before) = size - 1, no_cost(size), empty_sample(size), torques
    for k in range(len(torque) - 1, -1, -1):
        for i in range(states):
            sample.by_input[i] = trial.by_torque[k, i]
            for j in range(states):
                sample.transition[i, j] = trial.transition[k, i, j]
        sample.errors[:], sample.weights[:], sample.of_state[:] = trial.errors[k], weights.errors[k], trial.of_state[k]
        jump = torque[k] - (torque[k - 1] if k > 0 else before)
        prices = Prices(weights.effort, weights.smoothness[k], jump, -limit - torque[k], limit - torque[k])
        result.change[k] = sample_change(size, sample, prices, to_go, result.gain[k])
        result.curvature[k] = sample.slope[size + 1]


@compiled
def followed(trial: Trial, change: Floats, gain: Floats) -> Floats:
    """Return v [N m] of shape (T,) by the law v[k] = change[k] - gain[k] z_k on the linear problem, from dx_0 = 0."""
    steps, states = trial.by_torque.shape
    changes, away, following, last = np.empty(steps), np.zeros(states), np.empty(states), 0.0
    for k in range(steps):
        last = changes[k] = followed_change(states, change[k], gain[k], away, last)
        deviate(states, trial.transition[k], trial.by_torque[k], away, last, following)
        away[:] = following
    return changes


def _tip_errors(states: Floats, task: Floats, row: Floats) -> tuple[Floats, Floats]:
    """Errors of the tip, shape (T, 4), and their derivatives by the state, shape (T, 4, 4)."""
    plant, drive, of_state = plant_of(row), real_drive_of(row), np.empty((len(states), 4, 4))
    for j, move in enumerate(np.diag(_MOVES)):
        there, back = (tip_errors(states + sign * move, task, plant, drive) for sign in (1.0, -1.0))
        of_state[:, :, j] = (there - back) / (2 * _MOVES[j])
    return tip_errors(states, task, plant, drive), of_state


class Linearisation:
    """Linearisation of trials of arms that are nominally `params`.

    Args:
        params: Constants near those of the arms.
        steps: Most samples T of a trial.
    """

    def __init__(self, params: ArmParams, steps: int) -> None:
        self._simulation = ArmSimulation(params, (2 * (X + 1 + DRIVE_STATES) + 1) * steps)

    def about(self, states: Floats, torques: Floats, task: Floats, row: Floats) -> Trial:
        """Linear problem about the motion of one arm.

        Args:
            states: As `ArmSimulation` has them, before each sample, shape (T, n).
            torques: Commanded over each sample [N m], shape (T,).
            task: Reference angle [rad] and speed [rad/s] of the joint after each sample, shape (T, 2).
            row: Constants of the arm, columns as `ArmParams`, shape (len(FIELDS),).
        """
        count, size = states.shape
        moves = np.append(_MOVES, np.full(size + 1 - X, _TORQUE_MOVE))
        if size > X:
            moves[size - 1] = _DEFLECTION_MOVE
        copies = 2 * len(moves) + 1
        inputs = np.repeat(np.column_stack([states, torques])[:, None], copies, axis=1)
        for j, move in enumerate(moves):
            inputs[:, 2 * j + 1, j] += move
            inputs[:, 2 * j + 2, j] -= move
        at = np.repeat(np.arange(count, dtype=np.float64), copies)
        rows = np.repeat(row[None], copies * count, axis=0)
        rows[:, COLUMN.torque_limit] *= 2  # so that commands at the limit have neighbours on both sides
        self._simulation.set_table(rows, at)
        ends = self._simulation.advance(inputs[:, :, :size].reshape(-1, size), inputs[:, :, size].ravel())
        ends = ends.reshape(count, copies, size)
        slopes = (ends[:, 1::2] - ends[:, 2::2]) / (2 * moves[:, None])
        if size > X:  # a motor that slides has no deflection: `SLIPS` stands for that
            slopes[np.abs(states[:, -1]) >= SLIPS, -2] = 0.0
            slopes[(np.abs(ends[:, :, -1]) >= SLIPS).any(axis=1), :, -1] = 0.0
        errors, of_state = _tip_errors(ends[:, 0, :X].copy(), np.ascontiguousarray(task), row)
        transition = np.ascontiguousarray(slopes[:, :size].swapaxes(1, 2))
        return Trial(transition, np.ascontiguousarray(slopes[:, size]), errors, of_state)


@compiled
def norm_weights(
    errors: Floats, torque_change: Floats, limit: float, effort: float, soft: tuple[float, float]
) -> Weights:
    """Weights that give squares the slope of the benchmark's cost, sum |e_p| / 10 mm + |e_v| / 200 mm/s + 0.1 |u|.

    Args:
        errors: Position [m] and velocity [m/s], two of each, shape (T, 4).
        torque_change: From sample to sample [N m], shape (T,).
        limit: Torque limit [N m].
        effort: R [1/(N m)^2].
        soft: Below these the norms over their scale, and the torque's change over its limit, count as these.
    """
    weights = Weights(np.empty((len(errors), 4)), np.empty(len(errors)), effort)
    for k in range(len(errors)):
        weigh_norms(errors[k], soft[0], weights.errors[k])
        weights.smoothness[k] = weigh_jump(torque_change[k], limit, soft[1])
    return weights
