"""Motion of a block of arms behind drives as they are built, over one control period.

All arms take the sample in one step, side by side. Those whose motor may stop or break away within it, or that need
shorter steps, are left to `driven_pieces`.

Arms with an ideal drive among them are moved by `advance`, as they are alone.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltarm_env.arm import COLUMN, Plant
from beltarm_env.engine import compiled, inlined
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.advance import WORK_ROWS, advance_block
from beltarm_env.kernels.driven_pieces import AFTER, BEFORE, PIECE_ROWS, WHOLE, either, take_part, take_pieces
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
from beltarm_env.physics.driven.events import stays_in_mode
from beltarm_env.physics.driven.step import driven_step, needed_rate, step_length
from beltarm_env.physics.driven.torque import shares_of_two, torques_of_two
from beltarm_env.physics.models import Model
from beltarm_env.timing import CONTROL_PERIOD, EPISODE_STEPS, LATENCY_SAMPLES, SHORTEST_LAG

Floats = NDArray[np.float64]

# Rows of the plant's coefficients that drift.
_VISCOUS_NOW = at.PLANT + Plant._fields.index("viscous_friction")
_COULOMB_NOW = at.PLANT + Plant._fields.index("coulomb_friction")
_LIMIT = at.PLANT + Plant._fields.index("torque_limit")

BUILT_WORK_ROWS = PIECE_ROWS
DRIVEN_WORK_ROWS = WORK_ROWS + BUILT_WORK_ROWS + 4
"""Rows of `advance`, those of `driven_pieces`, and states of arms with an ideal drive."""


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
    lag = lag if lag >= SHORTEST_LAG else 0.0
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
    kept = work[(WORK_ROWS + BUILT_WORK_ROWS) * LANES :]
    if built < count:
        for j in range(count):
            store_state(kept, 0, j, load_state(block, at.STATE, j))
        advance_block(block, work, actions, count, model)
        for j in range(count):  # a moved arm where the drive is ideal, where it was elsewhere
            x, y = load_state(kept, 0, j), load_state(block, at.STATE, j)
            store_state(block, at.STATE, j, x)
            store_state(kept, 0, j, y)
    advance_built_block(block, work[WORK_ROWS * LANES :], actions, count, model)
    if built < count:
        for j in range(count):
            if block[at.DRIVEN * LANES + j] == 0.0:
                store_state(block, at.STATE, j, load_state(kept, 0, j))


@compiled
def advance_built_block(block: Floats, work: Floats, actions: Floats, count: int, model: Model) -> None:
    """Advance the first `count` arms of a block by one control period, none of which has an ideal drive.

    Its C has no equations of ideal drives. Arguments are those of `advance_driven_block`, with room for
    BUILT_WORK_ROWS rows.
    """
    _take_whole_step(block, work, actions, count, model)
    take_pieces(block, work, count, model)


@compiled
def advance_part(block: Floats, work: Floats, actions: Floats, duration: float, model: Model) -> None:
    """Advance the arm of the first lane by the first `duration` seconds of a control period, whatever its drive.

    An arm with an ideal drive moves as one behind a drive without any effect. Arguments are those of
    `advance_built_block`.
    """
    torque, x = block[at.TORQUE * LANES], load_state(block, at.STATE, 0)
    _take_whole_step(block, work, actions, 1, model)
    block[at.TORQUE * LANES] = torque
    store_state(block, at.STATE, 0, x)
    work[WHOLE * LANES] = 0.0
    take_part(block, work, duration, model)


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
        work[BEFORE * LANES + j] = before
        work[AFTER * LANES + j] = after
        work[WHOLE * LANES + j] = 1.0 if whole else 0.0
        store_state(block, at.STATE, j, either(whole, step.state, x))
