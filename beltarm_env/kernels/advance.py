"""Motion of a block of arms over one control period.

All arms take the sample in one step, side by side. Those whose motor may stop or break away within it, or that need
shorter steps, are left to `pieces`. An ideal drive is None: the same source gives code without any of a real drive's
effects. Arms with an ideal drive among others are moved by that code, as they are alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltarm_env.arm import Plant
from beltarm_env.engine import compiled
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.layout import (
    IDEAL,
    LANES,
    REAL,
    RealDrive,
    drive_among,
    load_plant,
    load_stages,
    load_state,
    store_state,
)
from beltarm_env.kernels.pieces import AFTER, BEFORE, PIECE_ROWS, SUSPECT, WHOLE, either, take_part, take_pieces
from beltarm_env.physics.drive import angles_of
from beltarm_env.physics.events import stays_in_mode
from beltarm_env.physics.friction import mode_of_giving
from beltarm_env.physics.models import Arm, Model
from beltarm_env.physics.step import needed_rate, rk4_step, step_length
from beltarm_env.physics.torque import steady, torques_of_two
from beltarm_env.timing import CONTROL_PERIOD

Floats = NDArray[np.float64]

# Rows of the plant's coefficients that drift.
_VISCOUS_NOW = at.PLANT + Plant._fields.index("viscous_friction")
_COULOMB_NOW = at.PLANT + Plant._fields.index("coulomb_friction")
_LIMIT = at.PLANT + Plant._fields.index("torque_limit")

REAL_WORK_ROWS = PIECE_ROWS
WORK_ROWS = PIECE_ROWS + 4
"""Rows of `pieces`, and states of arms with an ideal drive."""


@compiled
def advance_block(
    block: Floats, work: Floats, actions: Floats, count: int, model: Model, real_drive: RealDrive
) -> None:
    """Advance the first `count` arms of a block by one control period.

    Args:
        block: As `layout` describes.
        work: Room for WORK_ROWS rows.
        actions: Torques commanded, over their limits, shape (LANES,).
        count: Number of arms.
        model: Whose equations of motion.
        real_drive: Whether real drives are among the arms.
    """
    if real_drive is IDEAL:
        _advance(block, work, actions, count, model, IDEAL)
        return
    real = 0.0
    for j in range(count):
        real += block[at.REAL_DRIVE * LANES + j]
    if real == 0.0:
        _advance(block, work, actions, count, model, IDEAL)
        return
    kept = work[PIECE_ROWS * LANES :]
    if real < count:
        for j in range(count):
            store_state(kept, 0, j, load_state(block, at.STATE, j))
        _advance(block, work, actions, count, model, IDEAL)
        for j in range(count):  # a moved arm where the drive is ideal, where it was elsewhere
            x, y = load_state(kept, 0, j), load_state(block, at.STATE, j)
            store_state(block, at.STATE, j, x)
            store_state(kept, 0, j, y)
    advance_real_block(block, work, actions, count, model)
    if real < count:
        for j in range(count):
            if block[at.REAL_DRIVE * LANES + j] == 0.0:
                store_state(block, at.STATE, j, load_state(kept, 0, j))


@compiled
def advance_real_block(block: Floats, work: Floats, actions: Floats, count: int, model: Model) -> None:
    """Advance the first `count` arms of a block by one control period, none of which has an ideal drive.

    Its C has no equations of ideal drives. Arguments are those of `advance_block`, with room for REAL_WORK_ROWS rows.
    """
    _advance(block, work, actions, count, model, REAL)


@compiled
def advance_part(block: Floats, work: Floats, actions: Floats, duration: float, model: Model) -> None:
    """Advance the arm of the first lane by the first `duration` seconds of a control period, whatever its drive.

    An arm with an ideal drive moves as one behind a drive without any effect. Arguments are those of
    `advance_real_block`.
    """
    torque, deflection, x = block[at.TORQUE * LANES], block[at.DEFLECTION * LANES], load_state(block, at.STATE, 0)
    _take_whole_step(block, work, actions, 1, model, REAL)
    block[at.TORQUE * LANES], block[at.DEFLECTION * LANES] = torque, deflection
    store_state(block, at.STATE, 0, x)
    work[WHOLE * LANES] = 0.0
    take_part(block, work, duration, model)


@compiled
def _advance(block: Floats, work: Floats, actions: Floats, count: int, model: Model, real_drive: RealDrive) -> None:
    _take_whole_step(block, work, actions, count, model, real_drive)
    take_pieces(block, work, count, model, real_drive)


@compiled
def _take_whole_step(
    block: Floats, work: Floats, actions: Floats, count: int, model: Model, real_drive: RealDrive
) -> None:
    """Take the whole sample in one step; mark the arms for which that may not do, and leave them where they are."""
    for j in range(count):
        after = actions[j] * block[_LIMIT * LANES + j]
        before, torques, low, high, torque, deflection = after, steady(after), after, after, after, 0.0
        if real_drive is not IDEAL:
            shift = at.TARGETS * LANES + j
            t3, t2, t1 = block[shift + 2 * LANES], block[shift + LANES], block[shift]
            t0 = after * block[at.GAIN * LANES + j]
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
            deflection = block[at.DEFLECTION * LANES + j]
        x, drive = load_state(block, at.STATE, j), drive_among(block, j, real_drive)
        arm = Arm(load_plant(block, j), drive, model)
        direction = 1.0 if x.motor_speed > 0.0 else (-1.0 if x.motor_speed < 0.0 else 0.0)
        if drive is not None:
            direction = mode_of_giving(deflection) if drive.spring > 0.0 else direction
        angles = angles_of(x, arm.plant, drive, deflection)
        needed = needed_rate(x, angles, torque, high - low, direction, arm)
        _, steps = step_length(CONTROL_PERIOD, needed, block[at.SUBSTEPS * LANES + j])
        step = rk4_step(x, angles, torques, direction, CONTROL_PERIOD, arm)
        stays = stays_in_mode(step, low, high, arm)
        whole = stays & (steps == 1.0)
        work[BEFORE * LANES + j] = before
        work[AFTER * LANES + j] = after
        work[SUSPECT * LANES + j] = 0.0 if stays else 1.0
        if drive is not None:
            whole = whole | (block[at.REAL_DRIVE * LANES + j] == 0.0)
            gave = step.end.motor_angle - x.motor_angle if direction == 0.0 else 0.0
            moved = (drive.spring > 0.0) & whole
            block[at.TORQUE * LANES + j] = torques.end if whole else torque
            block[at.DEFLECTION * LANES + j] = deflection + gave if moved else deflection
        work[WHOLE * LANES + j] = 1.0 if whole else 0.0
        store_state(block, at.STATE, j, either(whole, step.end, x))
