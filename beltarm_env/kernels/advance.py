"""Motion of a block of arms over one control period.

All arms of a block take the step side by side. Those whose motor stops or breaks away within it are gathered in a block
of their own, stepped to that instant side by side, and then over what is left; few need that twice.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltarm_env.jit import compiled
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.layout import LANES, load_plant, load_state, store_state
from beltarm_env.physics.integrator import mode_margin, rk4_step, step_to_mode_change
from beltarm_env.physics.models import Model, sliding_direction
from beltarm_env.timing import CONTROL_PERIOD

Floats = NDArray[np.float64]

MAX_MODE_CHANGES = 8
"""Within one integration step; more than two or three do not occur, and the rest would be taken in the last mode."""

_VECTOR = 8  # arms that the widest vector units take at once

# Rows of the working block: state and plant as in `layout`, then
_TORQUE = at.MOVE  # [N m]
_DIRECTION = _TORQUE + 1  # friction mode
_REMAINING = _DIRECTION + 1  # time left of the step [s]
_NEXT = _REMAINING + 1  # state after the whole step in this mode
_MARGIN = _NEXT + 4  # negative once the mode has been left
_LANE = _MARGIN + 1  # where the arm came from
WORK_ROWS = _LANE + 1


@compiled
def advance_block(block: Floats, work: Floats, actions: Floats, count: int, model: Model) -> None:
    """Advance the first `count` arms of a block by one control period.

    Args:
        block: As `layout` describes.
        work: Room for WORK_ROWS rows.
        actions: Motor torques over their limits, shape (LANES,).
        count: Number of arms.
        model: Whose equations of motion.
    """
    for substep in range(_most_substeps(block, count)):
        _step(block, work, actions, count, substep, model)
        pending = _gather_unfinished(block, work, count)
        for _ in range(MAX_MODE_CHANGES):
            if pending == 0:
                break
            _step_past_mode_change(work, _pad(work, pending), model)
            pending = _put_back_finished(block, work, pending, model)
        for i in range(pending):
            _put_back(block, work, i)


@compiled
def _most_substeps(block: Floats, count: int) -> int:
    stiff = 0  # counted first, because that loop is vectorised and hardly ever finds one
    for j in range(count):
        stiff += 1 if block[at.SUBSTEPS * LANES + j] > 1.0 else 0
    if stiff == 0:
        return 1
    most = 1.0
    for j in range(count):
        most = max(most, block[at.SUBSTEPS * LANES + j])
    return int(most)


@compiled
def _step(block: Floats, work: Floats, actions: Floats, count: int, substep: int, model: Model) -> None:
    """Step all arms in the friction mode they begin in, keeping the states before the step in `work`.

    An arm that needs fewer substeps takes one of no length.
    """
    for j in range(count):
        x = load_state(block, at.STATE, j)
        plant = load_plant(block, j)
        substeps = block[at.SUBSTEPS * LANES + j]
        dt = CONTROL_PERIOD / substeps if substep < substeps else 0.0
        torque = actions[j] * plant.torque_limit
        direction = sliding_direction(x, torque, plant, model)
        work[_TORQUE * LANES + j] = torque
        work[_DIRECTION * LANES + j] = direction
        work[_REMAINING * LANES + j] = dt
        y = rk4_step(x, torque, direction, dt, plant, model)
        work[_MARGIN * LANES + j] = mode_margin(y, torque, direction, plant, model)
        store_state(work, at.STATE, j, x)
        store_state(block, at.STATE, j, y)


@compiled
def _gather_unfinished(block: Floats, work: Floats, count: int) -> int:
    """Close the ranks in `work` to the arms that left their friction mode within the step."""
    pending = 0
    for j in range(count):
        if work[_MARGIN * LANES + j] < 0.0:
            for row in range(at.PLANT):
                work[row * LANES + pending] = work[row * LANES + j]
                work[(_NEXT + row) * LANES + pending] = block[row * LANES + j]
            for row in range(at.PLANT, at.KINEMATICS):
                work[row * LANES + pending] = block[row * LANES + j]
            for row in range(_TORQUE, _NEXT):
                work[row * LANES + pending] = work[row * LANES + j]
            work[_LANE * LANES + pending] = j
            pending += 1
    return pending


@compiled
def _pad(work: Floats, pending: int) -> int:
    """Fill up with copies of the first arm to whole vectors, since a remainder would be stepped one by one."""
    padded = -(-pending // _VECTOR) * _VECTOR
    for row in range(WORK_ROWS):
        for i in range(pending, padded):
            work[row * LANES + i] = work[row * LANES]
    return padded


@compiled
def _step_past_mode_change(work: Floats, pending: int, model: Model) -> None:
    """Step to the instant of stopping or breaking away, then over the rest in the mode that follows."""
    for i in range(pending):
        x = load_state(work, at.STATE, i)
        y = load_state(work, _NEXT, i)
        torque = work[_TORQUE * LANES + i]
        plant = load_plant(work, i)
        z, direction, remaining = step_to_mode_change(
            x, torque, work[_DIRECTION * LANES + i], work[_REMAINING * LANES + i], y, plant, model
        )
        store_state(work, at.STATE, i, z)
        store_state(work, _NEXT, i, rk4_step(z, torque, direction, remaining, plant, model))
        work[_DIRECTION * LANES + i] = direction
        work[_REMAINING * LANES + i] = remaining


@compiled
def _put_back_finished(block: Floats, work: Floats, pending: int, model: Model) -> int:
    """Write the arms that stayed in their mode to `block` and close the ranks of the others."""
    unfinished = 0
    for i in range(pending):
        y = load_state(work, _NEXT, i)
        torque, direction = work[_TORQUE * LANES + i], work[_DIRECTION * LANES + i]
        margin = mode_margin(y, torque, direction, load_plant(work, i), model)
        if margin < 0.0:
            for row in range(WORK_ROWS):
                work[row * LANES + unfinished] = work[row * LANES + i]
            unfinished += 1
        else:
            _put_back(block, work, i)
    return unfinished


@compiled
def _put_back(block: Floats, work: Floats, i: int) -> None:
    lane = int(work[_LANE * LANES + i])
    store_state(block, at.STATE, lane, load_state(work, _NEXT, i))
