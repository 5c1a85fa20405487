"""Identification of arms, of their drives and of their encoders: beliefs about a batch of arms.

How it is done is in `baselines.estimation.identify`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import Generic, TypeVar

import numpy as np

from baselines.estimation.believed_arm import DELAY, LOGS, other_torque, write_believed
from baselines.estimation.felt import AXES, unfiltered
from baselines.estimation.filter_design import Tracks, filter_design
from baselines.estimation.identify import (
    Estimate,
    Inputs,
    Notes,
    Workspace,
    begin,
    empty_estimate,
    empty_notes,
    estimate,
    identify,
    workspace_for,
)
from baselines.estimation.uncertainty import Uncertainty
from baselines.reading import Reading
from beltarm_env import ArmParams
from beltarm_env.arm import FIELDS
from beltarm_env.arrays import Flags, Floats
from beltarm_env.jit import compiled

Memory = TypeVar("Memory")


@compiled
def _write_other_torques(mean: Floats, states: Floats, torques: Floats) -> None:
    for arm in range(len(states)):
        torques[arm] = other_torque(mean, arm, states[arm, 0], states[arm, 1])


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
        self.design = filter_design(params, self.uncertainty, felt)
        self._felt = felt
        self._work = workspace_for(1, felt)

    def table(self, belief: Belief) -> Floats:
        """Estimated constants of the arms, columns as `ArmParams`, shape (n, len(FIELDS))."""
        table = np.empty((len(belief.count), len(FIELDS)))
        write_believed(belief.tracks.mean, self.design.nominal, np.empty(len(self.design.mean)), table)
        return table

    def update(self, belief: Belief | None, reading: Reading, begins: Flags) -> Belief:
        """Bring the belief up to this sample.

        Args:
            belief: That of the last sample; None at the beginning.
            reading: Measurements, and the torque commanded at the last sample.
            begins: Which arms begin an episode, at rest where their encoder is, with nothing known; shape (n,).
        """
        if belief is None:
            begins = np.ones(len(begins), np.bool_)
        notes = self._copied(belief, len(begins), AXES if self._felt else 0)
        work = self._workspace(len(begins))
        felt = reading.acceleration if self._felt else None
        if felt is not None:
            before = felt if belief is None or belief.felt is None else belief.felt
            work.filter.felt[:], work.filter.felt_variance[:] = unfiltered(felt, before)
        identify(self.design, Inputs(reading.motor_angle, reading.last_command, begins), notes, work)
        return self._believed(notes, felt)

    def reset(self, belief: Belief, angle: Floats, begins: Flags) -> Belief:
        """Reset the belief about arms that begin an episode, at rest at motor angles [rad] of shape (n,)."""
        if not begins.any():
            return belief
        notes = self._copied(belief, len(angle), 0)
        begin(self.design, Inputs(angle, angle, begins), notes)
        return self._believed(notes, belief.felt)

    def estimate(self, belief: Belief) -> Estimate:
        """Estimates that follow from a belief."""
        result = empty_estimate(len(belief.count))
        notes = Notes(belief.tracks, belief.count, belief.angle, belief.commands)
        estimate(self.design, notes, self._workspace(len(belief.count)), result)
        return result

    def other_torques(self, belief: Belief, states: Floats) -> Floats:
        """Torque ripple, and all else but friction that acts on the motors [N m], shape (n,).

        Args:
            belief: About n arms.
            states: x at the beginning of the sample that is asked for, shape (n, 4).
        """
        torques = np.empty(len(states))
        _write_other_torques(belief.tracks.mean, states, torques)
        return torques

    def _copied(self, belief: Belief | None, count: int, more: int) -> Notes:
        """What is known of n arms, copied; z with some more entries."""
        size = len(self.design.mean)
        if belief is not None and not more:
            tracks = Tracks(*(part.copy() for part in belief.tracks))
            return Notes(tracks, belief.count.copy(), belief.angle.copy(), belief.commands.copy())
        notes = empty_notes(count, size + more)
        if belief is not None:
            notes.tracks.mean[:size], notes.tracks.covariance[:size, :size] = belief.tracks[:2]
            notes.tracks.surprise[:], notes.tracks.unrest[:] = belief.tracks[2:]
            notes.counts[:], notes.angle[:], notes.commands[:] = belief.count, belief.angle, belief.commands
        return notes

    def _believed(self, notes: Notes, felt: Floats | None) -> Belief:
        """Belief from notes, of z without more entries."""
        tracks, size = notes.tracks, len(self.design.mean)
        if len(tracks.mean) > size:
            tracks = tracks._replace(
                mean=tracks.mean[:size].copy(), covariance=np.ascontiguousarray(tracks.covariance[:size, :size])
            )
        return Belief(tracks, notes.counts, notes.angle, notes.commands, felt)

    def _workspace(self, count: int) -> Workspace:
        if len(self._work.resolution) != count:
            self._work = workspace_for(count, self._felt)
        return self._work
