"""Motion of a block of arms over one control period.

All arms of a block take the step side by side. Those whose motor stops or breaks away within it are gathered in a block
of their own, stepped to that instant side by side, and then over what is left; few need that twice.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltarm_env.engine import compiled
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.layout import LANES, load_plant, load_state, store_state, whole_vectors
from beltarm_env.kernels.runge_kutta import DIRECTION, DT, NEXT, RK4_ROWS, TORQUE, rk4_steps
from beltarm_env.physics.integrator import mode_change, mode_margin
from beltarm_env.physics.models import Model, sliding_direction
from beltarm_env.physics.state import ArmState
from beltarm_env.timing import CONTROL_PERIOD

Floats = NDArray[np.float64]

MAX_MODE_CHANGES = 8
"""Within one integration step; more than two or three do not occur, and the rest would be taken in the last mode."""

# Rows of the working block: as in `runge_kutta`, then
_MARGIN = RK4_ROWS  # negative once the mode has been left
_LANE = _MARGIN + 1  # where the arm came from
_SIDE = _LANE + 1  # to which a motor at rest breaks away
_REST = _SIDE + 1  # time that is left once the mode has changed [s]
WORK_ROWS = _REST + 1


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
        x, plant = load_state(block, at.STATE, j), load_plant(block, j)
        substeps = block[at.SUBSTEPS * LANES + j]
        torque = actions[j] * plant.torque_limit
        work[TORQUE * LANES + j] = torque
        work[DIRECTION * LANES + j] = sliding_direction(x, torque, plant, model)
        work[DT * LANES + j] = CONTROL_PERIOD / substeps if substep < substeps else 0.0
    rk4_steps(block, work, count, model)
    for j in range(count):
        x, y = load_state(block, at.STATE, j), load_state(work, NEXT, j)
        torque, direction = work[TORQUE * LANES + j], work[DIRECTION * LANES + j]
        work[_MARGIN * LANES + j] = mode_margin(y, torque, direction, load_plant(block, j), model)
        store_state(work, at.STATE, j, x)
        store_state(block, at.STATE, j, y)


@compiled
def _gather_unfinished(block: Floats, work: Floats, count: int) -> int:
    """Close the ranks in `work` to the arms that left their friction mode within the step."""
    pending = 0
    for j in range(count):  # without a branch, which would be mispredicted again and again
        work[_LANE * LANES + pending] = j
        pending += 1 if work[_MARGIN * LANES + j] < 0.0 else 0
    for i in range(pending):
        lane = int(work[_LANE * LANES + i])
        for row in range(at.PLANT):
            work[row * LANES + i] = work[row * LANES + lane]
            work[(NEXT + row) * LANES + i] = block[row * LANES + lane]
        for row in range(at.PLANT, at.KINEMATICS):
            work[row * LANES + i] = block[row * LANES + lane]
        for row in range(TORQUE, NEXT):
            work[row * LANES + i] = work[row * LANES + lane]
    return pending


@compiled
def _pad(work: Floats, pending: int) -> int:
    """Fill up with copies of the first arm to whole vectors."""
    padded = whole_vectors(pending)
    for i in range(pending, padded):
        for row in range(at.KINEMATICS):
            work[row * LANES + i] = work[row * LANES]
        for row in range(TORQUE, NEXT + 4):
            work[row * LANES + i] = work[row * LANES]
    return padded


@compiled
def _step_past_mode_change(work: Floats, pending: int, model: Model) -> None:
    """Step to the instant of stopping or breaking away, then over the rest in the mode that follows."""
    for i in range(pending):
        x, y, plant = load_state(work, at.STATE, i), load_state(work, NEXT, i), load_plant(work, i)
        torque, direction, dt = work[TORQUE * LANES + i], work[DIRECTION * LANES + i], work[DT * LANES + i]
        fraction, side = mode_change(x, torque, direction, dt, y, plant, model)
        work[_SIDE * LANES + i] = side
        work[_REST * LANES + i] = dt - fraction * dt
        work[DT * LANES + i] = fraction * dt
    rk4_steps(work, work, pending, model)
    for i in range(pending):
        z, torque, direction = load_state(work, NEXT, i), work[TORQUE * LANES + i], work[DIRECTION * LANES + i]
        at_rest = ArmState(z.motor_angle, 0.0, z.torsion, z.torsion_speed)
        stopped = sliding_direction(at_rest, torque, load_plant(work, i), model)
        work[DIRECTION * LANES + i] = stopped if direction != 0.0 else work[_SIDE * LANES + i]
        work[DT * LANES + i] = work[_REST * LANES + i]
        store_state(work, at.STATE, i, at_rest)
    rk4_steps(work, work, pending, model)


@compiled
def _put_back_finished(block: Floats, work: Floats, pending: int, model: Model) -> int:
    """Write the arms that stayed in their mode to `block` and close the ranks of the others."""
    unfinished = 0
    for i in range(pending):
        y = load_state(work, NEXT, i)
        torque, direction = work[TORQUE * LANES + i], work[DIRECTION * LANES + i]
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
    store_state(block, at.STATE, lane, load_state(work, NEXT, i))
