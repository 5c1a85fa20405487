"""Identification of arms, of their drives and of their encoders, while they move.

The constants of arm and drive, and the delay between command and measurement, are found by the extended Kalman filter
of `baselines.estimation.arm_ekf`. Beside it, the encoder's resolution is identified, because a filter that assumes a
wrong one mistakes its rounding for another arm: all changes of the measured angle are multiples of one count q. Their
greatest common divisor is taken while they are small, for those of a fast motor carry no more information. Before the
first change, the encoder may be a coarse one.

A command given now acts D samples later. What there is to be controlled is the state at that time, which follows from
the commands given before: `estimate`.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from typing import Any, NamedTuple

import numpy as np

from baselines.estimation.accelerometer import AXES, unfiltered
from baselines.estimation.arm_ekf import begin_track, change_part, correct
from baselines.estimation.believed_arm import ARMS, DELAY, HISTORY, LOGS
from baselines.estimation.believed_motion import Simulation, load, move_on, simulate
from baselines.estimation.filter_design import (
    Design,
    Inputs,
    Room,
    Tracks,
    Uncertainty,
    filter_design,
    inputs_of,
    room_for,
    room_of,
)
from baselines.estimation.observer import QUANTUM
from baselines.reading import Reading, require_shape
from beltarm_env import ArmParams
from beltarm_env.arm import COLUMN, FIELDS
from beltarm_env.arrays import Flags, Floats, Integers
from beltarm_env.engine import compiled, in_threads
from beltarm_env.engine.blocks import none_taken, take_block, usual_threads
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.layout import LANES
from beltarm_env.physics.friction import mode_of_giving
from beltarm_env.physics.models import OWN_MODELS, model_of

COARSEST = 8 * QUANTUM
"""Assumed resolution of an encoder that has not moved yet [rad]."""
_SMALL = 16  # counts; among larger changes, the rounding of a float32 observation adds up


class Belief(NamedTuple):
    """Current estimate of m arms, their drives and their encoders."""

    tracks: Tracks  # the filters
    counts: Floats  # the encoder's resolution [rad], shape (m,); 0 before it has moved
    angle: Floats  # last measured [rad], shape (m,)
    commands: Floats  # the last ones, latest first [N m], shape (m, HISTORY)
    deflection: Floats  # of the motor that sticks [rad], shape (m,); `friction.SLIPS`, in its direction, if it slides
    acceleration: Floats  # last readings [m/s^2], shape (m, AXES); (m, 0) without an accelerometer

    @property
    def state(self) -> Floats:
        """Estimated x, shape (m, 4)."""
        return self.tracks.mean[:, :4].copy()


class Estimate(NamedTuple):
    """What controllers need to know of m arms."""

    states: Floats  # x at the time at which a command given now acts, shape (m, 4)
    delay: Floats  # until then [samples], shape (m,)
    direction: Floats  # friction mode then: -1 or 1 of a motor that slides, 0 of one that sticks, shape (m,)
    logs: Floats  # logarithm of each of IDENTIFIED over its nominal value, shape (m, 6)
    table: Floats  # constants, columns as `ArmParams`, shape (m, len(FIELDS))


def empty_belief(count: int, size: int, axes: int = 0) -> Belief:
    """Room for a belief about `count` arms of which z has `size` entries, and the accelerometer so many axes."""
    width = size + axes
    filters = np.zeros((count, width)), np.zeros((count, width, width)), np.zeros(count), np.zeros(count)
    tracks = Tracks(*filters, np.zeros(count, np.bool_), np.zeros((count, 2)))
    shapes = count, count, (count, HISTORY), count, (count, axes)
    return Belief(tracks, *map(np.zeros, shapes))


def empty_estimate(count: int) -> Estimate:
    """Room for the estimates of `count` arms."""
    shapes = (count, 4), count, count, (count, LOGS.stop - LOGS.start), (count, len(FIELDS))
    return Estimate(*map(np.zeros, shapes))


@compiled
def common_count(count: float, change: float) -> float:
    """Greatest common divisor of an encoder's changes, by Euclid's algorithm for rounded numbers.

    Args:
        count: Divisor of the changes so far [rad]; 0 before the first.
        change: Magnitude of the latest [rad].
    """
    if not 0.5 * QUANTUM < change < _SMALL * max(count, QUANTUM):
        return count
    larger, smaller = max(count, change), min(count, change)
    while smaller > 0.5 * QUANTUM:
        remainder = larger % smaller
        larger, smaller = smaller, min(remainder, smaller - remainder)
    return larger


@compiled
def begin(design: Design, inputs: Inputs, belief: Belief) -> None:
    """Write the belief about arms that begin an episode, at rest with nothing known, and leave others as they are."""
    for arm in range(len(inputs.begins)):
        if inputs.begins[arm]:
            belief.tracks.holds[arm] = inputs.holds[arm]
            begin_track(design, belief.tracks, arm, inputs.angle[arm], COARSEST)
            belief.counts[arm], belief.angle[arm], belief.deflection[arm] = 0.0, inputs.angle[arm], 0.0
            belief.commands[arm, :] = 0.0


@compiled
def _note(design: Design, inputs: Inputs, belief: Belief, room: Room) -> bool:
    """Note commands and the encoder's resolution; return whether there is an arm that does not begin an episode."""
    begin(design, inputs, belief)
    going = 0
    for arm in range(len(inputs.begins)):
        if not inputs.begins[arm]:
            going += 1
            belief.counts[arm] = common_count(belief.counts[arm], abs(inputs.angle[arm] - belief.angle[arm]))
            for k in range(HISTORY - 1, 0, -1):
                belief.commands[arm, k] = belief.commands[arm, k - 1]
            belief.commands[arm, 0] = inputs.command[arm]
        count = belief.counts[arm]
        room.resolution[arm] = max(count, QUANTUM) if count > 0.0 else COARSEST
    return going > 0


@compiled
def identify(design: Design, inputs: Inputs, belief: Belief, room: Room) -> None:
    """Bring the belief about up to `ARMS` arms up to this sample; about those that begin, it may be anything before."""
    if _note(design, inputs, belief, room):
        rubs = design.nominal.row[COLUMN.coulomb_friction] > 0.0
        simulate(
            belief.tracks.mean, design.nominal, belief.commands, belief.deflection, room.simulation, room.predicted
        )
        for arm in range(len(inputs.angle)):
            sticks = bool(rubs and mode_of_giving(belief.deflection[arm]) == 0.0)
            correct(design, belief.tracks, arm, inputs, sticks, room)
            if sticks:
                belief.deflection[arm] += belief.tracks.mean[arm, 0] - room.predicted[arm, 0, 0]
        begin(design, inputs, belief)  # arms that begin, whatever was made of them as of the others
        for arm in range(len(inputs.angle)):
            belief.angle[arm] = inputs.angle[arm]
            if inputs.moves[arm] and not inputs.begins[arm] and (belief.tracks.holds[arm] or inputs.holds[arm]):
                change_part(design, belief.tracks, arm, inputs.holds[arm])


@compiled
def _some(belief: Belief, low: int, high: int) -> Belief:
    """Belief about some of the arms."""
    tracks = Tracks._make(part[low:high] for part in belief.tracks)
    return Belief(tracks, *(part[low:high] for part in belief[1:]))


@compiled
def _copy(old: Belief, new: Any) -> None:
    for k, part in enumerate(old.tracks):
        new.tracks[k][:] = part
    for k, part in enumerate(old[1:]):
        new[1 + k][:] = part


@compiled
def _identify_all(
    thread: int, design: Design, inputs: Inputs, beliefs: tuple[Belief, Belief], taken: Integers, rooms: Room
) -> None:
    """Bring the belief about any number of arms up to this sample: some at a time, which caches hold.

    Several threads may do so at a time. The first of the two beliefs is that of the last sample, or the second itself
    where all arms begin; the second is written. Of each thread, `taken` says what has been taken of its share, see
    `take_block`, and `rooms` is its room.
    """
    room, count, (before, belief) = room_of(rooms, thread), len(inputs.begins), beliefs
    while True:
        low = take_block(taken, thread, -(-count // ARMS)) * ARMS
        if low < 0:
            break
        high = min(low + ARMS, count)
        some = _some(belief, low, high)
        _copy(_some(before, low, high), some)
        identify(design, Inputs._make(part[low:high] for part in inputs), some, room)


@compiled
def estimate(design: Design, belief: Belief, room: Simulation, result: Estimate) -> None:
    """Write what controllers need to know of up to `ARMS` arms.

    The states to come, D samples on, follow from the commands given before: from sample to sample they are simulated
    with the last command held, and interpolated in between.
    """
    mean, most = belief.tracks.mean, 0
    load(mean, design.nominal, belief.deflection, room)
    for arm in range(len(mean)):
        for i in range(len(FIELDS)):
            result.table[arm, i] = room.constants[i * LANES + arm]
        result.delay[arm] = mean[arm, DELAY]
        most = max(most, int(mean[arm, DELAY]))
        result.states[arm], result.logs[arm] = mean[arm, :4], mean[arm, LOGS]
    for k in range(most + 1):
        room.block[: 4 * LANES] = room.loaded[: 4 * LANES]
        for arm in range(len(mean)):
            if k == int(result.delay[arm]):
                result.direction[arm] = mode_of_giving(room.loaded[at.DEFLECTION * LANES + arm])
        move_on(belief.commands, k + 1, design.nominal.model, room)
        for arm in range(len(mean)):
            whole = int(result.delay[arm])
            part = result.delay[arm] - whole
            for i in range(4 if k == whole else 0):
                before = room.block[i * LANES + arm]
                result.states[arm, i] = before + part * (room.loaded[i * LANES + arm] - before)


@compiled
def _estimate_all(thread: int, design: Design, belief: Belief, result: Estimate, taken: Integers, rooms: Room) -> None:
    """Write what controllers need to know of any number of arms; in threads as `_identify_all`."""
    room = room_of(rooms, thread).simulation
    while True:
        low = take_block(taken, thread, -(-len(result.delay) // ARMS)) * ARMS
        if low < 0:
            break
        high = min(low + ARMS, len(result.delay))
        some = Estimate._make(part[low:high] for part in result)
        estimate(design, _some(belief, low, high), room, some)


class ArmIdentifier:
    """Identification of arms that are nominally `params`.

    Args:
        params: The nominal arm. A Coulomb friction of 0 is not doubted: the motor never sticks.
        uncertainty: What is doubted.
        accelerometer: Whether there is an accelerometer on the arm's end, whose readings are used.
        model: Whose equations of motion the arms are taken to obey, "lumped" or "lagrangian".

    Raises:
        ValueError: If the model is unknown, or a constant is beyond what can be identified.
    """

    def __init__(
        self,
        params: ArmParams,
        uncertainty: Uncertainty | None = None,
        accelerometer: bool = False,
        model: str = "lumped",
    ) -> None:
        self.params = params
        self.uncertainty = uncertainty or Uncertainty()
        self.design = filter_design(params, self.uncertainty, accelerometer, model_of(model, OWN_MODELS))
        self._axes = AXES if accelerometer else 0
        self._rooms: Room | None = None  # of the threads so far

    def update(self, belief: Belief | None, reading: Reading, begins: Flags) -> Belief:
        """Bring the belief up to this sample.

        Args:
            belief: That of the last sample, which is left as it is; None at the beginning.
            reading: Measurements, and the torque commanded at the last sample.
            begins: Which arms begin an episode, at rest where their encoder is, with nothing known; shape (n,). Of
                others what is known lasts, but for a part that is picked or placed where the reading begins a move.

        Raises:
            ValueError: If the belief is about other arms.
        """
        count = len(begins)
        inputs = inputs_of(reading, begins if belief else np.ones(count, np.bool_))
        result = empty_belief(count, len(self.design.mean), self._axes)
        if belief is not None:
            require_shape(belief.tracks.mean, *result.tracks.mean.shape)
        if self._axes:
            assert reading.acceleration is not None, "decoded with the acceleration, see `sensors`"
            seen = unfiltered(reading.acceleration, belief.acceleration if belief else reading.acceleration)
            inputs = inputs._replace(acceleration=seen[0], acceleration_variance=seen[1])
        self._run(_identify_all, count, inputs, (belief or result, result))
        return result._replace(acceleration=reading.acceleration) if self._axes else result

    def reset(self, belief: Belief, reading: Reading, begins: Flags) -> Belief:
        """Reset the belief about arms that begin an episode at a reading, shape (n,)."""
        if not begins.any():
            return belief
        result = deepcopy(belief)
        begin(self.design, inputs_of(reading, begins), result)
        return result

    def estimate(self, belief: Belief) -> Estimate:
        """Estimates that follow from a belief."""
        result = empty_estimate(len(belief.counts))
        self._run(_estimate_all, len(belief.counts), belief, result)
        return result

    def _run(self, kernel: Callable[..., None], count: int, *arguments: Any) -> None:
        """Run a kernel for a number of arms, in threads that each have a room."""
        threads = usual_threads(count // ARMS)
        rooms, self._rooms = self._rooms, None  # while they are in use: another thread of Python makes its own
        if rooms is None or len(rooms.resolution) < threads:
            rooms = room_for(ARMS, self._axes > 0, (threads,))
        in_threads(kernel, threads, self.design, *arguments, none_taken(threads), rooms)
        self._rooms = rooms
