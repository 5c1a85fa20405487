"""Stability margins of a loop, from its poles alone.

With the open poles p, those of arm and law, and the closed poles q,

    1 + L(z) = prod (z - q_i) / prod (z - p_i),

for the arm answers no command at once. So the response needs no matrices, and is known where it changes fast: near the
frequencies of lightly damped poles. On z = exp(i w T) are found

    gain margins    factors on L, up and down, at which it becomes unstable
    phase margin    least |phase of L from 180 degrees| where |L| = 1
    delay margin    least (phase of -L, within 0 and 2 pi) / (w T) over all w where |L| = 1 [samples]: the delay beyond
                    what is in the loop already, of the encoder or of the drive, that the loop bears
    modulus margin  1 / max |S| = min |1 + L|, the distance of the Nyquist curve to -1

A delay of whole samples turns L by exactly w T each. One of parts of a sample does so but for what holding the command
adds near w = pi / T, of which nothing is left at the frequencies where |L| = 1.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from baselines.loops.models import Loop, Poles, closed_poles, open_poles
from beltarm_env import CONTROL_PERIOD
from beltarm_env.arrays import Flags, Floats, Integers

_TURNS = np.append(np.geomspace(0.05 * CONTROL_PERIOD, 0.9999 * np.pi, 300), np.pi)
"""Frequencies w T at which every loop is looked at [rad]."""
_BESIDE = np.sinh(np.linspace(-5.0, 5.0, 25)) / 8
"""Places around each pole, in distances to the unit circle: 0.05 apart at its frequency, up to 9 away."""
_BISECTIONS = 40
_INTEGRATES = 1e-6  # distance of an open pole to z = 1 below which L is infinite there


class Margins(NamedTuple):
    """Stability margins of n loops, each of shape (n,) or any other; those of an unstable one mean nothing."""

    stable: Flags
    gain_up: Floats  # factor above 1, infinite if there is none
    gain_down: Floats  # factor below 1, 0 if there is none
    phase: Floats  # [degrees]
    delay: Floats  # [samples]
    modulus: Floats


def margins(loop: Loop) -> Margins:
    """Margins of a loop, or of many along its leading axes."""
    return margins_from_poles(open_poles(loop), closed_poles(loop))


def margins_from_poles(open_z: Poles, closed_z: Poles) -> Margins:
    """Margins of loops with these poles z before and after closing, each of shape (..., m)."""
    front, size = open_z.shape[:-1], open_z.shape[-1]
    opened, closed = (poles.reshape(-1, size).T for poles in (open_z, closed_z))
    turns = _grid(opened, closed)
    distances = _one_plus_loop(turns, opened[..., None], closed[..., None])
    up, down = _gain_margins(turns, distances, opened, closed)
    phase, delay = _lags(turns, distances, opened, closed)
    modulus = _least_distance(turns, np.abs(distances), opened, closed)
    columns = up, down, np.degrees(phase), delay, modulus
    return Margins(np.abs(closed_z).max(axis=-1) < 1, *(column.reshape(front) for column in columns))


def _one_plus_loop(turns: Floats, open_z: Poles, closed_z: Poles) -> Poles:
    """1 + L at w T = turns, of poles along the first axis."""
    z = np.exp(1j * turns)
    total = np.ones_like(z)
    for opened, closed in zip(open_z, closed_z, strict=True):
        total *= (z - closed) / (z - opened)
    return total


def _grid(open_z: Poles, closed_z: Poles) -> Floats:
    """Frequencies w T of n loops in rising order, many near the poles, and pi as often as it takes; shape (n, k)."""
    poles = np.concatenate([open_z, closed_z]).T
    turn, away = np.angle(poles), np.abs(1 - np.abs(poles))
    # Not of real poles, of the other one of a pair, nor of those so well damped that the response is smooth.
    looked_at = (turn > 0) & (away <= 0.3 * turn)
    near = (turn[..., None] + _BESIDE * away[..., None]).reshape(len(poles), -1)
    within = np.repeat(looked_at, len(_BESIDE), axis=1) & (near > _TURNS[0]) & (near < _TURNS[-2])
    everywhere = np.broadcast_to(_TURNS, (len(poles), len(_TURNS)))
    turns = np.sort(np.hstack([everywhere, np.where(within, near, np.pi)]))
    return turns[:, : len(_TURNS) + within.sum(axis=1).max()]


def _on_circle(distance: Poles) -> Floats:
    """What changes its sign where L crosses the unit circle."""
    return np.abs(distance - 1) - 1


def _on_axis(distance: Poles) -> Floats:
    """What changes its sign where L crosses the real axis."""
    return distance.imag


def _crossings(
    beyond: Callable[[Poles], Floats], turns: Floats, distances: Poles, open_z: Poles, closed_z: Poles
) -> tuple[Integers, Floats]:
    """Find, by bisection, where the sign of a function of 1 + L changes: loops, and w T below pi."""
    signs = np.sign(beyond(distances))
    loops, k = np.nonzero((signs[:, :-1] * signs[:, 1:] < 0) & (turns[:, 1:] < np.pi))  # at pi L is real
    low, high, start = turns[loops, k], turns[loops, k + 1], signs[loops, k]
    opened, closed = open_z[:, loops], closed_z[:, loops]
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        same = start * beyond(_one_plus_loop(middle, opened, closed)) > 0
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return loops, 0.5 * (low + high)


def _gain_margins(turns: Floats, distances: Poles, open_z: Poles, closed_z: Poles) -> tuple[Floats, Floats]:
    """Gain margins up and down: from where L is real, at 0 and pi too."""
    count = len(turns)
    crossing, at = _crossings(_on_axis, turns, distances, open_z, closed_z)
    finite = np.flatnonzero(np.abs(open_z - 1).min(axis=0) > _INTEGRATES)
    loops = np.concatenate([crossing, np.arange(count), finite])
    places = np.concatenate([at, np.full(count, np.pi), np.zeros(len(finite))])
    with np.errstate(divide="ignore"):
        factors = -1 / (_one_plus_loop(places, open_z[:, loops], closed_z[:, loops]).real - 1)
    up, down = np.full(count, np.inf), np.zeros(count)
    np.minimum.at(up, loops, np.where(factors > 1, factors, np.inf))
    np.maximum.at(down, loops, np.where(factors < 1, factors, 0.0))
    return up, down


def _lags(turns: Floats, distances: Poles, open_z: Poles, closed_z: Poles) -> tuple[Floats, Floats]:
    """Phase margins [rad] and delay margins [samples]."""
    loops, at = _crossings(_on_circle, turns, distances, open_z, closed_z)
    lags = np.angle(1 - _one_plus_loop(at, open_z[:, loops], closed_z[:, loops]))
    phase, delay = np.full(len(turns), np.pi), np.full(len(turns), np.inf)
    np.minimum.at(phase, loops, np.abs(lags))
    np.minimum.at(delay, loops, lags % (2 * np.pi) / at)
    return phase, delay


def _least_distance(turns: Floats, distances: Floats, open_z: Poles, closed_z: Poles) -> Floats:
    """Least |1 + L|: that on the grid, refined by a golden section between its neighbours."""
    loops, least = np.arange(len(turns)), distances.argmin(axis=1)
    low = turns[loops, np.maximum(least - 1, 0)]
    high = turns[loops, np.minimum(least + 1, turns.shape[1] - 1)]
    best, share = distances[loops, least], 0.5 * (np.sqrt(5.0) - 1)
    for _ in range(_BISECTIONS):
        left, right = high - share * (high - low), low + share * (high - low)
        at_left, at_right = (np.abs(_one_plus_loop(place, open_z, closed_z)) for place in (left, right))
        best = np.minimum(best, np.minimum(at_left, at_right))
        low, high = np.where(at_left < at_right, low, left), np.where(at_left < at_right, right, high)
    return best
