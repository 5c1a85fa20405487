"""Motion over a sample, piece by piece, of arms for which one step will not do.

They are gathered in a block of their own. Each pass takes one step of each arm. Where the motor may stop or break away,
the sample is cut at the command's arrival (`command_latency`): over each of the two pieces the motor tends to one
torque. A step within which the mode ends is not taken; the next pass takes it as far as that instant.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beltarm_env.engine import compiled, inlined
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.exits import EXIT, EXIT_ROWS, find_exits, load_margin, store_margin
from beltarm_env.kernels.layout import (
    IDEAL,
    LANES,
    REAL,
    RealDrive,
    drive_among,
    load_plant,
    load_state,
    store_state,
    whole_vectors,
)
from beltarm_env.physics.drive import angles_of
from beltarm_env.physics.events import Margin, leaves_mode, margin_of, stays_in_mode
from beltarm_env.physics.friction import SLIPS, breakaway_torque, mode_of_giving
from beltarm_env.physics.models import Arm, Model, sliding_direction_at
from beltarm_env.physics.state import ArmState
from beltarm_env.physics.step import ROUNDING, needed_rate, rk4_step, step_length
from beltarm_env.physics.torque import Lag, lag_left, shares_of_two, steady, torques_of_two
from beltarm_env.timing import CONTROL_PERIOD

Floats = NDArray[np.float64]

MOST_STEPS = 20_000
"""Of a sample; an arm that takes more has no state (NaN) from then on, so that it has left its workspace."""
_INSTANT = ROUNDING * CONTROL_PERIOD  # a command that is so near has arrived [s]

# Rows of the working block: as in `layout` up to MOVE, then
_TORQUE = at.MOVE  # of the motor [N m]
BEFORE = _TORQUE + 1  # what it tends to until a command arrives [N m]
AFTER = BEFORE + 1  # and from then on [N m]
_UNTIL = AFTER + 1  # time until then [s]
_SINCE = _UNTIL + 1  # and after it to the sample's end [s]
_DEFLECTION = _SINCE + 1  # of a motor that gives [rad]
_DIRECTION = _DEFLECTION + 1  # friction mode, or
_UNKNOWN = 2.0
SUSPECT = _DIRECTION + 1  # whether the mode may end: the sample is cut at the command's arrival
_SUBSTEPS = SUSPECT + 1  # integration steps per sample
_LANE = _SUBSTEPS + 1  # where the arm came from
_DT = _LANE + 1  # length of the step [s]
_ENDS = _DT + 1  # how the step ends: asked for, or known to be
_ASKED, _AT_EXIT, _INSIDE = 0.0, 1.0, 2.0  # where the motor leaves its mode, or inside it
_SIDE = _ENDS + 1  # to which a motor at rest breaks away
_KEPT_ROWS = _SIDE + 1  # these go with an arm from step to step
_LEAVES = _KEPT_ROWS  # whether the motor leaves its mode within the step
_MARGIN = _LEAVES + 1
WHOLE = _MARGIN + len(Margin._fields)  # whether one step did for the whole sample; in the lanes of the block
_LEAVING = WHOLE + 1  # lanes of the arms whose motor leaves its mode
_EXITS = _LEAVING + 1  # rows of `exits`, of these
PIECE_ROWS = _EXITS + EXIT_ROWS


@compiled
def take_pieces(block: Floats, work: Floats, count: int, model: Model, real_drive: RealDrive) -> None:
    """Move the arms over their sample for which one step would not do.

    Args:
        block: As `layout` describes.
        work: Working block, with BEFORE, AFTER, SUSPECT and WHOLE of each arm.
        count: Number of arms, which are the first.
        model: Whose equations of motion.
        real_drive: Whether their drives are real.
    """
    _finish(block, work, _gather(block, work, count, real_drive), model, real_drive)


@compiled
def take_part(block: Floats, work: Floats, duration: float, model: Model) -> None:
    """Move the arm of the first lane, behind a real drive, over the first `duration` seconds of its sample."""
    pending = _gather(block, work, 1, REAL)
    split = work[_UNTIL * LANES]
    work[_UNTIL * LANES] = min(split, duration)
    work[_SINCE * LANES] = max(duration - split, 0.0)
    work[SUSPECT * LANES] = 1.0
    _finish(block, work, pending, model, REAL)


@compiled
def _finish(block: Floats, work: Floats, pending: int, model: Model, real_drive: RealDrive) -> None:
    """Move the arms that are gathered to the end of their sample."""
    for _ in range(MOST_STEPS):
        if pending == 0:
            break
        _step(work, _pad(work, pending, real_drive), model, real_drive)
        _cut_at_exits(work, pending)
        pending = _put_back_finished(block, work, pending, real_drive)
    for i in range(pending):
        lost = ArmState(math.nan, math.nan, math.nan, math.nan)
        store_state(block, at.STATE, int(work[_LANE * LANES + i]), lost)


@compiled
def _gather(block: Floats, work: Floats, count: int, real_drive: RealDrive) -> int:
    """Copy the arms to the front of `work`, at the beginning of their sample."""
    pending = 0
    for j in range(count):  # without a branch, which would be mispredicted again and again
        work[_LANE * LANES + pending] = j
        pending += 1 if work[WHOLE * LANES + j] == 0.0 else 0
    for i in range(pending):
        j = int(work[_LANE * LANES + i])
        for row in range(at.KINEMATICS):
            work[row * LANES + i] = block[row * LANES + j]
        work[_SUBSTEPS * LANES + i] = block[at.SUBSTEPS * LANES + j]
        work[BEFORE * LANES + i] = work[BEFORE * LANES + j]  # j is not below i
        work[AFTER * LANES + i] = work[AFTER * LANES + j]
        work[SUSPECT * LANES + i] = work[SUSPECT * LANES + j]
        work[_UNTIL * LANES + i] = 0.0
        work[_SINCE * LANES + i] = CONTROL_PERIOD
        work[_DIRECTION * LANES + i] = _UNKNOWN
        work[_ENDS * LANES + i] = _ASKED
        if real_drive is not IDEAL:
            for row in range(at.DRIVE, at.MOVE):
                work[row * LANES + i] = block[row * LANES + j]
            split, deflection = block[at.SPLIT * LANES + j], block[at.DEFLECTION * LANES + j]
            work[_TORQUE * LANES + i] = block[at.TORQUE * LANES + j]
            work[_UNTIL * LANES + i] = split
            work[_SINCE * LANES + i] = CONTROL_PERIOD - split
            work[_DEFLECTION * LANES + i] = deflection
            gives = block[at.SPRING * LANES + j] > 0.0
            work[_DIRECTION * LANES + i] = mode_of_giving(deflection) if gives else _UNKNOWN
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
def _step(work: Floats, count: int, model: Model, real_drive: RealDrive) -> None:
    """Take the next step of each arm; mark those that leave their mode, which keep the state that they began with."""
    for j in range(count):
        x = load_state(work, at.STATE, j)
        plant, drive = load_plant(work, j), drive_among(work, j, real_drive)
        arm = Arm(plant, drive, model)
        until, since = work[_UNTIL * LANES + j], work[_SINCE * LANES + j]
        after, begun = work[AFTER * LANES + j], work[_DIRECTION * LANES + j]
        asked, to_exit = work[_ENDS * LANES + j] == _ASKED, work[_ENDS * LANES + j] == _AT_EXIT
        suspect = work[SUSPECT * LANES + j] != 0.0
        waits = until > 0.0
        horizon = until if suspect & waits else until + since
        target, torque, time, rate, deflection, gives = after, after, 0.0, 0.0, 0.0, False
        if drive is not None:
            target = work[BEFORE * LANES + j] if waits else after
            time, rate = work[at.LAG_TIME * LANES + j], work[at.LAG_RATE * LANES + j]
            torque = work[_TORQUE * LANES + j] if rate > 0.0 else target
            deflection, gives = work[_DEFLECTION * LANES + j], drive.spring > 0.0
        angles = angles_of(x, plant, drive, deflection)
        at_first = sliding_direction_at(x, angles, torque, arm)
        direction = at_first if begun == _UNKNOWN else begun
        if drive is not None:
            stuck_at = breakaway_torque(angles, plant, drive) / (drive.spring if gives else 1.0)
            stopped = gives & (direction == 0.0) & (abs(deflection) >= SLIPS)
            deflection = (stuck_at if deflection > 0.0 else -stuck_at) if stopped else deflection
            angles = angles._replace(deflection=deflection)
        low, high = (torque, target) if torque < target else (target, torque)
        coming = after if waits & (not suspect) else target
        low, high = coming if coming < low else low, coming if coming > high else high
        needed = needed_rate(x, angles, torque, high - low, direction, arm)
        longest, steps = step_length(horizon, needed, work[_SUBSTEPS * LANES + j])
        dt = longest if asked else work[_DT * LANES + j]
        torques = steady(after)
        if drive is not None:
            by_before, by_after = shares_of_two(dt, until if until < dt else dt, time, rate)
            torques = torques_of_two(torque, target, after, by_before, by_after)
        step = rk4_step(x, angles, torques, direction, dt, arm)
        y = step.end
        stays = stays_in_mode(step, low, high, arm)
        arrives = waits & (until < dt)
        lag = Lag(target, torque - target, time, rate)
        margin, side = margin_of(step, lag, arm)
        unsure, slid = (not stays) & arrives & asked, direction != 0.0
        leaves = (not stays) & (not arrives) & asked & leaves_mode(margin, lag_left(lag, torques), slid)
        keeps = leaves | unsure
        last = (steps == 1.0) & asked
        rest = until - dt if (not last) & (until - dt > _INSTANT) else 0.0
        left = since - (dt - until if dt > until else 0.0)
        left = 0.0 if last & ((horizon > until) | (not waits)) else left
        ends_piece = suspect & waits & (rest == 0.0)
        following = 0.0 if gives else _UNKNOWN
        following = following if slid else work[_SIDE * LANES + j]
        following = following if to_exit else (_UNKNOWN if ends_piece & (not slid) & (not gives) else direction)
        at_rest = ArmState(y.motor_angle, 0.0, y.torsion, y.torsion_speed)
        store_margin(work, _MARGIN, j, margin)
        store_state(work, at.STATE, j, either(keeps, x, either(to_exit & (slid | (not gives)), at_rest, y)))
        if drive is not None:
            slips = SLIPS * (direction if slid else work[_SIDE * LANES + j])
            moved_by = deflection + (y.motor_angle - x.motor_angle)
            following_deflection = slips if to_exit | slid else moved_by
            work[_DEFLECTION * LANES + j] = (deflection if keeps else following_deflection) if gives else 0.0
            work[_TORQUE * LANES + j] = torque if keeps else torques.end
        work[_LEAVES * LANES + j] = 1.0 if leaves else 0.0
        work[_SIDE * LANES + j] = side
        work[_ENDS * LANES + j] = _ASKED
        work[_DT * LANES + j] = dt
        work[_DIRECTION * LANES + j] = direction if keeps else following
        work[SUSPECT * LANES + j] = 1.0 if suspect | (not stays) else 0.0
        work[_UNTIL * LANES + j] = until if keeps else rest
        work[_SINCE * LANES + j] = since if keeps else (left if left > 0.0 else 0.0)


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
        work[_ENDS * LANES + j] = _AT_EXIT if share < 1.0 else _INSIDE
        work[_DT * LANES + j] *= share


@compiled
def _put_back_finished(block: Floats, work: Floats, count: int, real_drive: RealDrive) -> int:
    """Write the arms that are done to the lanes of `block` that they came from; fill their places from the end."""
    pending, i = count, 0
    while i < pending:
        if work[_UNTIL * LANES + i] + work[_SINCE * LANES + i] <= 0.0:
            lane = int(work[_LANE * LANES + i])
            store_state(block, at.STATE, lane, load_state(work, at.STATE, i))
            if real_drive is not IDEAL:
                block[at.TORQUE * LANES + lane] = work[_TORQUE * LANES + i]
                block[at.DEFLECTION * LANES + lane] = work[_DEFLECTION * LANES + i]
            pending -= 1
            if i < pending:
                _copy(work, pending, i, real_drive)
        else:
            i += 1
    return pending


@compiled
def _pad(work: Floats, pending: int, real_drive: RealDrive) -> int:
    """Fill up with copies of the first arm to whole vectors."""
    padded = whole_vectors(pending)
    for i in range(pending, padded):
        _copy(work, 0, i, real_drive)
    return padded


@inlined
def _copy(work: Floats, source: int, target: int, real_drive: RealDrive) -> None:
    for row in range(at.KINEMATICS):
        work[row * LANES + target] = work[row * LANES + source]
    if real_drive is not IDEAL:
        for row in range(at.DRIVE, at.MOVE):
            work[row * LANES + target] = work[row * LANES + source]
    for row in range(_TORQUE, _KEPT_ROWS):
        work[row * LANES + target] = work[row * LANES + source]
