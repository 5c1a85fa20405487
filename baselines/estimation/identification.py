"""Identification of arms, of their drives and of their encoders: beliefs about a batch of arms.

How it is done is in `baselines.estimation.identify`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np

from baselines.estimation.accelerometer import AXES, unfiltered
from baselines.estimation.believed_arm import ARMS, DELAY, LOGS
from baselines.estimation.filter_design import Room, Tracks, filter_design, inputs_of, rooms_for
from baselines.estimation.identify import (
    Estimate,
    Notes,
    begin,
    empty_estimate,
    empty_notes,
    estimate_all,
    identify_all,
)
from baselines.estimation.simulation_lanes import Simulation, write_believed
from baselines.estimation.uncertainty import Uncertainty
from baselines.reading import Reading
from beltarm_env import ArmParams
from beltarm_env.arm import FIELDS
from beltarm_env.arrays import Flags, Floats, Integers
from beltarm_env.engine import in_threads
from beltarm_env.engine.blocks import none_taken, usual_threads

Memory = TypeVar("Memory")


@dataclass(frozen=True)
class Belief:
    """Current estimate of n arms, their drives and their encoders."""

    tracks: Tracks = field(repr=False)  # the filters
    count: Floats = field(repr=False)  # the encoder's resolution [rad], shape (n,); 0 before it has moved
    angle: Floats = field(repr=False)  # last measured [rad], shape (n,)
    commands: Floats = field(repr=False)  # the last ones, latest first [N m], shape (n, HISTORY)
    deflection: Floats = field(repr=False)  # of the motors, see `Notes` [rad], shape (n,)
    acceleration: Floats | None = field(default=None, repr=False)  # last readings [m/s^2], shape (n, 2), where measured

    @property
    def notes(self) -> Notes:
        """The same as kernels read it."""
        return Notes(self.tracks, self.count, self.angle, self.commands, self.deflection)

    @property
    def state(self) -> Floats:
        """Estimated x, shape (n, 4)."""
        return self.tracks.mean[:, :4].copy()

    @property
    def logs(self) -> Floats:
        """Logarithm of each of IDENTIFIED over its nominal value, shape (n, 6)."""
        return self.tracks.mean[:, LOGS].copy()

    @property
    def delay(self) -> Floats:
        """Delay from command to measurement [samples], shape (n,)."""
        return self.tracks.mean[:, DELAY].copy()

    @property
    def covariance(self) -> Floats:
        """Covariance of z, shape (n, SIZE, SIZE)."""
        return self.tracks.covariance

    @property
    def variance(self) -> Floats:
        """Diagonals of `covariance`, shape (n, SIZE)."""
        return self.tracks.covariance.diagonal(axis1=1, axis2=2)


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
        accelerometer: Whether there is an accelerometer on the arm's end, whose readings are used.
    """

    def __init__(self, params: ArmParams, uncertainty: Uncertainty | None = None, accelerometer: bool = False) -> None:
        self.params = params
        self.uncertainty = uncertainty or Uncertainty()
        self.design = filter_design(params, self.uncertainty, accelerometer)
        self._accelerometer = accelerometer
        self._rooms: Room | None = None  # of the threads so far

    def table(self, belief: Belief) -> Floats:
        """Estimated constants of the arms, columns as `ArmParams`, shape (n, len(FIELDS))."""
        table = np.empty((len(belief.count), len(FIELDS)))
        rooms, _ = self._shared(1)
        room = Simulation(*(part[0] for part in rooms.simulation))
        write_believed(belief.tracks.mean, self.design.nominal, room, table)
        return table

    def update(self, belief: Belief | None, reading: Reading, begins: Flags) -> Belief:
        """Bring the belief up to this sample.

        Args:
            belief: That of the last sample; None at the beginning.
            reading: Measurements, and the torque commanded at the last sample.
            begins: Which arms begin an episode, at rest where their encoder is, with nothing known; shape (n,). Of
                others what is known lasts, but for a part that is picked or placed where the reading begins a move.
        """
        count, size = len(begins), len(self.design.mean)
        inputs, acceleration = inputs_of(reading, begins), None
        notes = empty_notes(count, size, AXES if self._accelerometer else 0)
        if self._accelerometer:
            acceleration = reading.acceleration
            assert acceleration is not None, "decoded with the acceleration, see `sensors`"
            before = belief.acceleration if belief is not None else None
            readings, variance = unfiltered(acceleration, acceleration if before is None else before)
            inputs = inputs._replace(
                acceleration=np.ascontiguousarray(readings.T), acceleration_variance=np.ascontiguousarray(variance.T)
            )
        if belief is None:
            inputs = inputs._replace(begins=np.ones(count, np.bool_))
        last = notes if belief is None else belief.notes
        rooms, taken = self._shared(count)
        in_threads(identify_all, len(taken), self.design, inputs, last, notes, taken, rooms)
        tracks = notes.tracks
        if self._accelerometer:
            covariance = np.ascontiguousarray(tracks.covariance[:, :size, :size])
            tracks = tracks._replace(mean=tracks.mean[:, :size].copy(), covariance=covariance)
        return Belief(tracks, *notes[1:], acceleration)

    def reset(self, belief: Belief, reading: Reading, begins: Flags) -> Belief:
        """Reset the belief about arms that begin an episode at a reading, shape (n,)."""
        if not begins.any():
            return belief
        tracks = Tracks._make(part.copy() for part in belief.tracks)
        notes = Notes(tracks, *(part.copy() for part in belief.notes[1:]))
        begin(self.design, inputs_of(reading, begins), notes)
        return Belief(*notes, belief.acceleration)

    def estimate(self, belief: Belief) -> Estimate:
        """Estimates that follow from a belief."""
        result = empty_estimate(len(belief.count))
        rooms, taken = self._shared(len(belief.count))
        in_threads(estimate_all, len(taken), self.design, belief.notes, result, taken, rooms)
        return result

    def _shared(self, count: int) -> tuple[Room, Integers]:
        """Return room for the threads that work for a number of arms, and what they have taken: nothing."""
        threads = usual_threads(count // ARMS)
        if self._rooms is None or len(self._rooms.resolution) < threads:
            self._rooms = rooms_for(threads, self._accelerometer)
        return self._rooms, none_taken(threads)
