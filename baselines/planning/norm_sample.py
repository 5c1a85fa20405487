"""One sample of the problem of `baselines.planning.norm_optimal`: weights, one step backwards, and one forwards."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from baselines.planning.riccati import CostToGo, free_input, slope_in_input, step_back
from beltarm_env.arrays import Floats
from beltarm_env.engine import compiled, inlined
from beltarm_env.task.cost import POSITION_SCALE, TORQUE_RATE_WEIGHT, VELOCITY_SCALE


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
    """Go back by one sample: write the gain K of the optimal change, and return its constant c [N m].

    Args:
        size: n + 1, a literal.
        sample: Its problem; changed. Half the curvature of the cost to go is the last entry of its slope.
        prices: Of the torque.
        to_go: Cost after the sample; turned into that before it.
        gain: K, shape (n + 1,), written.
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
    slope_in_input(
        size, to_go, sample.transition, sample.by_input, sample.nothing, prices.smoothness, pull, sample.slope
    )
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
