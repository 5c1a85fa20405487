"""Stability margins of loops, from their poles alone.

With the open poles p, those of arm and law, and the closed poles q,

    1 + L(z) = prod (z - q_i) / prod (z - p_i),

for the arm answers no command at once. So the response needs no matrices, and is known where it changes fast: near the
frequencies of lightly damped poles. On z = exp(i w T) are found

    gain margins    factors on L, up and down, at which it becomes unstable
    phase margin    least |phase of L from 180 degrees| where |L| = 1
    delay margin    least (phase of -L, within 0 and 2 pi) / (w T) over all w where |L| = 1 [samples]: the delay beyond
                    what is in the loop already, of the encoder or of the drive, that the loop bears
    modulus margin  1 / max |S| = min |1 + L|, the distance of the Nyquist curve to -1

python-control takes 20 to 100 ms for a loop, this 0.3 ms, and a tuning looks at 460 for each proposal. Of 130 loops its
`disk_margins` misses the modulus margin by up to 26 %, its `stability_margins` the phase margin of 12 % by over 1 %.

A delay of whole samples turns L by exactly w T each. One of parts of a sample does so but for what holding the command
adds near w = pi / T, of which nothing is left at the frequencies where |L| = 1.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.optimize.elementwise import find_minimum, find_root

from baselines.loops.models import Loop, Poles, poles_of
from beltarm_env import CONTROL_PERIOD
from beltarm_env.arrays import Flags, Floats, Integers

_TURNS = np.append(np.geomspace(0.05 * CONTROL_PERIOD, 0.9999 * np.pi, 300), np.pi)
"""Frequencies w T at which every loop is looked at [rad]."""
_BESIDE = np.sinh(np.linspace(-5.0, 5.0, 25)) / 8
"""Places around each pole, in distances to the unit circle: 0.05 apart at its frequency, up to 9 away."""
_INTEGRATES = 1e-6  # distance of an open pole to z = 1 below which L is infinite there


class Margins(NamedTuple):
    """Stability margins of n loops, each of shape (n,); those of an unstable one are not a number."""

    stable: Flags
    gain_up: Floats  # factor above 1, infinite if there is none
    gain_down: Floats  # factor below 1, 0 if there is none
    phase: Floats  # [degrees]
    delay: Floats  # [samples]
    modulus: Floats


def margins(*loops: Loop) -> Margins:
    """Margins of loops."""
    return margins_from_poles(*poles_of(loops))


def margins_from_poles(open_z: Poles, closed_z: Poles) -> Margins:
    """Margins of n loops with these poles z before and after closing, each of shape (n, m)."""
    count = len(open_z)
    opened, closed, every = open_z.T, closed_z.T, np.arange(count)

    def one_plus_loop(turns: Floats, loops: Integers) -> Poles:
        """1 + L at w T = turns; the product goes pole by pole, so that it neither over- nor underflows."""
        z = np.exp(1j * turns)
        total = np.ones_like(z)
        with np.errstate(divide="ignore", invalid="ignore"):
            for p, q in zip(opened, closed, strict=True):
                total *= (z - q[loops]) / (z - p[loops])
        return np.where(np.isnan(total), np.inf, total)  # where a pole lies on the circle

    turns = _grid(open_z, closed_z)
    distances = one_plus_loop(turns, every[:, None])

    def crossings(beyond: Callable[[Poles], Floats]) -> tuple[Integers, Floats, Poles]:
        """Loops, w T below pi, and 1 + L where a function of it changes its sign."""
        signs = np.sign(beyond(distances))
        loops, k = np.nonzero((signs[:, :-1] * signs[:, 1:] < 0) & (turns[:, 1:] < np.pi))  # at pi L is real
        bracket = turns[loops, k], turns[loops, k + 1]
        at = find_root(lambda turn, loop: beyond(one_plus_loop(turn, loop)), bracket, args=(loops,)).x
        return loops, at, one_plus_loop(at, loops)

    loops, at, value = crossings(lambda distance: np.abs(distance - 1) - 1)  # where |L| = 1
    lags = np.angle(1 - value)
    phase, delay = np.full(count, np.pi), np.full(count, np.inf)
    np.minimum.at(phase, loops, np.abs(lags))
    np.minimum.at(delay, loops, lags % (2 * np.pi) / at)

    loops, _, value = crossings(lambda distance: distance.imag)  # where L is real; it is at 0 and pi, too
    finite = np.flatnonzero(np.abs(open_z - 1).min(axis=1) > _INTEGRATES)
    ends = one_plus_loop(np.full(count, np.pi), every), one_plus_loop(np.zeros(len(finite)), finite)
    loops = np.concatenate([loops, every, finite])
    with np.errstate(divide="ignore"):
        factors = -1 / (np.concatenate([value, *ends]).real - 1)
    up, down = np.full(count, np.inf), np.zeros(count)
    np.minimum.at(up, loops, np.where(factors > 1, factors, np.inf))
    np.maximum.at(down, loops, np.where(factors < 1, factors, 0.0))

    least = np.abs(distances).argmin(axis=1)
    bracket = tuple(turns[every, np.clip(least + step, 0, turns.shape[1] - 1)] for step in (-1, 0, 1))
    with np.errstate(invalid="ignore"):  # at an end of the grid there is no bracket
        found = find_minimum(lambda turn, loop: np.abs(one_plus_loop(turn, loop)), bracket, args=(every,))
    modulus = np.fmin(np.abs(distances[every, least]), found.f_x)
    stable = np.abs(closed_z).max(axis=1) < 1
    return Margins(stable, *(np.where(stable, each, np.nan) for each in (up, down, np.degrees(phase), delay, modulus)))


def _grid(open_z: Poles, closed_z: Poles) -> Floats:
    """Frequencies w T of n loops in rising order, many near the poles, and pi as often as it takes; shape (n, k)."""
    poles = np.concatenate([open_z, closed_z], axis=1)
    turn, away = np.angle(poles), np.abs(1 - np.abs(poles))
    # Not of real poles, of the other one of a pair, nor of those so well damped that the response is smooth.
    looked_at = (turn > 0) & (away <= 0.3 * turn)
    near = (turn[..., None] + _BESIDE * away[..., None]).reshape(len(poles), -1)
    within = np.repeat(looked_at, len(_BESIDE), axis=1) & (near > _TURNS[0]) & (near < _TURNS[-2])
    everywhere = np.broadcast_to(_TURNS, (len(poles), len(_TURNS)))
    turns = np.sort(np.hstack([everywhere, np.where(within, near, np.pi)]))
    return turns[:, : len(_TURNS) + within.sum(axis=1).max()]
