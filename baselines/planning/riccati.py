"""One step of linear-quadratic dynamic programming, for a single input.

The arm goes from z to z+ = F z + g v + h under the input v [N m], which costs R v^2 + 2 q v, and what comes after costs
z+'S z+ + 2 s'z+. With y = S h + s, half the slope of the whole cost in v is

    g'S F z + (g'y + q) + c v,    c = R + g'S g.

Where v is free it vanishes, v = -K z + k with K = g'S F / c and k = -(g'y + q) / c. Where v is fixed, at a limit say,
K and k are given. Either way the cost before the step is z'S z + 2 s'z with

    S <- F'(S F - S g K) - K'(g'S F - c K),    s <- F'(y + S g k) - K'(g'y + q + c k)

of which the last terms are zero for a free input. (Bertsekas, *Dynamic Programming and Optimal Control*, vol. 1, sec.
4.1; Anderson, Moore: *Optimal Control*, 1990, ch. 4.)

Functions are inlined and take the number of states as a literal, so that their loops are unrolled.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from beltarm_env.arrays import Floats
from beltarm_env.engine import compiled, inlined


class CostToGo(NamedTuple):
    """A cost z'S z + 2 s'z of n states, and room for a step before it."""

    matrix: Floats  # S    (n, n)
    vector: Floats  # s    (n,)
    by_state: Floats  # S F    (n, n)
    by_input: Floats  # S g    (n,)
    by_offset: Floats  # y = S h + s    (n,)


@compiled
def no_cost(size: int) -> CostToGo:
    """Cost-to-go of zero."""
    return CostToGo(np.zeros((size, size)), np.zeros(size), np.empty((size, size)), np.empty(size), np.empty(size))


class PricedStep(NamedTuple):
    """A step z' = F z + g v + h, which costs R v^2 + 2 q v."""

    by_state: Floats  # F    (n, n)
    by_input: Floats  # g    (n,)
    offset: Floats  # h    (n,)
    price: float  # R, of the input
    pull: float  # q, of the input


@inlined
def slope_in_input(size: int, to_go: CostToGo, step: PricedStep, slope: Floats) -> None:
    """Write half the cost's slope in the input, `slope[:n] z + slope[n] + slope[n + 1] v`.

    Args:
        size: n, a literal.
        to_go: Cost after the step; its products with F, g and h are written.
        step: The step.
        slope: Shape (n + 2,), written.
    """
    f, g, h, price, pull = step
    for i in range(size):
        by_input, by_offset = 0.0, to_go.vector[i]
        for j in range(size):
            by_input += to_go.matrix[i, j] * g[j]
            by_offset += to_go.matrix[i, j] * h[j]
            total = 0.0
            for m in range(size):
                total += to_go.matrix[i, m] * f[m, j]
            to_go.by_state[i, j] = total
        to_go.by_input[i], to_go.by_offset[i] = by_input, by_offset
    curvature, constant = price, pull
    for i in range(size):
        curvature += g[i] * to_go.by_input[i]
        constant += g[i] * to_go.by_offset[i]
    for j in range(size):
        total = 0.0
        for i in range(size):
            total += to_go.by_input[i] * f[i, j]
        slope[j] = total
    slope[size], slope[size + 1] = constant, curvature


@inlined
def free_input(size: int, slope: Floats, gain: Floats) -> float:
    """Write the gain K, shape (n,), of the input that costs least, and return its constant k."""
    for j in range(size):
        gain[j] = slope[j] / slope[size + 1]
    return -slope[size] / slope[size + 1]


@inlined
def step_back(size: int, to_go: CostToGo, f: Floats, slope: Floats, gain: Floats, constant: float) -> None:
    """Turn the cost after a step, once `slope_in_input` was there, into that before it; v = -gain z + constant."""
    rest = slope[size] + slope[size + 1] * constant
    for m in range(size):  # what the sums below have in common
        to_go.by_offset[m] += to_go.by_input[m] * constant
        for j in range(size):
            to_go.by_state[m, j] -= to_go.by_input[m] * gain[j]
    for i in range(size):
        total = -gain[i] * rest
        for m in range(size):
            total += f[m, i] * to_go.by_offset[m]
        to_go.vector[i] = total
    for i in range(size):
        for j in range(i + 1):
            total = -gain[i] * (slope[j] - slope[size + 1] * gain[j])
            for m in range(size):
                total += f[m, i] * to_go.by_state[m, j]
            to_go.matrix[i, j] = to_go.matrix[j, i] = total
