"""Motion of a block of arms behind drives as they are built, over one control period.

A sample is cut where the command arrives (`command_latency`): two pieces, over each of which the motor tends to one
torque. All arms take a piece in one step side by side. Those whose motor stops or breaks away within it, or that turn
too fast for one step, are gathered in a block of their own and finish it there, step by step.

Arms with an ideal drive among them are moved by `advance`, as they are alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltarm_env.arm import COLUMN, Plant
from beltarm_env.jit import compiled, inlined
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.advance import WORK_ROWS, advance_block
from beltarm_env.kernels.layout import LANES, load_drive, load_plant, load_state, store_drive, store_state
from beltarm_env.physics.drive import DRIVE_COLUMNS, angles_of, drive_of
from beltarm_env.physics.driven import (
    driven_step,
    first_slope,
    lag_of,
    leaves_mode,
    margin_of,
    needed_rate,
    past_mode_change,
    step_length,
)
from beltarm_env.physics.models import Model, sliding_direction
from beltarm_env.physics.state import ArmState
from beltarm_env.timing import CONTROL_PERIOD, EPISODE_STEPS, LATENCY_SAMPLES

Floats = NDArray[np.float64]

MOST_STEPS = 20_000
"""Of a piece; an arm that takes more is left where it is."""

# Rows of the plant's coefficients that drift.
_VISCOUS_NOW = at.PLANT + Plant._fields.index("viscous_friction")
_COULOMB_NOW = at.PLANT + Plant._fields.index("coulomb_friction")

_VECTOR = 8  # arms that the widest vector units take at once

# Rows of the working block: as in `layout` up to SUBSTEPS, then
_TORQUE = at.SUBSTEPS + 1  # of the motor [N m]
_TARGET = _TORQUE + 1  # what it tends to [N m]
_DIRECTION = _TARGET + 1  # friction mode
_REMAINING = _DIRECTION + 1  # time left of the piece [s]
_LANE = _REMAINING + 1  # where the arm came from
_DT = _LANE + 1  # length of the step [s]
_LEAVES = _DT + 1  # whether it leaves its mode within the step
_ROWS = _LEAVES + 1
DRIVEN_WORK_ROWS = WORK_ROWS + _ROWS + 4  # and those of `advance`, and states of arms with an ideal drive


@inlined
def begin_drive(block: Floats, lane: int, row: Floats) -> None:
    """Put an arm's drive into its lane, with a motor without torque, from a row of constants, shape (len(FIELDS),)."""
    store_drive(block, lane, drive_of(row))
    effect = 0.0
    for k in DRIVE_COLUMNS:
        effect = 1.0 if row[k] != 0.0 else effect
    block[at.DRIVEN * LANES + lane] = effect
    lag = row[COLUMN.current_loop_time_constant]
    block[at.LAG_TIME * LANES + lane] = lag
    block[at.LAG_RATE * LANES + lane] = 1 / lag if lag > 0.0 else 0.0
    samples = row[COLUMN.command_latency] / CONTROL_PERIOD
    late = min(np.floor(samples), LATENCY_SAMPLES - 1.0)
    block[at.LATE * LANES + lane] = late
    block[at.SPLIT * LANES + lane] = min((samples - late) * CONTROL_PERIOD, CONTROL_PERIOD)
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
    for j in range(count):
        for k in range(LATENCY_SAMPLES, 0, -1):
            block[(at.TARGETS + k) * LANES + j] = block[(at.TARGETS + k - 1) * LANES + j]
        limit = load_plant(block, j).torque_limit
        block[at.TARGETS * LANES + j] = actions[j] * limit * block[at.GAIN * LANES + j]
        worn = 1 + block[at.DRIFT * LANES + j] * (block[at.STEP * LANES + j] + 0.5)
        block[_VISCOUS_NOW * LANES + j] = block[at.VISCOUS * LANES + j] * worn
        block[_COULOMB_NOW * LANES + j] = block[at.COULOMB * LANES + j] * worn
    latest = 0.0
    for j in range(count):
        latest = max(latest, block[at.SPLIT * LANES + j])
    for piece in range(0 if latest > 0.0 else 1, 2):
        _begin_piece(block, work, count, piece, model)
        _step(block, work, count, model)
        _change_modes(block, work, count, model)
        _put_back_all(block, work, count)
        pending = _close_ranks(block, work, count, True)
        for _ in range(MOST_STEPS):
            if pending == 0:
                break
            _step(work, work, _pad(work, pending), model)
            _change_modes(work, work, pending, model)
            _put_back_finished(block, work, pending)
            pending = _close_ranks(work, work, pending, False)


@compiled
def _begin_piece(block: Floats, work: Floats, count: int, piece: int, model: Model) -> None:
    for j in range(count):
        x = load_state(block, at.STATE, j)
        late, split = block[at.LATE * LANES + j], block[at.SPLIT * LANES + j]
        t0, t1 = block[at.TARGETS * LANES + j], block[(at.TARGETS + 1) * LANES + j]
        t2, t3 = block[(at.TARGETS + 2) * LANES + j], block[(at.TARGETS + 3) * LANES + j]
        before = t1 if late == 0.0 else (t2 if late == 1.0 else t3)
        after = t0 if late == 0.0 else (t1 if late == 1.0 else t2)
        target = before if piece == 0 else after
        torque = block[at.TORQUE * LANES + j] if block[at.LAG_RATE * LANES + j] > 0.0 else target
        store_state(work, at.STATE, j, x)
        work[_TORQUE * LANES + j] = torque
        work[_TARGET * LANES + j] = target
        work[_REMAINING * LANES + j] = split if piece == 0 else CONTROL_PERIOD - split
        work[_DIRECTION * LANES + j] = sliding_direction(x, torque, load_plant(block, j), model, load_drive(block, j))
        work[_LANE * LANES + j] = j


@compiled
def _step(arms: Floats, work: Floats, count: int, model: Model) -> None:
    """Take the next step of each arm in `work`, whose coefficients are in `arms`; mark those that leave their mode.

    Those keep the state that they began the step with.
    """
    for j in range(count):
        x = load_state(work, at.STATE, j)
        plant, drive = load_plant(arms, j), load_drive(arms, j)
        torque, direction = work[_TORQUE * LANES + j], work[_DIRECTION * LANES + j]
        remaining = work[_REMAINING * LANES + j]
        time, rate = arms[at.LAG_TIME * LANES + j], arms[at.LAG_RATE * LANES + j]
        angles = angles_of(x, plant, drive)
        lag = lag_of(torque, work[_TARGET * LANES + j], time, rate, direction, angles, plant, model)
        k1 = first_slope(x, angles, lag, direction, plant, drive, model)
        needed = needed_rate(x, k1.motor_speed, lag, direction, plant, drive)
        dt, steps = step_length(remaining, needed, arms[at.SUBSTEPS * LANES + j])
        step = driven_step(x, angles, k1, lag, direction, dt, plant, drive, model)
        margin, _ = margin_of(x, angles, step, lag, direction, dt, plant, drive, model)
        leaves = leaves_mode(margin, step.decayed)
        work[_LEAVES * LANES + j] = 1.0 if leaves else 0.0
        work[_DT * LANES + j] = dt
        y = step.state
        store_state(
            work,
            at.STATE,
            j,
            ArmState(
                x.motor_angle if leaves else y.motor_angle,
                x.motor_speed if leaves else y.motor_speed,
                x.torsion if leaves else y.torsion,
                x.torsion_speed if leaves else y.torsion_speed,
            ),
        )
        work[_TORQUE * LANES + j] = torque if leaves else step.torque
        left = remaining - dt if steps > 1.0 else 0.0
        work[_REMAINING * LANES + j] = remaining if leaves else left


@compiled
def _change_modes(arms: Floats, work: Floats, count: int, model: Model) -> None:
    """Step the marked arms to the instant at which they stop or break away; few, so one by one."""
    for j in range(count):
        if work[_LEAVES * LANES + j] != 0.0:
            x = load_state(work, at.STATE, j)
            plant, drive = load_plant(arms, j), load_drive(arms, j)
            torque, direction = work[_TORQUE * LANES + j], work[_DIRECTION * LANES + j]
            time, rate = arms[at.LAG_TIME * LANES + j], arms[at.LAG_RATE * LANES + j]
            target, dt = work[_TARGET * LANES + j], work[_DT * LANES + j]
            lag = lag_of(torque, target, time, rate, direction, angles_of(x, plant, drive), plant, model)
            z, torque, direction, passed = past_mode_change(x, lag, direction, dt, plant, drive, model)
            store_state(work, at.STATE, j, z)
            work[_TORQUE * LANES + j] = torque
            work[_DIRECTION * LANES + j] = direction
            work[_REMAINING * LANES + j] = max(work[_REMAINING * LANES + j] - passed, 0.0)


@compiled
def _put_back_all(block: Floats, work: Floats, count: int) -> None:
    """Write all arms to `block`, in which they have the same lanes; those that are not done come again."""
    for j in range(count):
        store_state(block, at.STATE, j, load_state(work, at.STATE, j))
        block[at.TORQUE * LANES + j] = work[_TORQUE * LANES + j]


@compiled
def _put_back_finished(block: Floats, work: Floats, count: int) -> None:
    """Write the arms that are done to the lanes of `block` that they came from."""
    for i in range(count):
        if work[_REMAINING * LANES + i] <= 0.0:
            lane = int(work[_LANE * LANES + i])
            store_state(block, at.STATE, lane, load_state(work, at.STATE, i))
            block[at.TORQUE * LANES + lane] = work[_TORQUE * LANES + i]


@compiled
def _close_ranks(arms: Floats, work: Floats, count: int, move_all: bool) -> int:
    """Close the ranks in `work` to the arms that are not done.

    Their coefficients come from `arms`: those of all of them, or, where that is `work` itself, of those that move up.
    """
    unfinished = 0  # counted first, because that loop is vectorised
    for i in range(count):
        unfinished += 1 if work[_REMAINING * LANES + i] > 0.0 else 0
    if unfinished == 0:
        return 0
    pending = 0
    for i in range(count):
        if work[_REMAINING * LANES + i] > 0.0:
            if pending < i:
                for row in range(at.PLANT):
                    work[row * LANES + pending] = work[row * LANES + i]
                for row in range(_TORQUE, _ROWS):
                    work[row * LANES + pending] = work[row * LANES + i]
            if move_all | (pending < i):
                for row in range(at.PLANT, at.MOVE):
                    work[row * LANES + pending] = arms[row * LANES + i]
                work[at.SUBSTEPS * LANES + pending] = arms[at.SUBSTEPS * LANES + i]
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
