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

from typing import NamedTuple

import numpy as np

from baselines.estimation.arm_ekf import begin_track, change_part, correct
from baselines.estimation.believed_arm import ARMS, DELAY, HISTORY, LOGS
from baselines.estimation.believed_motion import move_on, simulate
from baselines.estimation.filter_design import Design, Inputs, Room, Tracks, room_of
from baselines.estimation.observer import QUANTUM
from baselines.estimation.simulation_lanes import Simulation, load, write_table
from beltarm_env.arm import COLUMN, FIELDS
from beltarm_env.arrays import Floats, Integers
from beltarm_env.engine import compiled
from beltarm_env.engine.blocks import take_block
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.layout import LANES
from beltarm_env.physics.friction import mode_of_giving

COARSEST = 8 * QUANTUM
"""Assumed resolution of an encoder that has not moved yet [rad]."""
_SMALL = 16  # counts; among larger changes, the rounding of a float32 observation adds up


class Notes(NamedTuple):
    """What is known of m arms from sample to sample, as kernels keep it."""

    tracks: Tracks
    counts: Floats  # the encoder's resolution [rad], shape (m,); 0 before it has moved
    angle: Floats  # last measured [rad], shape (m,)
    commands: Floats  # the last ones, latest first [N m], shape (m, HISTORY)
    deflection: Floats  # of the motor that sticks [rad], shape (m,); `friction.SLIPS`, in its direction, if it slides


class Estimate(NamedTuple):
    """What controllers need to know of m arms."""

    states: Floats  # x at the time at which a command given now acts, shape (m, 4)
    delay: Floats  # until then [samples], shape (m,)
    direction: Floats  # friction mode then: -1 or 1 of a motor that slides, 0 of one that sticks, shape (m,)
    logs: Floats  # logarithm of each of IDENTIFIED over its nominal value, shape (m, 6)
    table: Floats  # constants, columns as `ArmParams`, shape (m, len(FIELDS))


def empty_notes(count: int, size: int, more: int = 0) -> Notes:
    """Room for what is known of `count` arms of which z has `size` entries, and room for some more."""
    width = size + more
    filters = np.zeros((count, width)), np.zeros((count, width, width)), np.zeros(count), np.zeros(count)
    tracks = Tracks(*filters, np.zeros(count, np.bool_), np.zeros((count, 2)))
    return Notes(tracks, np.zeros(count), np.zeros(count), np.zeros((count, HISTORY)), np.zeros(count))


def empty_estimate(count: int) -> Estimate:
    """Room for the estimates of `count` arms."""
    logs = LOGS.stop - LOGS.start
    return Estimate(
        np.zeros((count, 4)), np.zeros(count), np.zeros(count), np.zeros((count, logs)), np.zeros((count, len(FIELDS)))
    )


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
def _begin(design: Design, notes: Notes, arm: int, angle: float, holds: bool) -> None:
    """Write what is known of an arm that begins an episode, at rest at a motor angle [rad], with a part or without."""
    notes.tracks.holds[arm] = holds
    begin_track(design, notes.tracks, arm, angle, COARSEST)
    notes.counts[arm], notes.angle[arm], notes.deflection[arm] = 0.0, angle, 0.0
    for k in range(HISTORY):
        notes.commands[arm, k] = 0.0


@compiled
def begin(design: Design, inputs: Inputs, notes: Notes) -> None:
    """Write what is known of all arms that begin an episode, and leave others as they are."""
    for arm in range(len(inputs.begins)):
        if inputs.begins[arm]:
            _begin(design, notes, arm, inputs.angle[arm], inputs.holds[arm])


@compiled
def _note(design: Design, inputs: Inputs, notes: Notes, room: Room) -> bool:
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
        room.resolution[arm] = max(count, QUANTUM) if count > 0.0 else COARSEST
    return going > 0


@compiled
def identify(design: Design, inputs: Inputs, notes: Notes, room: Room) -> None:
    """Bring what is known of up to `ARMS` arms up to this sample, in place.

    Args:
        design: Of the filters.
        inputs: Of this sample.
        notes: Up to the last sample; of arms that begin an episode, anything. Changed.
        room: Changed.
    """
    if _note(design, inputs, notes, room):
        rubs = design.nominal[COLUMN.coulomb_friction] > 0.0
        simulate(notes.tracks.mean, design.nominal, notes.commands, notes.deflection, room.simulation, room.predicted)
        for arm in range(len(inputs.angle)):
            sticks = bool(rubs and mode_of_giving(notes.deflection[arm]) == 0.0)
            correct(design, notes.tracks, arm, inputs, sticks, room)
            if sticks:
                notes.deflection[arm] += notes.tracks.mean[arm, 0] - room.predicted[arm, 0, 0]
        begin(design, inputs, notes)  # arms that begin, whatever was made of them as of the others
        for arm in range(len(inputs.angle)):
            notes.angle[arm] = inputs.angle[arm]
            if inputs.moves[arm] and not inputs.begins[arm] and (notes.tracks.holds[arm] or inputs.holds[arm]):
                change_part(design, notes.tracks, arm, inputs.holds[arm])


@compiled
def _some_notes(notes: Notes, low: int, high: int) -> Notes:
    """What is known of some arms."""
    tracks = Tracks._make(part[low:high] for part in notes.tracks)
    return Notes(tracks, *(part[low:high] for part in notes[1:]))


@compiled
def _copy_notes(old: Notes, new: Notes) -> None:
    """Copy what is known of some arms; the new tracks may have room for more entries of z."""
    count, size = old.tracks.mean.shape
    for arm in range(count):
        new.tracks.surprise[arm], new.tracks.noise_factor[arm] = old.tracks.surprise[arm], old.tracks.noise_factor[arm]
        new.tracks.holds[arm] = old.tracks.holds[arm]
        for i in range(2):
            new.tracks.without_part[arm, i] = old.tracks.without_part[arm, i]
        new.counts[arm], new.angle[arm], new.deflection[arm] = old.counts[arm], old.angle[arm], old.deflection[arm]
        for i in range(size):
            new.tracks.mean[arm, i] = old.tracks.mean[arm, i]
            for j in range(size):
                new.tracks.covariance[arm, i, j] = old.tracks.covariance[arm, i, j]
        for k in range(HISTORY):
            new.commands[arm, k] = old.commands[arm, k]


@compiled
def identify_all(
    thread: int, design: Design, inputs: Inputs, before: Notes, notes: Notes, taken: Integers, rooms: Room
) -> None:
    """Bring what is known of any number of arms up to this sample, as `identify`: some at a time, which caches hold.

    Several threads may do so at a time, each with room of its own.

    Args:
        thread: Index of this one.
        design: Of the filters.
        inputs: Of this sample.
        before: Up to the last sample; `notes` themselves where all arms begin.
        notes: Up to this sample, written; with an accelerometer, z has room for AXES more entries.
        taken: What has been taken of each thread's share, see `take_block`.
        rooms: Of each thread; changed.
    """
    room, count = room_of(rooms, thread), len(inputs.begins)
    while True:
        low = take_block(taken, thread, -(-count // ARMS)) * ARMS
        if low < 0:
            break
        high = min(low + ARMS, count)
        some = _some_notes(notes, low, high)
        _copy_notes(_some_notes(before, low, high), some)
        identify(design, Inputs._make(part[low:high] for part in inputs), some, room)


@compiled
def estimate(design: Design, notes: Notes, room: Simulation, result: Estimate) -> None:
    """Write what controllers need to know of up to `ARMS` arms.

    The states to come, D samples on, follow from the commands given before: from sample to sample they are simulated
    with the last command held, and interpolated in between.

    Args:
        design: Of the filters.
        notes: Of this sample.
        room: Changed.
        result: Written.
    """
    mean, most = notes.tracks.mean, 0
    load(mean, design.nominal, notes.deflection, room)
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
        for arm in range(len(mean)):
            if k == int(result.delay[arm]):
                result.direction[arm] = mode_of_giving(room.loaded[at.DEFLECTION * LANES + arm])
        move_on(notes.commands, k + 1, room)
        for arm in range(len(mean)):
            whole = int(result.delay[arm])
            part = result.delay[arm] - whole
            for i in range(4 if k == whole else 0):
                before = room.block[i * LANES + arm]
                result.states[arm, i] = before + part * (room.loaded[i * LANES + arm] - before)


@compiled
def estimate_all(thread: int, design: Design, notes: Notes, result: Estimate, taken: Integers, rooms: Room) -> None:
    """Write what controllers need to know of any number of arms, as `estimate`; in threads as `identify_all`."""
    room = room_of(rooms, thread).simulation
    while True:
        low = take_block(taken, thread, -(-len(result.delay) // ARMS)) * ARMS
        if low < 0:
            break
        high = min(low + ARMS, len(result.delay))
        some = Estimate._make(part[low:high] for part in result)
        estimate(design, _some_notes(notes, low, high), room, some)
