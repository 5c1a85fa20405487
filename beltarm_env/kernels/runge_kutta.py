"""Runge-Kutta steps of many arms side by side, stage by stage.

A stage is a chain of operations that wait for each other. So the loop over arms is inside the stages: a processor works
on several vectors of arms at a time, where it would wait for one on its way through all four.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltarm_env.engine import inlined
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.layout import LANES, load_plant, load_state, store_state
from beltarm_env.physics.integrator import moved, slope_of, weighted
from beltarm_env.physics.models import Model
from beltarm_env.physics.state import ArmState

Floats = NDArray[np.float64]

# Rows of the working block: state and plant as in `layout`, then
TORQUE = at.MOVE  # [N m]
DIRECTION = TORQUE + 1  # friction mode
DT = DIRECTION + 1  # length of the step [s]
NEXT = DT + 1  # state after the step
_STAGES = NEXT + 4  # states of the second to the last stage
_SLOPES = _STAGES + 3 * 4  # accelerations of motor and torsion in all stages but the last
RK4_ROWS = _SLOPES + 3 * 2


@inlined
def _load_slope(work: Floats, stage: int, lane: int, x: ArmState) -> ArmState:
    """Load the slope of a stage, whose state is x."""
    place = (_SLOPES + 2 * stage) * LANES + lane
    return ArmState(x.motor_speed, work[place], x.torsion_speed, work[place + LANES])


@inlined
def _slope_at(x: ArmState, arms: Floats, work: Floats, lane: int, model: Model) -> ArmState:
    torque, direction = work[TORQUE * LANES + lane], work[DIRECTION * LANES + lane]
    return slope_of(x, torque, direction, load_plant(arms, lane), model)


@inlined
def _end_stage(arms: Floats, work: Floats, stage: int, share: float, lane: int, slope: ArmState) -> None:
    """Write the slope of a stage, 0 to 2, and the state of the next: a share of the step on by it."""
    place = (_SLOPES + 2 * stage) * LANES + lane
    work[place], work[place + LANES] = slope.motor_speed, slope.torsion_speed
    following = moved(load_state(arms, at.STATE, lane), share * work[DT * LANES + lane], slope)
    store_state(work, _STAGES + 4 * stage, lane, following)


@inlined
def rk4_steps(arms: Floats, work: Floats, count: int, model: Model) -> None:
    """Take classical fourth-order Runge-Kutta steps within one friction mode, torque held, from STATE to NEXT.

    Args:
        arms: Block with states and plants as `layout` describes.
        work: Working block, with torques, friction modes and lengths of the steps; changed. It may be `arms`.
        count: Number of arms, which are the first.
        model: Whose equations of motion.
    """
    for j in range(count):
        _end_stage(arms, work, 0, 0.5, j, _slope_at(load_state(arms, at.STATE, j), arms, work, j, model))
    for j in range(count):
        _end_stage(arms, work, 1, 0.5, j, _slope_at(load_state(work, _STAGES, j), arms, work, j, model))
    for j in range(count):
        _end_stage(arms, work, 2, 1.0, j, _slope_at(load_state(work, _STAGES + 4, j), arms, work, j, model))
    for j in range(count):
        x, second, third = load_state(arms, at.STATE, j), load_state(work, _STAGES, j), load_state(work, _STAGES + 4, j)
        k1, k2 = _load_slope(work, 0, j, x), _load_slope(work, 1, j, second)
        k3 = _load_slope(work, 2, j, third)
        k4 = _slope_at(load_state(work, _STAGES + 8, j), arms, work, j, model)
        store_state(work, NEXT, j, moved(x, work[DT * LANES + j] * (1 / 6), weighted(k1, k2, k3, k4)))
