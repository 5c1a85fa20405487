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

from baselines.estimation.arm_ekf import begin_track, step
from baselines.estimation.believed_arm import DELAY, HISTORY, LOGS, write_believed
from baselines.estimation.believed_motion import simulate
from baselines.estimation.filter_design import Design, Room, Tracks, room_for
from baselines.estimation.observer import QUANTUM
from beltarm_env.arm import FIELDS
from beltarm_env.arrays import Flags, Floats
from beltarm_env.jit import compiled

COARSEST = 8 * QUANTUM
"""Assumed resolution of an encoder that has not moved yet [rad]."""
_SMALL = 16  # counts; among larger changes, the rounding of a float32 observation adds up


class Notes(NamedTuple):
    """What is known of m arms from sample to sample, as kernels keep it."""

    tracks: Tracks
    counts: Floats  # the encoder's resolution [rad], shape (m,); 0 before it has moved
    angle: Floats  # last measured [rad], shape (m,)
    commands: Floats  # the last ones, latest first [N m], shape (m, HISTORY)


class Inputs(NamedTuple):
    """What m arms tell in one sample."""

    angle: Floats  # measured [rad], shape (m,)
    command: Floats  # of the last sample [N m], shape (m,)
    begins: Flags  # whether an episode begins, shape (m,)


class Estimate(NamedTuple):
    """What controllers need to know of m arms."""

    states: Floats  # x at the time at which a command given now acts, shape (m, 4)
    delay: Floats  # until then [samples], shape (m,)
    logs: Floats  # logarithm of each of IDENTIFIED over its nominal value, shape (m, 6)
    table: Floats  # constants, columns as `ArmParams`, shape (m, len(FIELDS))


class Workspace(NamedTuple):
    """Room for the identification of m arms; what it holds between two calls does not matter."""

    filter: Room
    resolution: Floats  # shape (m,)
    z: Floats  # shape (SIZE or FELT_SIZE, m)
    commands: Floats  # shape (m, HISTORY)
    following: Floats  # x a sample later, shape (1, 4, m)


def workspace_for(count: int, felt: bool = False) -> Workspace:
    """Room for the identification of `count` arms, with accelerometers on their ends if `felt`."""
    room = room_for(count, felt)
    size = len(room.simulation.z)
    return Workspace(
        room, np.zeros(count), np.zeros((size, count)), np.zeros((count, HISTORY)), np.zeros((1, 4, count))
    )


def empty_notes(count: int, size: int) -> Notes:
    """Room for what is known of `count` arms of which z has `size` entries."""
    tracks = Tracks(np.zeros((size, count)), np.zeros((size, size, count)), np.zeros(count), np.zeros(count))
    return Notes(tracks, np.zeros(count), np.zeros(count), np.zeros((count, HISTORY)))


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
    begin_track(design, notes.tracks, arm, angle, COARSEST)
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
def identify(design: Design, inputs: Inputs, notes: Notes, work: Workspace) -> None:
    """Bring what is known up to this sample.

    Args:
        design: Of the filters.
        inputs: Of this sample.
        notes: Up to the last sample; of arms that begin an episode, anything. Changed. With an accelerometer, z and its
            covariance have room for AXES more entries.
        work: With what an accelerometer feels; changed.
    """
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
    if going == 0:
        return
    step(design, notes.tracks, notes.commands, inputs.angle, work.resolution, work.filter)
    begin(design, inputs, notes)
    for arm in range(len(inputs.angle)):
        notes.angle[arm] = inputs.angle[arm]


@compiled
def estimate(design: Design, notes: Notes, work: Workspace, result: Estimate) -> None:
    """Write what controllers need to know.

    The states to come, D samples on, follow from the commands given before: from sample to sample they are simulated
    with the last command held, and interpolated in between.

    Args:
        design: Of the filters.
        notes: Of this sample.
        work: Changed.
        result: Written.
    """
    mean, z, commands, following = notes.tracks.mean, work.z, work.commands, work.following
    size, count = z.shape
    most = 0
    for arm in range(count):
        result.delay[arm] = mean[DELAY, arm]
        most = max(most, int(mean[DELAY, arm]))
        for i in range(size):
            z[i, arm] = mean[i, arm]
        for i in range(4):
            result.states[arm, i] = mean[i, arm]
        for k in range(LOGS.stop - LOGS.start):
            result.logs[arm, k] = mean[LOGS.start + k, arm]
        for k in range(HISTORY):
            commands[arm, k] = notes.commands[arm, k]
    for k in range(most + 1):
        for arm in range(count):
            for age in range(HISTORY - 1, 0, -1):
                commands[arm, age] = commands[arm, age - 1]
        simulate(z, design.nominal, commands, work.filter.simulation, following)
        for arm in range(count):
            whole = int(result.delay[arm])
            part = result.delay[arm] - whole
            for i in range(4):
                if k == whole:
                    result.states[arm, i] = z[i, arm] + part * (following[0, i, arm] - z[i, arm])
                z[i, arm] = following[0, i, arm]
    write_believed(mean, design.nominal, work.filter.simulation.z, result.table)
