"""Recursive identification of an arm, of its drive and of its encoder, while it moves.

Everything that is constant about the arm and its drive is found by the extended Kalman filter of
`baselines.estimation.arm_ekf`, the delay between command and measurement included. Beside it, the encoder's resolution
is identified, because a filter that assumes a wrong one mistakes its rounding for another arm: all changes of the
measured angle are multiples of one count q. Their greatest common divisor is taken while they are small, for those of a
fast motor carry no more information. Before the first change, the encoder may be a coarse one.

A command given now acts D samples later. What there is to be controlled is the state at that time, which follows from
the commands given before: `ArmIdentifier.ahead`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import Generic, TypeVar

import numpy as np

from baselines.estimation.arm_ekf import UNFELT, ArmFilter, Tracks, Uncertainty
from baselines.estimation.believed_arm import DELAY, HISTORY, LOGS, believed_table, other_torques, simulated
from baselines.estimation.felt import unfiltered
from baselines.estimation.observer import QUANTUM
from baselines.reading import Reading
from beltarm_env import ArmParams
from beltarm_env.arrays import Flags, Floats
from beltarm_env.jit import compiled

Memory = TypeVar("Memory")

COARSEST = 8 * QUANTUM
"""Assumed resolution of an encoder that has not moved yet [rad]."""
_SMALL = 16  # counts; among larger changes, the rounding of a float32 observation adds up


@dataclass(frozen=True)
class Belief:
    """Current estimate of n arms, their drives and their encoders."""

    tracks: Tracks = field(repr=False)  # the filters
    count: Floats = field(repr=False)  # the encoder's resolution [rad], shape (n,); 0 before it has moved
    angle: Floats = field(repr=False)  # last measured [rad], shape (n,)
    commands: Floats = field(repr=False)  # the last ones, latest first [N m], shape (n, HISTORY)
    felt: Floats | None = field(default=None, repr=False)  # last accelerations [m/s^2], shape (n, 2), where measured

    @property
    def state(self) -> Floats:
        """Estimated x, shape (n, 4)."""
        return self.tracks.mean[:4].T.copy()

    @property
    def logs(self) -> Floats:
        """Logarithm of each of IDENTIFIED over its nominal value, shape (n, 6)."""
        return self.tracks.mean[LOGS].T.copy()

    @property
    def delay(self) -> Floats:
        """Delay from command to measurement [samples], shape (n,)."""
        return self.tracks.mean[DELAY].copy()

    @property
    def constants(self) -> Floats:
        """All of z but the arm's state, shape (n, SIZE - 4)."""
        return self.tracks.mean[4:].T.copy()

    @property
    def covariance(self) -> Floats:
        """Covariance of z, shape (n, SIZE, SIZE)."""
        return np.moveaxis(self.tracks.covariance, -1, 0)

    @property
    def variance(self) -> Floats:
        """Diagonals of `covariance`, shape (n, SIZE)."""
        return self.tracks.covariance.diagonal()

    def with_constants(self, which: Flags, constants: Floats, covariance: Floats) -> Belief:
        """Belief at the beginning of an episode, with the constants of some arms replaced by a prior.

        Args:
            which: Arms with a prior, shape (n,).
            constants: Mean of the prior, as `Belief.constants`, shape (n, SIZE - 4).
            covariance: Of these, shape (n, SIZE - 4, SIZE - 4).
        """
        mean, spread = self.tracks.mean.copy(), self.tracks.covariance.copy()
        mean[4:, which] = constants[which].T
        spread[4:, 4:, which] = np.moveaxis(covariance[which], 0, -1)
        return replace(self, tracks=self.tracks._replace(mean=mean, covariance=spread))


class IdentifyingController(ABC, Generic[Memory]):
    """A controller whose memory holds a belief about its arms."""

    @abstractmethod
    def belief(self, memory: Memory) -> Belief:
        """Belief at the sample that the memory belongs to."""


class ArmIdentifier:
    """Identification of arms that are nominally `params`.

    Args:
        params: The nominal arm.
        uncertainty: What is doubted.
        felt: Whether there is an accelerometer on the arm's end, whose readings are used.
    """

    def __init__(self, params: ArmParams, uncertainty: Uncertainty | None = None, felt: bool = False) -> None:
        self.params = params
        self.uncertainty = uncertainty or Uncertainty()
        self._filter = ArmFilter(params, self.uncertainty, felt)

    def table(self, belief: Belief) -> Floats:
        """Estimated constants of the arms, columns as `ArmParams`, shape (n, len(FIELDS))."""
        return believed_table(belief.tracks.mean, self._filter.nominal)

    def update(self, belief: Belief | None, reading: Reading, begins: Flags) -> Belief:
        """Bring the belief up to this sample.

        Args:
            belief: That of the last sample; None at the beginning.
            reading: Measurements, and the torque commanded at the last sample.
            begins: Which arms begin an episode, at rest where their encoder is, with nothing known; shape (n,).
        """
        angle, felt = reading.motor_angle, reading.acceleration
        if belief is None:
            tracks = self._filter.initial(angle, COARSEST)
            return Belief(tracks, np.zeros(len(angle)), angle, np.zeros((len(angle), HISTORY)), felt)
        count = common_count(belief.count, np.abs(angle - belief.angle))
        commands = np.column_stack([reading.last_command, belief.commands[:, :-1]])
        resolution = np.where(count > 0, np.maximum(count, QUANTUM), COARSEST)
        accelerations = UNFELT if felt is None or belief.felt is None else unfiltered(felt, belief.felt)
        tracks = self._filter.step(belief.tracks, commands, angle, resolution, accelerations)
        return self.reset(Belief(tracks, count, angle, commands, felt), angle, begins)

    def reset(self, belief: Belief, angle: Floats, begins: Flags) -> Belief:
        """Reset the belief about arms that begin an episode, at rest at motor angles [rad] of shape (n,)."""
        if not begins.any():
            return belief
        new = self._filter.initial(angle, COARSEST)
        tracks = Tracks(*(np.where(begins, fresh, old) for fresh, old in zip(new, belief.tracks, strict=True)))
        return Belief(
            tracks,
            np.where(begins, 0.0, belief.count),
            np.where(begins, angle, belief.angle),
            np.where(begins[:, None], 0.0, belief.commands),
            belief.felt,
        )

    def ahead(self, belief: Belief) -> Floats:
        """States at the time at which a command given now acts, shape (n, 4): D samples on, under those given before.

        From sample to sample they are simulated with the last command held, and interpolated in between.
        """
        whole = belief.delay.astype(np.intp)
        part = belief.delay - whole
        z, commands, result = belief.tracks.mean.copy(), belief.commands, belief.state
        for k in range(int(whole.max()) + 1):
            commands = np.column_stack([commands[:, 0], commands[:, :-1]])
            before = z[:4].copy()
            z[:4] = simulated(z, self._filter.nominal, commands, False)[0]
            now = whole == k
            result[now] = (before + part * (z[:4] - before)).T[now]
        return result

    def other_torques(self, belief: Belief, states: Floats) -> Floats:
        """Torque ripple, and all else but friction that acts on the motors [N m], shape (n,).

        Args:
            belief: About n arms.
            states: x at the beginning of the sample that is asked for, shape (n, 4).
        """
        return other_torques(belief.tracks.mean, states)


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
