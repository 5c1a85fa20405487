"""Recursive identification of an arm, of its drive and of its encoder, while it moves.

Everything that is constant about the arm and its drive is found by the extended Kalman filter of
`baselines.estimation.arm_ekf`, the delay between command and measurement included. Beside it, the encoder's resolution
is identified, because a filter that assumes a wrong one mistakes its rounding for another arm: all changes of the
measured angle are multiples of one count q. Their greatest common divisor is taken while they are small, for those of a
fast motor carry no more information. Before the first change, the encoder may be a coarse one.

A command given now acts D samples later. What there is to be controlled is the state at that time, which follows from
the commands given before: `estimate`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from baselines.estimation.arm_ekf import begin_track, correct
from baselines.estimation.believed_arm import ARMS, DELAY, HISTORY, LOGS
from baselines.estimation.believed_lanes import load, write_table
from baselines.estimation.believed_motion import move_on, simulate
from baselines.estimation.filter_design import Design, Inputs, Room, Tracks, room_for, room_of, vector_rooms
from baselines.estimation.observer import QUANTUM
from beltarm_env.arm import FIELDS
from beltarm_env.arrays import Floats, Integers
from beltarm_env.engine import compiled
from beltarm_env.engine.blocks import take_block
from beltarm_env.kernels.layout import LANES

COARSEST = 8 * QUANTUM
"""Assumed resolution of an encoder that has not moved yet [rad]."""
_SMALL = 16  # counts; among larger changes, the rounding of a float32 observation adds up


class Notes(NamedTuple):
    """What is known of m arms from sample to sample, as kernels keep it."""

    tracks: Tracks
    counts: Floats  # the encoder's resolution [rad], shape (m,); 0 before it has moved
    angle: Floats  # last measured [rad], shape (m,)
    commands: Floats  # the last ones, latest first [N m], shape (m, HISTORY)


class Estimate(NamedTuple):
    """What controllers need to know of m arms."""

    states: Floats  # x at the time at which a command given now acts, shape (m, 4)
    delay: Floats  # until then [samples], shape (m,)
    logs: Floats  # logarithm of each of IDENTIFIED over its nominal value, shape (m, 6)
    table: Floats  # constants, columns as `ArmParams`, shape (m, len(FIELDS))


class Workspace(NamedTuple):
    """Room for identification; what it holds between two calls does not matter."""

    filter: Room
    resolution: Floats  # shape (m,), or (ARMS,)


def workspace_for(count: int) -> Workspace:
    """Room for `identify` of `count` arms, at most `ARMS`."""
    return Workspace(room_for(count), np.zeros(count))


def vector_workspaces(threads: int, felt: bool) -> tuple[Workspace, Floats]:
    """Return room for the threads of `identify_all`, with accelerometers if `felt`, and that for covariances."""
    rooms, covariances = vector_rooms(threads, felt)
    return Workspace(rooms, np.zeros((threads, ARMS))), covariances


@compiled
def _workspace_of(works: Workspace, thread: int) -> Workspace:
    """Room of one thread, see `vector_rooms`."""
    return Workspace(room_of(works.filter, thread), works.resolution[thread])


def empty_notes(count: int, size: int, more: int = 0, empty: Callable[..., Floats] = np.zeros) -> Notes:
    """Room for what is known of `count` arms of which z has `size` entries, with room for some more.

    `empty` makes an array of a shape.
    """
    tracks = Tracks(empty((count, size + more)), empty((count, size, size)), empty(count), empty(count))
    return Notes(tracks, empty(count), empty(count), empty((count, HISTORY)))


def empty_estimate(count: int) -> Estimate:
    """Room for the estimates of `count` arms."""
    logs = LOGS.stop - LOGS.start
    return Estimate(np.zeros((count, 4)), np.zeros(count), np.zeros((count, logs)), np.zeros((count, len(FIELDS))))


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
def _begin(design: Design, notes: Notes, arm: int, angle: float) -> None:
    """Write what is known of an arm that begins an episode, at rest at a motor angle [rad]."""
    begin_track(design, notes.tracks, arm, notes.tracks.covariance[arm], angle, COARSEST)
    notes.counts[arm], notes.angle[arm] = 0.0, angle
    for k in range(HISTORY):
        notes.commands[arm, k] = 0.0


@compiled
def begin(design: Design, inputs: Inputs, notes: Notes) -> None:
    """Write what is known of all arms that begin an episode, and leave others as they are."""
    for arm in range(len(inputs.begins)):
        if inputs.begins[arm]:
            _begin(design, notes, arm, inputs.angle[arm])


@compiled
def _note(design: Design, inputs: Inputs, notes: Notes, work: Workspace) -> bool:
    """Note commands and the encoder's resolution; return whether there is an arm that does not begin an episode."""
    begin(design, inputs, notes)
    going = 0
    for arm in range(len(inputs.begins)):
        if not inputs.begins[arm]:
            going += 1
            notes.counts[arm] = common_count(notes.counts[arm], abs(inputs.angle[arm] - notes.angle[arm]))
            for k in range(HISTORY - 1, 0, -1):
                notes.commands[arm, k] = notes.commands[arm, k - 1]
            notes.commands[arm, 0] = inputs.command[arm]
        count = notes.counts[arm]
        work.resolution[arm] = max(count, QUANTUM) if count > 0.0 else COARSEST
    return going > 0


@compiled
def _predict(design: Design, notes: Notes, work: Workspace) -> None:
    """Simulate the sample, for `correct`."""
    room = work.filter
    simulate(notes.tracks.mean, design.nominal, notes.commands, room.simulation, room.predicted)


@compiled
def _end(design: Design, inputs: Inputs, notes: Notes) -> None:
    """Let arms that begin an episode begin it, whatever was made of them as of the others, and note the angles."""
    begin(design, inputs, notes)
    for arm in range(len(inputs.angle)):
        notes.angle[arm] = inputs.angle[arm]


@compiled
def identify(design: Design, inputs: Inputs, notes: Notes, work: Workspace) -> None:
    """Bring what is known of up to `ARMS` arms up to this sample, in place.

    Args:
        design: Of the filters.
        inputs: Of this sample.
        notes: Up to the last sample; of arms that begin an episode, anything. Changed.
        work: Changed.
    """
    if not _note(design, inputs, notes, work):
        return
    _predict(design, notes, work)
    for arm in range(len(inputs.angle)):
        covariance = notes.tracks.covariance[arm]
        correct(design, notes.tracks, arm, covariance, inputs, work.resolution[arm], work.filter)
    _end(design, inputs, notes)


@compiled
def _some_notes(notes: Notes, low: int, high: int) -> Notes:
    """What is known of some arms."""
    tracks = Tracks._make(part[low:high] for part in notes.tracks)
    return Notes(tracks, *(part[low:high] for part in notes[1:]))


@compiled
def _copy_square(source: Floats, target: Floats, size: int) -> None:
    for i in range(size):
        for j in range(size):
            target[i, j] = source[i, j]


@compiled
def identify_all(
    thread: int,
    design: Design,
    inputs: Inputs,
    before: Notes,
    begun: bool,
    notes: Notes,
    taken: Integers,
    works: Workspace,
    covariances: Floats,
) -> None:
    """Bring what is known of any number of arms up to this sample, as `identify`: some at a time, which caches hold.

    Several threads may do so at a time, each with room of its own.

    Args:
        thread: Index of this one.
        design: Of the filters.
        inputs: Of this sample.
        before: Up to the last sample; z without room for more entries.
        begun: Whether anything is known.
        notes: Up to this sample, written; with an accelerometer, z has room for AXES more entries.
        taken: What has been taken of each thread's share, see `take_block`.
        works: Room of each thread, with rows of whole vectors; changed.
        covariances: Room of each thread for that of one arm, with its AXES; changed.
    """
    work, covariance = _workspace_of(works, thread), covariances[thread]
    size, count = len(design.mean), len(inputs.begins)
    while True:
        low = take_block(taken, thread, -(-count // ARMS)) * ARMS
        if low < 0:
            break
        high = min(low + ARMS, count)
        old, new = _some_notes(before, low, high), _some_notes(notes, low, high)
        for arm in range(high - low if begun else 0):
            new.tracks.surprise[arm], new.tracks.unrest[arm] = old.tracks.surprise[arm], old.tracks.unrest[arm]
            new.counts[arm], new.angle[arm] = old.counts[arm], old.angle[arm]
            for i in range(size):
                new.tracks.mean[arm, i] = old.tracks.mean[arm, i]
            for k in range(HISTORY):
                new.commands[arm, k] = old.commands[arm, k]
        some = Inputs._make(part[low:high] for part in inputs)
        if _note(design, some, new, work):
            _predict(design, new, work)
            for arm in range(high - low):
                _copy_square(old.tracks.covariance[arm], covariance, size)
                correct(design, new.tracks, arm, covariance, some, work.resolution[arm], work.filter)
                _copy_square(covariance, new.tracks.covariance[arm], size)
            _end(design, some, new)


@compiled
def estimate(design: Design, notes: Notes, work: Workspace, result: Estimate) -> None:
    """Write what controllers need to know of up to `ARMS` arms.

    The states to come, D samples on, follow from the commands given before: from sample to sample they are simulated
    with the last command held, and interpolated in between.

    Args:
        design: Of the filters.
        notes: Of this sample.
        work: Changed.
        result: Written.
    """
    mean, room, most = notes.tracks.mean, work.filter.simulation, 0
    load(mean, design.nominal, room)
    write_table(room.constants, result.table)
    for arm in range(len(mean)):
        result.delay[arm] = mean[arm, DELAY]
        most = max(most, int(mean[arm, DELAY]))
        for i in range(4):
            result.states[arm, i] = mean[arm, i]
        for k in range(LOGS.stop - LOGS.start):
            result.logs[arm, k] = mean[arm, LOGS.start + k]
    for k in range(most + 1):
        for i in range(4 * LANES):
            room.block[i] = room.loaded[i]
        move_on(notes.commands, k + 1, room)
        for arm in range(len(mean)):
            whole = int(result.delay[arm])
            part = result.delay[arm] - whole
            for i in range(4 if k == whole else 0):
                before = room.block[i * LANES + arm]
                result.states[arm, i] = before + part * (room.loaded[i * LANES + arm] - before)


@compiled
def estimate_all(
    thread: int, design: Design, notes: Notes, result: Estimate, taken: Integers, works: Workspace
) -> None:
    """Write what controllers need to know of any number of arms, as `estimate`; in threads as `identify_all`."""
    work = _workspace_of(works, thread)
    while True:
        low = take_block(taken, thread, -(-len(result.delay) // ARMS)) * ARMS
        if low < 0:
            break
        high = min(low + ARMS, len(result.delay))
        some = Estimate._make(part[low:high] for part in result)
        estimate(design, _some_notes(notes, low, high), work, some)
