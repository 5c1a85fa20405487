"""Recursive identification of an arm and of its encoder, while it moves.

The arm's constants are found by the extended Kalman filter of `baselines.estimation.arm_ekf`. Two things about the
encoder are found beside it, because a filter that is wrong about them takes them for another arm:

**Its resolution.** All changes of the measured angle are multiples of one count q: their greatest common divisor,
taken while they are small, for a fast motor's tell nothing new. Before the first, the encoder may be a coarse one.

**Its delay.** For each delay d of 0, 1 and 2 samples there is a filter of its own, which believes that what it reads
was measured d samples ago, under the torques of that time (D. T. Magill: Optimal adaptive estimation of sampled
stochastic processes, IEEE TAC 10, 1965). With innovations nu of variance S, the evidence for a delay is

    ln p = -1/2 sum (nu^2 / S + ln S)  (- 4 for a late one),

and a delay is given up where it trails the best by 15. As soon as an arm has set off, that takes a dozen samples;
from then on there is one filter. Its state is that of d samples ago, and the state now is what the arm believed in
makes of the torques since.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from baselines.estimation.arm_ekf import ArmFilter, Doubt, Tracks
from baselines.estimation.observer import QUANTUM
from baselines.reading import Reading
from beltarm_env import ArmParams
from beltarm_env.jit import compiled

Floats = NDArray[np.float64]
Whole = NDArray[np.intp]
Flags = NDArray[np.bool_]

LATEST = 2
"""The longest delay that is thought of, which is the longest that the environment has [samples]."""
COARSEST = 8 * QUANTUM
"""What an encoder's resolution is taken for before it has moved [rad]."""
_LATE = -4.0  # ln of how likely a late encoder is thought at first, over one in time
_HOPELESS = 15.0  # behind in evidence
_TELLING = 16  # counts; among larger changes, the rounding of a float32 observation adds up
_DELAYS = np.arange(LATEST + 1)


@dataclass(frozen=True)
class Belief:
    """What is believed of n arms now."""

    state: Floats  # x, shape (n, 4)
    logs: Floats  # ln of each of IDENTIFIED over its nominal value, shape (n, 6)
    delay: Whole  # of the encoder [samples], shape (n,)
    believed: Whole = field(repr=False)  # which of the filters, for each arm; shape (n,)
    filters: Filters = field(repr=False)
    count: Floats = field(repr=False)  # the encoder's resolution [rad], shape (n,); 0 before it has moved
    angle: Floats = field(repr=False)  # last measured [rad], shape (n,)
    torques: Floats = field(repr=False)  # the last ones, latest first [N m], shape (n, 3)

    @property
    def covariance(self) -> Floats:
        """Of the filter's x and of the logarithms, shape (n, 10, 10)."""
        return np.moveaxis(self.filters.tracks.covariance.take(self.believed, axis=-1), -1, 0)

    @property
    def variance(self) -> Floats:
        """The diagonals of `covariance`, shape (n, 10)."""
        return self.filters.tracks.covariance.diagonal()[self.believed]

    def recalling(self, which: Flags, logs: Floats, covariance: Floats) -> Belief:
        """The same at an episode's beginning, but with constants known from elsewhere.

        Args:
            which: For which arms, shape (n,).
            logs: As `Belief.logs`, shape (n, 6).
            covariance: Of these, shape (n, 6, 6).
        """
        filters = self.filters.recalling(which, logs, covariance)
        return replace(self, filters=filters, logs=filters.tracks.logs[:, self.believed].T)


@dataclass(frozen=True)
class Filters:
    """Filters of n arms, for each arm one for every delay that it may have; by arm and delay, in order."""

    arm: Whole  # shape (m,)
    delay: Whole  # shape (m,)
    tracks: Tracks

    def of(self, rows: Whole) -> Filters:
        """Some of them."""
        return Filters(self.arm[rows], self.delay[rows], self.tracks.of(rows))

    def replaced(self, which: Flags, others: Filters) -> Filters:
        """The same, but those of some arms, shape (n,), replaced by others."""
        arm, delay = (np.concatenate(parts) for parts in ((self.arm, others.arm), (self.delay, others.delay)))
        tracks = Tracks(*(np.concatenate(parts, axis=-1) for parts in zip(self.tracks, others.tracks, strict=True)))
        order = np.argsort(arm, kind="stable")
        stay = np.append(~which[self.arm], np.ones(len(others.arm), np.bool_))
        return Filters(arm, delay, tracks).of(order[stay[order]])

    def recalling(self, which: Flags, logs: Floats, covariance: Floats) -> Filters:
        """The same, but with constants known from elsewhere, see `Belief.recalling`."""
        tracks = self.tracks._replace(logs=self.tracks.logs.copy(), covariance=self.tracks.covariance.copy())
        rows = which[self.arm]
        tracks.logs[:, rows] = logs[self.arm[rows]].T
        tracks.covariance[4:, 4:, rows] = np.moveaxis(covariance[self.arm[rows]], 0, -1)
        return Filters(self.arm, self.delay, tracks)

    def best(self) -> Whole:
        """Which are those with the most evidence, of equals the one with the shorter delay; shape (n,)."""
        return _most_evident(self.arm, self.tracks.evidence)

    def promising(self) -> Filters:
        """Those that may still be right."""
        evidence = self.tracks.evidence
        promising = evidence >= evidence[self.best()][self.arm] - _HOPELESS
        return self if promising.all() else self.of(np.flatnonzero(promising))


@compiled
def _most_evident(arm: Whole, evidence: Floats) -> Whole:
    """For each arm the row with the most evidence, of equals the first; rows are by arm."""
    best = np.empty(arm[-1] + 1, np.intp)
    for row in range(len(arm)):
        first = row == 0 or arm[row] != arm[row - 1]
        if first or evidence[row] > evidence[best[arm[row]]]:
            best[arm[row]] = row
    return best


class ArmIdentifier:
    """The identification of arms that are nominally `params`."""

    def __init__(self, params: ArmParams, doubt: Doubt | None = None) -> None:
        self.params = params
        self.doubt = doubt or Doubt()
        self._filter = ArmFilter(params, self.doubt)

    def table(self, belief: Belief) -> Floats:
        """Constants of the arms as believed, columns as `ArmParams`, shape (n, 12)."""
        return self._filter.table(belief.logs.T).T.copy()

    def update(self, belief: Belief | None, reading: Reading, begins: Flags) -> Belief:
        """Bring the belief up to this sample.

        Args:
            belief: What the last call returned; None at the beginning.
            reading: Measurements, and the torque held since the last sample.
            begins: Which arms begin an episode, at rest where their encoder is, with nothing known; shape (n,).
        """
        angle = reading.motor_angle
        if belief is None:
            return self._unknown(angle)
        count = common_count(belief.count, np.abs(angle - belief.angle))
        torques = np.column_stack([reading.last_torque, belief.torques[:, :-1]])
        filters = self._stepped(belief, angle, np.where(count > 0, np.maximum(count, QUANTUM), COARSEST), torques)
        best = filters.best()
        delay, tracks = filters.delay[best], filters.tracks
        logs = tracks.logs.take(best, axis=1)
        state = self._now(tracks.state.take(best, axis=1), logs, delay, torques)
        stepped = Belief(state.T.copy(), logs.T.copy(), delay, best, filters, count, angle, torques)
        return self.begun(stepped, angle, begins)

    def begun(self, belief: Belief, angle: Floats, begins: Flags) -> Belief:
        """The same, but nothing of arms that begin an episode at rest at these motor angles [rad], shape (n,)."""
        if not begins.any():
            return belief
        filters = belief.filters.replaced(begins, self._begun(np.flatnonzero(begins), angle[begins]))
        best, start = filters.best(), begins[:, None]
        return replace(
            belief,
            state=np.where(start, filters.tracks.state[:, best].T, belief.state),
            logs=np.where(start, 0.0, belief.logs),
            delay=np.where(begins, 0, belief.delay),
            believed=best,
            filters=filters,
            count=np.where(begins, 0.0, belief.count),
            angle=np.where(begins, angle, belief.angle),
            torques=np.where(start, 0.0, belief.torques),
        )

    def _unknown(self, angle: Floats) -> Belief:
        """Of arms at rest at these motor angles, of which nothing is known."""
        filters = self._begun(np.arange(len(angle)), angle)
        best, count, torques = filters.best(), np.zeros(len(angle)), np.zeros((len(angle), LATEST + 1))
        state, logs = filters.tracks.state[:, best].T.copy(), filters.tracks.logs[:, best].T.copy()
        return Belief(state, logs, filters.delay[best], best, filters, count, angle, torques)

    def _begun(self, arms: Whole, angles: Floats) -> Filters:
        """New filters of these arms, at rest at these motor angles, one for each delay."""
        arm, delay = np.repeat(arms, len(_DELAYS)), np.tile(_DELAYS, len(arms))
        tracks = self._filter.begun(np.repeat(angles, len(_DELAYS)), COARSEST)
        return Filters(arm, delay, tracks._replace(evidence=np.where(delay > 0, _LATE, 0.0)))

    def _stepped(self, belief: Belief, angle: Floats, count: Floats, torques: Floats) -> Filters:
        """The filters one sample on, without those that are given up."""
        arm, delay = belief.filters.arm, belief.filters.delay
        tracks = self._filter.stepped(belief.filters.tracks, torques[arm, delay], angle[arm], count[arm])
        return Filters(arm, delay, tracks).promising()

    def _now(self, state: Floats, logs: Floats, delay: Whole, torques: Floats) -> Floats:
        """States now, from states as old as the delay, by the torques since; shape (4, n)."""
        for age in range(int(delay.max()), 0, -1):
            late = np.flatnonzero(delay >= age)
            old, believed = state.take(late, axis=1), logs.take(late, axis=1)
            state[:, late] = self._filter.ahead(old, believed, torques[late, age - 1])
        return state


@compiled
def common_count(count: Floats, change: Floats) -> Floats:
    """Greatest common divisor of an encoder's changes, by Euclid, for numbers that are rounded.

    Args:
        count: Of the changes up to now [rad], shape (n,); 0 before the first.
        change: The latest, without sign [rad], shape (n,).
    """
    result = count.copy()
    for i in range(len(count)):
        if not 0.5 * QUANTUM < change[i] < _TELLING * max(count[i], QUANTUM):
            continue
        larger, smaller = max(count[i], change[i]), min(count[i], change[i])
        while smaller > 0.5 * QUANTUM:
            remainder = larger % smaller
            larger, smaller = smaller, min(remainder, smaller - remainder)
        result[i] = larger
    return result
