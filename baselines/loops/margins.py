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

from typing import NamedTuple

import numpy as np

from baselines.loops.models import Loop, Poles, closed_poles, open_poles
from beltarm_env import CONTROL_PERIOD
from beltarm_env.arrays import Flags, Floats
from beltarm_env.jit import allocating, inlined

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
    found = _margins(np.ascontiguousarray(open_z.reshape(-1, size)), np.ascontiguousarray(closed_z.reshape(-1, size)))
    return Margins(np.abs(closed_z).max(axis=-1) < 1, *(column.reshape(front) for column in found))


@inlined
def _ratio(turn: float, open_z: Poles, closed_z: Poles) -> complex:
    """1 + L at w T = turn."""
    z, total = complex(np.cos(turn), np.sin(turn)), complex(1.0, 0.0)
    for i in range(len(open_z)):
        total *= (z - closed_z[i]) / (z - open_z[i])
    return total


@inlined
def _located(low: float, high: float, open_z: Poles, closed_z: Poles, on_circle: bool) -> float:
    """The w T between two others at which L crosses the unit circle, or the real axis, by bisection."""
    start = _beyond(_ratio(low, open_z, closed_z) - 1, on_circle)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        if start * _beyond(_ratio(middle, open_z, closed_z) - 1, on_circle) > 0:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@inlined
def _beyond(response: complex, on_circle: bool) -> float:
    """What changes its sign where L crosses the unit circle, or the real axis."""
    return abs(response) - 1 if on_circle else response.imag


@inlined
def _tightened(factors: tuple[float, float], real: float) -> tuple[float, float]:
    """Gain margins up and down, as far as L allows that is real somewhere."""
    up, down = factors
    factor = -1 / real
    return (min(up, factor) if factor > 1 else up), (max(down, factor) if 0 < factor < 1 else down)


@allocating
def _grid(open_z: Poles, closed_z: Poles) -> Floats:
    """Frequencies w T in rising order, many near the poles; the last one is pi."""
    near = np.empty(len(_TURNS) + 2 * len(open_z) * len(_BESIDE))
    near[: len(_TURNS)], count = _TURNS, len(_TURNS)
    for poles in (open_z, closed_z):
        for i in range(len(poles)):
            turn, away = np.angle(poles[i]), abs(1 - abs(poles[i]))
            if turn <= 0 or away > 0.3 * turn:
                continue  # real, the other one of a pair, or so well damped that the response is smooth
            for beside in _BESIDE:
                place = turn + beside * away
                if _TURNS[0] < place < _TURNS[-2]:
                    near[count] = place
                    count += 1
    return np.sort(near[:count])


@allocating
def _margins(open_z: Poles, closed_z: Poles) -> Floats:
    """Rows of `Margins` but the first, shape (5, n), of loops with poles of shape (n, m)."""
    result = np.empty((5, len(open_z)))
    for n in range(len(open_z)):
        opened, closed = open_z[n], closed_z[n]
        turns = _grid(opened, closed)
        distances = np.empty(len(turns), np.complex128)
        for i in range(len(turns)):
            distances[i] = _ratio(turns[i], opened, closed)
        phase, delay = np.pi, np.inf
        factors = _tightened((np.inf, 0.0), distances[-1].real - 1)
        if np.abs(opened - 1).min() > _INTEGRATES:
            factors = _tightened(factors, _ratio(0.0, opened, closed).real - 1)
        for i in range(len(turns) - 2):  # up to the last but one: at pi L is real
            before, after = distances[i] - 1, distances[i + 1] - 1
            if _beyond(before, True) * _beyond(after, True) < 0:
                turn = _located(turns[i], turns[i + 1], opened, closed, True)
                lag = np.angle(1 - _ratio(turn, opened, closed))
                phase, delay = min(phase, abs(lag)), min(delay, (lag % (2 * np.pi)) / turn)
            if _beyond(before, False) * _beyond(after, False) < 0:
                turn = _located(turns[i], turns[i + 1], opened, closed, False)
                factors = _tightened(factors, _ratio(turn, opened, closed).real - 1)
        result[0, n], result[1, n] = factors
        result[2, n], result[3, n] = np.degrees(phase), delay
        result[4, n] = _least_distance(turns, np.abs(distances), opened, closed)
    return result


@inlined
def _least_distance(turns: Floats, distances: Floats, open_z: Poles, closed_z: Poles) -> float:
    """Least |1 + L|: that on the grid, refined by a golden section between its neighbours."""
    least = distances.argmin()
    low, high = turns[max(least - 1, 0)], turns[min(least + 1, len(turns) - 1)]
    best, share = distances[least], 0.5 * (np.sqrt(5.0) - 1)
    for _ in range(_BISECTIONS):
        left, right = high - share * (high - low), low + share * (high - low)
        at_left, at_right = abs(_ratio(left, open_z, closed_z)), abs(_ratio(right, open_z, closed_z))
        best = min(best, at_left, at_right)
        if at_left < at_right:
            high = right
        else:
            low = left
    return best
