"""Linear-quadratic tracking with limits on one input: a Riccati recursion inside a primal-dual active set.

    min  sum_k  R v_k^2 + z_(k+1)'W_k z_(k+1)  +  (z_N - t)'P (z_N - t)
    s.t. z_(k+1) = F_k z_k + g_k v_k + h_k,    low_k <= u_k <= high_k

The input v is the change of a held quantity u (here torque), which is the last state: g is F's last column, and
u_k = v_k + the last entry of z_k.

Without limits, dynamic programming gives the minimum in one backward recursion (Bertsekas, *Dynamic Programming and
Optimal Control*, vol. 1, sec. 4.1): with the cost-to-go z'S z + 2 s'z, W added to S, and y = S h + s,

    c = R + g'S g,   v = -(g'S F z + g'y) / c.

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

from beltarm_env.jit import compiled, inlined

Floats = NDArray[np.float64]

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
    gain: Floats  # v = gain z + constant    (N, 5)
    constant: Floats  # (N,)
    slope: Floats  # half the cost's slope in v is slope[:5] z + slope[5] + slope[6] v    (N, 7)


@inlined
def empty_problem(steps: int) -> Problem:
    """Room for one problem."""
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
def _choose(p: Problem, k: int, change_weight: float, s: Floats, sf: Floats, y: Floats) -> None:
    """The law for v at step k, from S, S F and y."""
    curvature, slope = change_weight, 0.0
    for i in range(SIZE):
        slope += p.transition[k, i, 4] * y[i]
        for j in range(SIZE):
            curvature += p.transition[k, i, 4] * s[i, j] * p.transition[k, j, 4]
    for j in range(SIZE):
        p.slope[k, j] = 0.0
        for i in range(SIZE):
            p.slope[k, j] += p.transition[k, i, 4] * sf[i, j]
    p.slope[k, 5], p.slope[k, 6] = slope, curvature
    free = p.fixed[k] == 0
    for j in range(SIZE):
        p.gain[k, j] = -p.slope[k, j] / curvature if free else (-1.0 if j == SIZE - 1 else 0.0)
    p.constant[k] = -slope / curvature if free else (p.high[k] if p.fixed[k] > 0 else p.low[k])


@inlined
def _go_back(p: Problem, k: int, s: Floats, s1: Floats, sf: Floats, y: Floats) -> None:
    """The cost-to-go before step k, under its law for v."""
    slope, curvature, constant = p.slope[k, 5], p.slope[k, 6], p.constant[k]
    for i in range(SIZE):
        s1[i] = p.slope[k, i] * constant + p.gain[k, i] * (slope + curvature * constant)
        for j in range(SIZE):
            s1[i] += p.transition[k, j, i] * y[j]
            s[i, j] = p.gain[k, i] * p.slope[k, j] + p.slope[k, i] * p.gain[k, j]
            s[i, j] += curvature * p.gain[k, i] * p.gain[k, j]
            for m in range(SIZE):
                s[i, j] += p.transition[k, m, i] * sf[m, j]


@compiled
def _backward(p: Problem, change_weight: float) -> None:
    """Riccati recursion: the laws for v at all steps."""
    s, s1, sf, y = np.empty((SIZE, SIZE)), np.empty(SIZE), np.empty((SIZE, SIZE)), np.empty(SIZE)
    for i in range(SIZE):
        s1[i] = 0.0
        for j in range(SIZE):
            s[i, j] = p.final[i, j]
            s1[i] -= p.final[i, j] * p.target[j]
    for k in range(len(p.constant) - 1, -1, -1):
        for i in range(SIZE):
            y[i] = s1[i]
            for j in range(SIZE):
                s[i, j] += p.weight[k, i, j]
                y[i] += s[i, j] * p.offset[k, j]
        for i in range(SIZE):
            for j in range(SIZE):
                sf[i, j] = 0.0
                for m in range(SIZE):
                    sf[i, j] += s[i, m] * p.transition[k, m, j]
        _choose(p, k, change_weight, s, sf, y)
        _go_back(p, k, s, s1, sf, y)


@inlined
def _wanted(p: Problem, k: int, u: float, slope: float) -> int:
    """At which limit u_k should be fixed, given the cost's slope in v."""
    if p.fixed[k] == 0:
        return 1 if u > p.high[k] else (-1 if u < p.low[k] else 0)
    return int(p.fixed[k]) if p.fixed[k] * slope <= 0.0 else 0


@compiled
def _forward(p: Problem, first: Floats, u: Floats) -> int:
    """Follow the laws from z = first; write u, update which are fixed, and return how many of these changed."""
    changed = 0
    z, after = first.copy(), np.empty(SIZE)
    for k in range(len(u)):
        v, slope = p.constant[k], p.slope[k, 5]
        for j in range(SIZE):
            v += p.gain[k, j] * z[j]
            slope += p.slope[k, j] * z[j]
        u[k] = z[SIZE - 1] + v
        wanted = _wanted(p, k, u[k], slope + p.slope[k, 6] * v)
        changed += 1 if wanted != p.fixed[k] else 0
        p.fixed[k] = wanted
        for i in range(SIZE):
            after[i] = p.offset[k, i] + p.transition[k, i, 4] * v
            for j in range(SIZE):
                after[i] += p.transition[k, i, j] * z[j]
        for i in range(SIZE):
            z[i] = after[i]
    return changed


@compiled
def minimise(p: Problem, change_weight: float, first: Floats, u: Floats) -> int:
    """Write the u that minimise the cost from z = `first`, and return how many rounds it took."""
    for k in range(len(u)):
        p.fixed[k] = 0
    for rounds in range(1, MOST_ROUNDS + 1):
        _backward(p, change_weight)
        if _forward(p, first, u) == 0:
            return rounds
    return MOST_ROUNDS + 1
