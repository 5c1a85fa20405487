"""Motion of a block of arms behind drives as they are built, over one control period.

All arms take the sample in one step, side by side. Those whose motor may stop or break away within it, or that need
shorter steps, are gathered in a block of their own, where the sample is cut at the command's arrival
(`command_latency`): over each of the two pieces the motor tends to one torque.

Arms with an ideal drive among them are moved by `advance`, as they are alone.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltarm_env.arm import COLUMN, Plant
from beltarm_env.jit import compiled, inlined
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.advance import WORK_ROWS, advance_block
from beltarm_env.kernels.layout import (
    LANES,
    load_drive,
    load_plant,
    load_stages,
    load_state,
    store_drive,
    store_stages,
    store_state,
)
from beltarm_env.physics.drive import DRIVE_COLUMNS, angles_of, drive_of
from beltarm_env.physics.driven.events import leaves_mode, margin_of, past_mode_change, stays_in_mode
from beltarm_env.physics.driven.step import driven_step, needed_rate, slope, step_length
from beltarm_env.physics.driven.torque import Lag, lag_left, shares_of_two, torques_of_lag, torques_of_two
from beltarm_env.physics.models import Model, sliding_direction_at
from beltarm_env.physics.state import ArmState
from beltarm_env.timing import CONTROL_PERIOD, EPISODE_STEPS, LATENCY_SAMPLES

Floats = NDArray[np.float64]

MOST_STEPS = 20_000
"""Of a piece; an arm that takes more is left where it is."""

# Rows of the plant's coefficients that drift.
_VISCOUS_NOW = at.PLANT + Plant._fields.index("viscous_friction")
_COULOMB_NOW = at.PLANT + Plant._fields.index("coulomb_friction")
_LIMIT = at.PLANT + Plant._fields.index("torque_limit")

_VECTOR = 8  # arms that the widest vector units take at once

# Rows of the working block: as in `layout` up to MOVE, then
_TORQUE = at.MOVE  # of the motor [N m]
_BEFORE = _TORQUE + 1  # what it tends to until a command arrives [N m]
_AFTER = _BEFORE + 1  # and from then on [N m]
_REMAINING = _AFTER + 1  # time left until then [s]
_REMAINING_AFTER = _REMAINING + 1  # and after it [s]
_DIRECTION = _REMAINING_AFTER + 1  # friction mode, or
_UNKNOWN = 2.0
_LANE = _DIRECTION + 1  # where the arm came from
_DT = _LANE + 1  # length of the step [s]
_LEAVES = _DT + 1  # whether it leaves its mode within the step
_WHOLE = _LEAVES + 1  # whether one step did for the whole sample; in the lanes of the block
_SUBSTEPS = _WHOLE + 1  # integration steps per sample
_ROWS = _SUBSTEPS + 1
DRIVEN_WORK_ROWS = WORK_ROWS + _ROWS + 4  # and those of `advance`, and states of arms with an ideal drive


@inlined
def begin_drive(block: Floats, lane: int, row: Any) -> None:
    """Put an arm's drive into its lane, with a motor without torque, from a row of constants, shape (len(FIELDS),)."""
    store_drive(block, lane, drive_of(row))
    effect = 0.0
    for k in range(len(DRIVE_COLUMNS)):
        effect = 1.0 if row[DRIVE_COLUMNS[k]] != 0.0 else effect
    block[at.DRIVEN * LANES + lane] = effect
    begin_lag(block, lane, float(row[COLUMN.current_loop_time_constant]), float(row[COLUMN.command_latency]))
    begin_friction(block, lane, row)


@inlined
def begin_lag(block: Floats, lane: int, lag: float, latency: float) -> None:
    """Put the current loop's time constant and the latency of commands, both in seconds, into a lane."""
    rate = 1 / lag if lag > 0.0 else 0.0
    block[at.LAG_TIME * LANES + lane] = lag
    block[at.LAG_RATE * LANES + lane] = rate
    samples = latency / CONTROL_PERIOD
    late = min(float(np.floor(samples)), LATENCY_SAMPLES - 1.0)
    split = min((samples - late) * CONTROL_PERIOD, CONTROL_PERIOD)
    block[at.LATE * LANES + lane] = late
    block[at.SPLIT * LANES + lane] = split
    by_before, by_after = shares_of_two(split, lag, rate)
    store_stages(block, at.BY_BEFORE, lane, by_before)
    store_stages(block, at.BY_AFTER, lane, by_after)


@inlined
def begin_friction(block: Floats, lane: int, row: Any) -> None:
    """Put friction at the beginning and its drift, and the torque constant, into a lane."""
    block[at.GAIN * LANES + lane] = 1 + row[COLUMN.torque_constant_error]
    block[at.VISCOUS * LANES + lane] = row[COLUMN.motor_viscous_friction]
    block[at.COULOMB * LANES + lane] = row[COLUMN.coulomb_friction]
    block[at.DRIFT * LANES + lane] = row[COLUMN.friction_drift] / EPISODE_STEPS


@compiled
def advance_driven_block(block: Floats, work: Floats, actions: Floats, count: int, model: Model) -> None:
    """Advance the first `count` arms of a block by one control period, whatever their drives.

    Args:
        block: As `layout` describes.
        work: Room for DRIVEN_WORK_ROWS rows.
        actions: Torques commanded, over their limits, shape (LANES,).
        count: Number of arms.
        model: Whose equations of motion.
    """
    built = 0.0
    for j in range(count):
        built += block[at.DRIVEN * LANES + j]
    if built == 0.0:
        advance_block(block, work, actions, count, model)
        return
    kept = work[(WORK_ROWS + _ROWS) * LANES :]
    if built < count:
        for j in range(count):
            store_state(kept, 0, j, load_state(block, at.STATE, j))
        advance_block(block, work, actions, count, model)
        for j in range(count):  # a moved arm where the drive is ideal, where it was elsewhere
            x, y = load_state(kept, 0, j), load_state(block, at.STATE, j)
            store_state(block, at.STATE, j, x)
            store_state(kept, 0, j, y)
    _advance_built(block, work[WORK_ROWS * LANES :], actions, count, model)
    if built < count:
        for j in range(count):
            if block[at.DRIVEN * LANES + j] == 0.0:
                store_state(block, at.STATE, j, load_state(kept, 0, j))


@compiled
def _advance_built(block: Floats, work: Floats, actions: Floats, count: int, model: Model) -> None:
    _take_whole_step(block, work, actions, count, model)
    pending = _gather(block, work, count)
    for _ in range(MOST_STEPS):
        if pending == 0:
            break
        _step(work, _pad(work, pending), model)
        _change_modes(work, pending, model)
        pending = _put_back_finished(block, work, pending)


@inlined
def _either(first: bool, x: ArmState, y: ArmState) -> ArmState:
    """Return the first state or the second, entry by entry: a choice that vectorises."""
    return ArmState(
        x.motor_angle if first else y.motor_angle,
        x.motor_speed if first else y.motor_speed,
        x.torsion if first else y.torsion,
        x.torsion_speed if first else y.torsion_speed,
    )


@compiled
def _take_whole_step(block: Floats, work: Floats, actions: Floats, count: int, model: Model) -> None:
    """Take the whole sample in one step; mark the arms for which that may not do, and leave them where they are."""
    for j in range(count):
        shift = at.TARGETS * LANES + j
        t3, t2, t1 = block[shift + 2 * LANES], block[shift + LANES], block[shift]
        t0 = actions[j] * block[_LIMIT * LANES + j] * block[at.GAIN * LANES + j]
        block[shift + 3 * LANES], block[shift + 2 * LANES], block[shift + LANES], block[shift] = t3, t2, t1, t0
        worn = 1 + block[at.DRIFT * LANES + j] * (block[at.STEP * LANES + j] + 0.5)
        block[_VISCOUS_NOW * LANES + j] = block[at.VISCOUS * LANES + j] * worn
        block[_COULOMB_NOW * LANES + j] = block[at.COULOMB * LANES + j] * worn
        late, rate = block[at.LATE * LANES + j], block[at.LAG_RATE * LANES + j]
        before = t1 if late == 0.0 else (t2 if late == 1.0 else t3)
        after = t0 if late == 0.0 else (t1 if late == 1.0 else t2)
        before = before if block[at.SPLIT * LANES + j] > 0.0 else after
        torque = block[at.TORQUE * LANES + j] if rate > 0.0 else before
        by_before, by_after = load_stages(block, at.BY_BEFORE, j), load_stages(block, at.BY_AFTER, j)
        torques = torques_of_two(torque, before, after, by_before, by_after)
        low, high = (before, after) if before < after else (after, before)
        low, high = torque if torque < low else low, torque if torque > high else high
        x, plant, drive = load_state(block, at.STATE, j), load_plant(block, j), load_drive(block, j)
        direction = 1.0 if x.motor_speed > 0.0 else (-1.0 if x.motor_speed < 0.0 else 0.0)
        angles = angles_of(x, plant, drive)
        step = driven_step(x, angles, torques, direction, CONTROL_PERIOD, plant, drive, model)
        needed = needed_rate(x, step.first.motor_speed, high - low, direction, plant, drive)
        _, steps = step_length(CONTROL_PERIOD, needed, block[at.SUBSTEPS * LANES + j])
        stays = stays_in_mode(x, step, direction, CONTROL_PERIOD, low, high, plant, drive, model)
        whole = (stays & (steps == 1.0)) | (block[at.DRIVEN * LANES + j] == 0.0)
        block[at.TORQUE * LANES + j] = torques.end if whole else torque
        work[_BEFORE * LANES + j] = before
        work[_AFTER * LANES + j] = after
        work[_WHOLE * LANES + j] = 1.0 if whole else 0.0
        store_state(block, at.STATE, j, _either(whole, step.state, x))


@compiled
def _gather(block: Floats, work: Floats, count: int) -> int:
    """Copy the marked arms to the front of `work`, at the beginning of their sample."""
    unfinished = 0.0  # counted first, because that loop is vectorised
    for j in range(count):
        unfinished += 1.0 - work[_WHOLE * LANES + j]
    if unfinished == 0.0:
        return 0
    pending = 0
    for j in range(count):
        if work[_WHOLE * LANES + j] == 0.0:
            for row in range(at.MOVE):
                work[row * LANES + pending] = block[row * LANES + j]
            work[_SUBSTEPS * LANES + pending] = block[at.SUBSTEPS * LANES + j]
            before, after = work[_BEFORE * LANES + j], work[_AFTER * LANES + j]
            split = block[at.SPLIT * LANES + j]
            work[_TORQUE * LANES + pending] = block[at.TORQUE * LANES + j]
            work[_BEFORE * LANES + pending] = before
            work[_AFTER * LANES + pending] = after
            work[_REMAINING * LANES + pending] = split
            work[_REMAINING_AFTER * LANES + pending] = CONTROL_PERIOD - split
            work[_DIRECTION * LANES + pending] = _UNKNOWN
            work[_LANE * LANES + pending] = j
            pending += 1
    return pending


@compiled
def _step(work: Floats, count: int, model: Model) -> None:
    """Take the next step of each arm; mark those that leave their mode, which keep the state that they began with."""
    for j in range(count):
        x = load_state(work, at.STATE, j)
        plant, drive = load_plant(work, j), load_drive(work, j)
        time, rate = work[at.LAG_TIME * LANES + j], work[at.LAG_RATE * LANES + j]
        arrives = work[_REMAINING * LANES + j] <= 0.0
        before, after = work[_BEFORE * LANES + j], work[_AFTER * LANES + j]
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
        dt, steps = step_length(remaining, needed, work[_SUBSTEPS * LANES + j])
        torques = torques_of_lag(lag, dt)
        step = driven_step(x, angles, torques, direction, dt, plant, drive, model)
        margin, _ = margin_of(x, angles, step, torques, lag, direction, dt, plant, drive, model)
        leaves = leaves_mode(margin, lag_left(lag, torques))
        work[_LEAVES * LANES + j] = 1.0 if leaves else 0.0
        work[_DT * LANES + j] = dt
        work[_DIRECTION * LANES + j] = direction
        store_state(work, at.STATE, j, _either(leaves, x, step.state))
        work[_TORQUE * LANES + j] = torque if leaves else torques.end
        left = remaining - dt if steps > 1.0 else 0.0
        left = remaining if leaves else left
        work[_BEFORE * LANES + j] = target
        work[_REMAINING * LANES + j] = left
        work[_REMAINING_AFTER * LANES + j] = 0.0 if arrives else last_piece


@compiled
def _change_modes(work: Floats, count: int, model: Model) -> None:
    """Step the marked arms to the instant at which they stop or break away; few, so one by one."""
    for j in range(count):
        if work[_LEAVES * LANES + j] != 0.0:
            x = load_state(work, at.STATE, j)
            plant, drive = load_plant(work, j), load_drive(work, j)
            target, dt = work[_BEFORE * LANES + j], work[_DT * LANES + j]
            time, rate = work[at.LAG_TIME * LANES + j], work[at.LAG_RATE * LANES + j]
            lag = Lag(target, work[_TORQUE * LANES + j] - target, time, rate)
            direction = work[_DIRECTION * LANES + j]
            z, torque, direction, passed = past_mode_change(x, lag, direction, dt, plant, drive, model)
            store_state(work, at.STATE, j, z)
            work[_TORQUE * LANES + j] = torque
            work[_DIRECTION * LANES + j] = direction
            work[_REMAINING * LANES + j] = max(work[_REMAINING * LANES + j] - passed, 0.0)


@compiled
def _put_back_finished(block: Floats, work: Floats, count: int) -> int:
    """Write the arms that are done to the lanes of `block` that they came from; close the ranks of the others."""
    pending = 0
    for i in range(count):
        if work[_REMAINING * LANES + i] + work[_REMAINING_AFTER * LANES + i] <= 0.0:
            lane = int(work[_LANE * LANES + i])
            store_state(block, at.STATE, lane, load_state(work, at.STATE, i))
            block[at.TORQUE * LANES + lane] = work[_TORQUE * LANES + i]
        else:
            if pending < i:
                for row in range(_ROWS):
                    work[row * LANES + pending] = work[row * LANES + i]
            pending += 1
    return pending


@compiled
def _pad(work: Floats, pending: int) -> int:
    """Fill up with copies of the first arm to whole vectors, since a remainder would be stepped one by one."""
    padded = -(-pending // _VECTOR) * _VECTOR
    for row in range(_ROWS):
        for i in range(pending, padded):
            work[row * LANES + i] = work[row * LANES]
    return padded
