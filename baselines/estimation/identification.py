"""Recursive identification of an arm and of its encoder, while it moves.

The arm's constants are found by the extended Kalman filter of `baselines.estimation.arm_ekf`. Two properties of the
encoder are identified beside them, because a filter that assumes the wrong ones mistakes them for another arm:

**Its resolution.** All changes of the measured angle are multiples of one count q. Their greatest common divisor is
taken while they are small, for those of a fast motor carry no more information. Before the first change, the encoder
may be a coarse one.

**Its delay.** For each delay d of 0, 1 and 2 samples there is a filter that takes each measurement to be d samples old,
under the torques of that time (multiple-model estimation: D. T. Magill, Optimal adaptive estimation of sampled
stochastic processes, IEEE TAC 10, 1965). With innovations nu of variance S, the log-likelihood of a delay is

    ln p = -1/2 sum (nu^2 / S + ln S)  (- 4 for d > 0, a prior),

and a delay is dropped where it trails the best by 15. As soon as an arm has set off, that takes a dozen samples; from
then on there is one filter. Its state is that of d samples ago; the current one is predicted from it by the torques
since.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import Generic, TypeVar

import numpy as np

from baselines.estimation.arm_ekf import ArmFilter, Tracks, Uncertainty
from baselines.estimation.observer import QUANTUM
from baselines.reading import Reading
from beltarm_env import ArmParams
from beltarm_env.arrays import Flags, Floats, Integers
from beltarm_env.jit import compiled

Memory = TypeVar("Memory")

LATEST = 2
"""Longest delay considered, which is the longest that the environment has [samples]."""
COARSEST = 8 * QUANTUM
"""Assumed resolution of an encoder that has not moved yet [rad]."""
_LATE = -4.0  # prior log-likelihood of a delay, relative to none
_HOPELESS = 15.0  # log-likelihood behind the best at which a delay is dropped
_SMALL = 16  # counts; among larger changes, the rounding of a float32 observation adds up
_DELAYS = np.arange(LATEST + 1)


@dataclass(frozen=True)
class Belief:
    """Current estimate of n arms and their encoders."""

    state: Floats  # x, shape (n, 4)
    logs: Floats  # ln of each of IDENTIFIED over its nominal value, shape (n, 6)
    delay: Integers  # of the encoder [samples], shape (n,)
    believed: Integers = field(repr=False)  # row of the most likely filter of each arm, shape (n,)
    filters: Filters = field(repr=False)
    count: Floats = field(repr=False)  # the encoder's resolution [rad], shape (n,); 0 before it has moved
    angle: Floats = field(repr=False)  # last measured [rad], shape (n,)
    torques: Floats = field(repr=False)  # the last ones, latest first [N m], shape (n, 3)

    @property
    def covariance(self) -> Floats:
        """Covariance of the filter's x and of the logarithms, shape (n, 10, 10)."""
        return np.moveaxis(self.filters.tracks.covariance.take(self.believed, axis=-1), -1, 0)

    @property
    def variance(self) -> Floats:
        """Diagonals of `covariance`, shape (n, 10)."""
        return self.filters.tracks.covariance.diagonal()[self.believed]

    def with_constants(self, which: Flags, logs: Floats, covariance: Floats) -> Belief:
        """Belief at the beginning of an episode, with the constants of some arms replaced by a prior.

        Args:
            which: Arms with a prior, shape (n,).
            logs: Mean of the prior, as `Belief.logs`, shape (n, 6).
            covariance: Of these, shape (n, 6, 6).
        """
        filters = self.filters.with_constants(which, logs, covariance)
        return replace(self, filters=filters, logs=filters.tracks.logs[:, self.believed].T)


class IdentifyingController(ABC, Generic[Memory]):
    """A controller whose memory holds a belief about its arms."""

    @abstractmethod
    def belief(self, memory: Memory) -> Belief:
        """Belief at the sample that the memory belongs to."""


@dataclass(frozen=True)
class Filters:
    """Filters of n arms, one for each delay that an arm may have; sorted by arm, then by delay."""

    arm: Integers  # shape (m,)
    delay: Integers  # shape (m,)
    tracks: Tracks

    def of(self, rows: Integers) -> Filters:
        """Selection of filters."""
        return Filters(self.arm[rows], self.delay[rows], self.tracks.of(rows))

    def replace_arms(self, which: Flags, others: Filters) -> Filters:
        """Filters in which those of some arms, shape (n,), are replaced by others."""
        arm, delay = (np.concatenate(parts) for parts in ((self.arm, others.arm), (self.delay, others.delay)))
        tracks = Tracks(*(np.concatenate(parts, axis=-1) for parts in zip(self.tracks, others.tracks, strict=True)))
        order = np.argsort(arm, kind="stable")
        stay = np.append(~which[self.arm], np.ones(len(others.arm), np.bool_))
        return Filters(arm, delay, tracks).of(order[stay[order]])

    def with_constants(self, which: Flags, logs: Floats, covariance: Floats) -> Filters:
        """Filters with the constants of some arms replaced by a prior, see `Belief.with_constants`."""
        tracks = self.tracks._replace(logs=self.tracks.logs.copy(), covariance=self.tracks.covariance.copy())
        rows = which[self.arm]
        tracks.logs[:, rows] = logs[self.arm[rows]].T
        tracks.covariance[4:, 4:, rows] = np.moveaxis(covariance[self.arm[rows]], 0, -1)
        return Filters(self.arm, self.delay, tracks)

    def best(self) -> Integers:
        """Row of the most likely filter of each arm, of equals the one with the shortest delay; shape (n,)."""
        return _most_likely(self.arm, self.tracks.evidence)

    def prune(self) -> Filters:
        """Filters whose delay may still be right."""
        evidence = self.tracks.evidence
        promising = evidence >= evidence[self.best()][self.arm] - _HOPELESS
        return self if promising.all() else self.of(np.flatnonzero(promising))


@compiled
def _most_likely(arm: Integers, evidence: Floats) -> Integers:
    """Row with the highest log-likelihood for each arm, of equals the first; rows are sorted by arm."""
    best = np.empty(arm[-1] + 1, np.intp)
    for row in range(len(arm)):
        first = row == 0 or arm[row] != arm[row - 1]
        if first or evidence[row] > evidence[best[arm[row]]]:
            best[arm[row]] = row
    return best


class ArmIdentifier:
    """Identification of arms that are nominally `params`."""

    def __init__(self, params: ArmParams, uncertainty: Uncertainty | None = None) -> None:
        self.params = params
        self.uncertainty = uncertainty or Uncertainty()
        self._filter = ArmFilter(params, self.uncertainty)

    def table(self, belief: Belief) -> Floats:
        """Estimated constants of the arms, columns as `ArmParams`, shape (n, len(FIELDS))."""
        return self._filter.table(belief.logs.T).T.copy()

    def update(self, belief: Belief | None, reading: Reading, begins: Flags) -> Belief:
        """Bring the belief up to this sample.

        Args:
            belief: That of the last sample; None at the beginning.
            reading: Measurements, and the torque held since the last sample.
            begins: Which arms begin an episode, at rest where their encoder is, with nothing known; shape (n,).
        """
        angle = reading.motor_angle
        if belief is None:
            return self._prior(angle)
        count = common_count(belief.count, np.abs(angle - belief.angle))
        torques = np.column_stack([reading.last_command, belief.torques[:, :-1]])
        filters = self._step(belief, angle, np.where(count > 0, np.maximum(count, QUANTUM), COARSEST), torques)
        best = filters.best()
        delay, tracks = filters.delay[best], filters.tracks
        logs = tracks.logs.take(best, axis=1)
        state = self._predict_delay(tracks.state.take(best, axis=1), logs, delay, torques)
        updated = Belief(state.T.copy(), logs.T.copy(), delay, best, filters, count, angle, torques)
        return self.reset(updated, angle, begins)

    def reset(self, belief: Belief, angle: Floats, begins: Flags) -> Belief:
        """Reset the belief about arms that begin an episode, at rest at motor angles [rad] of shape (n,)."""
        if not begins.any():
            return belief
        filters = belief.filters.replace_arms(begins, self._initial(np.flatnonzero(begins), angle[begins]))
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

    def _prior(self, angle: Floats) -> Belief:
        """Belief about arms at rest at these motor angles before any other measurement."""
        filters = self._initial(np.arange(len(angle)), angle)
        best, count, torques = filters.best(), np.zeros(len(angle)), np.zeros((len(angle), LATEST + 1))
        state, logs = filters.tracks.state[:, best].T.copy(), filters.tracks.logs[:, best].T.copy()
        return Belief(state, logs, filters.delay[best], best, filters, count, angle, torques)

    def _initial(self, arms: Integers, angles: Floats) -> Filters:
        """Filters of these arms at rest at these motor angles, one for each delay."""
        arm, delay = np.repeat(arms, len(_DELAYS)), np.tile(_DELAYS, len(arms))
        tracks = self._filter.initial(np.repeat(angles, len(_DELAYS)), COARSEST)
        return Filters(arm, delay, tracks._replace(evidence=np.where(delay > 0, _LATE, 0.0)))

    def _step(self, belief: Belief, angle: Floats, count: Floats, torques: Floats) -> Filters:
        """Advance the filters by one sample and drop the hopeless ones."""
        arm, delay = belief.filters.arm, belief.filters.delay
        tracks = self._filter.step(belief.filters.tracks, torques[arm, delay], angle[arm], count[arm])
        return Filters(arm, delay, tracks).prune()

    def _predict_delay(self, state: Floats, logs: Floats, delay: Integers, torques: Floats) -> Floats:
        """Current states, shape (4, n), predicted from those of `delay` samples ago by the torques since."""
        for age in range(int(delay.max()), 0, -1):
            late = np.flatnonzero(delay >= age)
            old, constants = state.take(late, axis=1), logs.take(late, axis=1)
            state[:, late] = self._filter.predict(old, constants, torques[late, age - 1])
        return state


@compiled
def common_count(count: Floats, change: Floats) -> Floats:
    """Greatest common divisor of an encoder's changes, by Euclid's algorithm for rounded numbers.

    Args:
        count: Divisor of the changes so far [rad], shape (n,); 0 before the first.
        change: Magnitude of the latest [rad], shape (n,).
    """
    result = count.copy()
    for i in range(len(count)):
        if not 0.5 * QUANTUM < change[i] < _SMALL * max(count[i], QUANTUM):
            continue
        larger, smaller = max(count[i], change[i]), min(count[i], change[i])
        while smaller > 0.5 * QUANTUM:
            remainder = larger % smaller
            larger, smaller = smaller, min(remainder, smaller - remainder)
        result[i] = larger
    return result
