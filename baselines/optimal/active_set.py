"""Linear-quadratic tracking with limits on one input: a Riccati recursion inside a primal-dual active set.

    min  sum_k  R v_k^2 + z_(k+1)'W_k z_(k+1)  +  (z_N - t)'P (z_N - t)
    s.t. z_(k+1) = F_k z_k + g_k v_k + h_k,    low_k <= u_k <= high_k

The input v is the change of a held quantity u (here torque), which is the last state: g is F's last column, and
u_k = v_k + the last entry of z_k.

Without limits, dynamic programming gives the minimum in one backward recursion (`baselines.planning.riccati`).

Limits: a u beyond its limit is fixed there, v = limit - u_last, which is a linear law as well, and the recursion is
repeated; a fixed one is freed again once the cost falls towards the inside (Hintermueller, Ito, Kunisch, SIAM J. Optim.
13, 2002). When nothing changes any more, the result is the exact minimum. With the arm's limit of 0.3 N m that took at
most 5 rounds on arms of the training ranges. The method may cycle: with a limit of 0.1 N m, too low for many moves, 4 %
of the samples ended without the minimum, with the last plan, of which the caller cuts the first torque.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.planning.riccati import PricedStep, free_input, no_cost, slope_in_input, step_back
from beltarm_env.arrays import Floats
from beltarm_env.engine import compiled, inlined

SIZE = 5
"""Entries of z."""
MOST_ROUNDS = 12


class Problem(NamedTuple):
    """One problem over N steps, and room for its solution."""

    transition: Floats  # F    (N, 5, 5)
    offset: Floats  # h    (N, 5)
    weight: Floats  # W    (N, 5, 5)
    final: Floats  # P    (5, 5)
    target: Floats  # t    (5,)
    low: Floats  # (N,)
    high: Floats  # (N,)
    fixed: NDArray[np.int8]  # -1, +1: u is at its lower, upper limit    (N,)
    gain: Floats  # v = constant - gain z    (N, 5)
    constant: Floats  # (N,)
    slope: Floats  # half the cost's slope in v is slope[:5] z + slope[5] + slope[6] v    (N, 7)


@compiled
def empty_problem(steps: int) -> Problem:
    """Unset problem over a number of steps."""
    return Problem(
        np.empty((steps, SIZE, SIZE)),
        np.empty((steps, SIZE)),
        np.empty((steps, SIZE, SIZE)),
        np.empty((SIZE, SIZE)),
        np.empty(SIZE),
        np.empty(steps),
        np.empty(steps),
        np.empty(steps, np.int8),
        np.empty((steps, SIZE)),
        np.empty(steps),
        np.empty((steps, SIZE + 2)),
    )


@inlined
def _choose(p: Problem, k: int) -> None:
    """Choose the law for v at step k: the optimum, or the limit at which u is fixed."""
    if p.fixed[k] == 0:
        p.constant[k] = free_input(SIZE, p.slope[k], p.gain[k])
    else:
        p.gain[k] = 0.0
        p.gain[k, SIZE - 1] = 1.0
        p.constant[k] = p.high[k] if p.fixed[k] > 0 else p.low[k]


@compiled
def _backward(p: Problem, change_weight: float) -> None:
    """Compute the laws for v at all steps."""
    to_go, by_input = no_cost(SIZE), np.empty(SIZE)
    for i in range(SIZE):
        for j in range(SIZE):
            to_go.matrix[i, j] = p.final[i, j]
            to_go.vector[i] -= p.final[i, j] * p.target[j]
    for k in range(len(p.constant) - 1, -1, -1):
        for i in range(SIZE):
            by_input[i] = p.transition[k, i, SIZE - 1]
            for j in range(SIZE):
                to_go.matrix[i, j] += p.weight[k, i, j]
        step = PricedStep(p.transition[k], by_input, p.offset[k], change_weight, 0.0)
        slope_in_input(SIZE, to_go, step, p.slope[k])
        _choose(p, k)
        step_back(SIZE, to_go, p.transition[k], p.slope[k], p.gain[k], p.constant[k])


@inlined
def _wanted(p: Problem, k: int, u: float, slope: float) -> int:
    """Limit at which to fix u_k, -1 or +1, or 0 for none, given the cost's slope in v."""
    if p.fixed[k] == 0:
        return 1 if u > p.high[k] else (-1 if u < p.low[k] else 0)
    return int(p.fixed[k]) if p.fixed[k] * slope <= 0.0 else 0


@compiled
def _forward(p: Problem, first: Floats, u: Floats) -> int:
    """Simulate the laws from z = first: write u, update which are fixed, and return the number of changes."""
    changed = 0
    z, after = first.copy(), np.empty(SIZE)
    for k in range(len(u)):
        v, slope = p.constant[k], p.slope[k, SIZE]
        for j in range(SIZE):
            v -= p.gain[k, j] * z[j]
            slope += p.slope[k, j] * z[j]
        u[k] = z[SIZE - 1] + v
        wanted = _wanted(p, k, u[k], slope + p.slope[k, SIZE + 1] * v)
        changed += 1 if wanted != p.fixed[k] else 0
        p.fixed[k] = wanted
        for i in range(SIZE):
            after[i] = p.offset[k, i] + p.transition[k, i, SIZE - 1] * v
            for j in range(SIZE):
                after[i] += p.transition[k, i, j] * z[j]
        z[:] = after
    return changed


@compiled
def minimise(p: Problem, change_weight: float, first: Floats, u: Floats) -> int:
    """Write the inputs u that minimise the cost from z = `first`, and return the number of rounds."""
    p.fixed[:] = 0
    for rounds in range(1, MOST_ROUNDS + 1):
        _backward(p, change_weight)
        if _forward(p, first, u) == 0:
            return rounds
    return MOST_ROUNDS + 1
