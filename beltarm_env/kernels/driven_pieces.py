"""Motion over a sample, piece by piece, of arms behind drives as they are built for which one step will not do.

They are gathered in a block of their own, where the sample is cut at the command's arrival (`command_latency`): over
each of the two pieces the motor tends to one torque. Each pass takes one step of each arm. A step within which the
motor stops or breaks away is not taken; the next pass takes it as far as that instant.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltarm_env.engine import compiled, inlined
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.exits import EXIT, EXIT_ROWS, find_exits, load_margin, store_margin
from beltarm_env.kernels.layout import LANES, load_drive, load_plant, load_state, store_state, whole_vectors
from beltarm_env.physics.drive import angles_of
from beltarm_env.physics.driven.events import Margin, leaves_mode, margin_of
from beltarm_env.physics.driven.step import driven_step, needed_rate, slope, step_length
from beltarm_env.physics.driven.torque import Lag, lag_left, torques_of_lag
from beltarm_env.physics.models import Model, sliding_direction_at
from beltarm_env.physics.state import ArmState
from beltarm_env.timing import CONTROL_PERIOD

Floats = NDArray[np.float64]

MOST_STEPS = 20_000
"""Of a piece; an arm that takes more is left where it is."""

# Rows of the working block: as in `layout` up to MOVE, then
_TORQUE = at.MOVE  # of the motor [N m]
BEFORE = _TORQUE + 1  # what it tends to until a command arrives [N m]
AFTER = BEFORE + 1  # and from then on [N m]
_REMAINING = AFTER + 1  # time left until then [s]
_REMAINING_AFTER = _REMAINING + 1  # and after it [s]
_DIRECTION = _REMAINING_AFTER + 1  # friction mode, or
_UNKNOWN = 2.0
_SUBSTEPS = _DIRECTION + 1  # integration steps per sample
_LANE = _SUBSTEPS + 1  # where the arm came from
_DT = _LANE + 1  # length of the step [s]
_TO_EXIT = _DT + 1  # whether it goes just as far as the motor leaves its mode
_SIDE = _TO_EXIT + 1  # to which a motor at rest breaks away
_KEPT_ROWS = _SIDE + 1  # these go with an arm from step to step
_LEAVES = _KEPT_ROWS  # whether the motor leaves its mode within the step
_NEXT = _LEAVES + 1  # state after the step
_END = _NEXT + 4  # torque then [N m]
_MARGIN = _END + 1
WHOLE = _MARGIN + len(Margin._fields)  # whether one step did for the whole sample; in the lanes of the block
_LEAVING = WHOLE + 1  # lanes of the arms whose motor leaves its mode
_EXITS = _LEAVING + 1  # rows of `exits`, of these
PIECE_ROWS = _EXITS + EXIT_ROWS


@compiled
def take_pieces(block: Floats, work: Floats, count: int, model: Model) -> None:
    """Move the arms over their sample for which one step would not do.

    Args:
        block: As `layout` describes.
        work: Working block, with BEFORE, AFTER and WHOLE of each arm.
        count: Number of arms, which are the first.
        model: Whose equations of motion.
    """
    _finish(block, work, _gather(block, work, count), model)


@compiled
def take_part(block: Floats, work: Floats, duration: float, model: Model) -> None:
    """Move the arm of the first lane over the first `duration` seconds of its sample; see `take_pieces`."""
    pending = _gather(block, work, 1)
    split = work[_REMAINING * LANES]
    work[_REMAINING * LANES] = min(split, duration)
    work[_REMAINING_AFTER * LANES] = max(duration - split, 0.0)
    _finish(block, work, pending, model)


@compiled
def _finish(block: Floats, work: Floats, pending: int, model: Model) -> None:
    """Move the arms that are gathered over their pieces."""
    for _ in range(MOST_STEPS):
        if pending == 0:
            break
        _step(work, _pad(work, pending), model)
        _cut_at_exits(work, pending)
        pending = _put_back_finished(block, work, pending)


@compiled
def _gather(block: Floats, work: Floats, count: int) -> int:
    """Copy the arms to the front of `work`, at the beginning of their sample."""
    pending = 0
    for j in range(count):  # without a branch, which would be mispredicted again and again
        work[_LANE * LANES + pending] = j
        pending += 1 if work[WHOLE * LANES + j] == 0.0 else 0
    for i in range(pending):
        j = int(work[_LANE * LANES + i])
        for row in range(at.KINEMATICS):
            work[row * LANES + i] = block[row * LANES + j]
        for row in range(at.DRIVE, at.MOVE):
            work[row * LANES + i] = block[row * LANES + j]
        work[_SUBSTEPS * LANES + i] = block[at.SUBSTEPS * LANES + j]
        split = block[at.SPLIT * LANES + j]
        work[_TORQUE * LANES + i] = block[at.TORQUE * LANES + j]
        work[BEFORE * LANES + i] = work[BEFORE * LANES + j]  # j is not below i
        work[AFTER * LANES + i] = work[AFTER * LANES + j]
        work[_REMAINING * LANES + i] = split
        work[_REMAINING_AFTER * LANES + i] = CONTROL_PERIOD - split
        work[_DIRECTION * LANES + i] = _UNKNOWN
        work[_TO_EXIT * LANES + i] = 0.0
    return pending


@inlined
def either(first: bool, x: ArmState, y: ArmState) -> ArmState:
    """Return the first state or the second, entry by entry: a choice that vectorises."""
    return ArmState(
        x.motor_angle if first else y.motor_angle,
        x.motor_speed if first else y.motor_speed,
        x.torsion if first else y.torsion,
        x.torsion_speed if first else y.torsion_speed,
    )


@compiled
def _step(work: Floats, count: int, model: Model) -> None:
    """Take the next step of each arm; mark those that leave their mode, which keep the state that they began with."""
    for j in range(count):
        x = load_state(work, at.STATE, j)
        plant, drive = load_plant(work, j), load_drive(work, j)
        time, rate = work[at.LAG_TIME * LANES + j], work[at.LAG_RATE * LANES + j]
        to_exit = work[_TO_EXIT * LANES + j] != 0.0
        arrives = work[_REMAINING * LANES + j] <= 0.0
        before, after = work[BEFORE * LANES + j], work[AFTER * LANES + j]
        first_piece, last_piece = work[_REMAINING * LANES + j], work[_REMAINING_AFTER * LANES + j]
        target = after if arrives else before
        remaining = last_piece if arrives else first_piece
        torque = work[_TORQUE * LANES + j] if rate > 0.0 else target
        angles = angles_of(x, plant, drive)
        begun = work[_DIRECTION * LANES + j]
        at_first = sliding_direction_at(x, angles, torque, plant, model, drive)
        direction = at_first if arrives | (begun == _UNKNOWN) else begun
        lag = Lag(target, torque - target, time, rate)
        first = slope(x, angles, torque, direction, plant, drive, model)
        needed = needed_rate(x, first.motor_speed, abs(lag.excess), direction, plant, drive)
        longest, steps = step_length(remaining, needed, work[_SUBSTEPS * LANES + j])
        dt = work[_DT * LANES + j] if to_exit else longest
        torques = torques_of_lag(lag, dt)
        step = driven_step(x, angles, torques, direction, dt, plant, drive, model)
        margin, side = margin_of(x, angles, step, torques, lag, direction, dt, plant, drive, model)
        leaves = leaves_mode(margin, lag_left(lag, torques)) & (not to_exit)
        y = step.state
        at_rest = ArmState(y.motor_angle, 0.0, y.torsion, y.torsion_speed)
        stopped = direction != 0.0
        following = _UNKNOWN if stopped else work[_SIDE * LANES + j]
        left = remaining - dt if to_exit | (steps > 1.0) else 0.0
        store_margin(work, _MARGIN, j, margin)
        store_state(work, _NEXT, j, y)
        store_state(work, at.STATE, j, either(leaves, x, either(to_exit, at_rest, y)))
        work[_END * LANES + j] = torques.end
        work[_TORQUE * LANES + j] = torque if leaves else torques.end
        work[_LEAVES * LANES + j] = 1.0 if leaves else 0.0
        work[_SIDE * LANES + j] = side
        work[_TO_EXIT * LANES + j] = 0.0
        work[_DT * LANES + j] = dt
        work[_DIRECTION * LANES + j] = following if to_exit else direction
        work[BEFORE * LANES + j] = target
        left = remaining if leaves else left
        work[_REMAINING * LANES + j] = left if left > 0.0 else 0.0
        work[_REMAINING_AFTER * LANES + j] = 0.0 if arrives else last_piece


@compiled
def _cut_at_exits(work: Floats, count: int) -> None:
    """Let the next step of the marked arms end where their motor stops or breaks away, if it does."""
    leaving = 0
    for j in range(count):
        work[_LEAVING * LANES + leaving] = j
        leaving += 1 if work[_LEAVES * LANES + j] != 0.0 else 0
    if leaving == 0:
        return
    exits = work[_EXITS * LANES :]
    for i in range(leaving):
        store_margin(exits, 0, i, load_margin(work, _MARGIN, int(work[_LEAVING * LANES + i])))
    find_exits(exits, leaving)
    for i in range(leaving):
        j, share = int(work[_LEAVING * LANES + i]), exits[EXIT * LANES + i]
        if share < 1.0:
            work[_TO_EXIT * LANES + j] = 1.0
            work[_DT * LANES + j] *= share
        else:  # touches the limit of the mode
            store_state(work, at.STATE, j, load_state(work, _NEXT, j))
            work[_TORQUE * LANES + j] = work[_END * LANES + j]
            work[_REMAINING * LANES + j] = max(work[_REMAINING * LANES + j] - work[_DT * LANES + j], 0.0)


@compiled
def _put_back_finished(block: Floats, work: Floats, count: int) -> int:
    """Write the arms that are done to the lanes of `block` that they came from; fill their places from the end."""
    pending, i = count, 0
    while i < pending:
        if work[_REMAINING * LANES + i] + work[_REMAINING_AFTER * LANES + i] <= 0.0:
            lane = int(work[_LANE * LANES + i])
            store_state(block, at.STATE, lane, load_state(work, at.STATE, i))
            block[at.TORQUE * LANES + lane] = work[_TORQUE * LANES + i]
            pending -= 1
            if i < pending:
                _copy(work, pending, i)
        else:
            i += 1
    return pending


@compiled
def _pad(work: Floats, pending: int) -> int:
    """Fill up with copies of the first arm to whole vectors."""
    padded = whole_vectors(pending)
    for i in range(pending, padded):
        _copy(work, 0, i)
    return padded


@inlined
def _copy(work: Floats, source: int, target: int) -> None:
    for row in range(at.KINEMATICS):
        work[row * LANES + target] = work[row * LANES + source]
    for row in range(at.DRIVE, _KEPT_ROWS):
        work[row * LANES + target] = work[row * LANES + source]
