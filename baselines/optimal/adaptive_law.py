"""Law of `baselines.optimal.adaptive` for one arm.

A slow processor may call the law's parts by themselves: `torque` needs what `begun` has found in the same sample, and
`renewed`, which seldom has something to do, may take until the next one. Where it takes longer, `spread_law` makes a
plan piece by piece.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from baselines.estimation.believed_arm import SIZE, other_torque
from baselines.estimation.filter_design import Design, Inputs, inputs_of
from baselines.estimation.identify import (
    Estimate,
    Notes,
    Workspace,
    empty_estimate,
    empty_notes,
    estimate,
    identify,
    workspace_for,
)
from baselines.models.friction import sliding_torque
from baselines.models.linear import write_linear_arm
from baselines.planning.plan import PLAN_COLUMNS, PlanCost, plan_backwards, step_of_plan, torque_between, torque_of_plan
from baselines.planning.replanning import is_stale
from baselines.planning.riccati import CostToGo, no_cost
from baselines.planning.task_plan import PlanRoom, plan_room, plan_squares, plan_task
from baselines.reading import Sample
from beltarm_env import EPISODE_STEPS
from beltarm_env.arm import FIELDS, plant_of
from beltarm_env.arrays import Floats, Integers
from beltarm_env.engine import compiled, inlined
from beltarm_env.task.reference import MoveShape


class Compensation(NamedTuple):
    """How friction is compensated."""

    share: float  # c
    speed: float  # of the motor, below which the plan decides on the direction [rad/s]
    width: float  # torque of the plan that is meant in full [N m]


@inlined
def compensated(of: Compensation, friction: float, speed: float, torque: float) -> float:
    """Compute the torque c tau_f dir [N m] that overcomes friction.

    Args:
        of: What is compensated.
        friction: Of a motor that slides forward [N m].
        speed: Of the motor [rad/s].
        torque: Asked of it beside that [N m].
    """
    asked = min(max(torque / of.width, -1.0), 1.0)
    direction = (1.0 if speed > 0.0 else -1.0) if abs(speed) > of.speed else asked
    return of.share * friction * direction


@compiled
def write_compensations(of: Compensation, friction: Floats, speed: Floats, torque: Floats, result: Floats) -> None:
    """Write what `compensated` says of n motors; arrays of shape (n,)."""
    for arm in range(len(torque)):
        result[arm] = compensated(of, friction[arm], speed[arm], torque[arm])


@inlined
def motor_torque(of: Compensation, planned: float, row: Floats, z: Floats, state: Floats) -> float:
    """Add to the torque of a plan [N m] what friction, ripple and d take.

    Args:
        of: What of friction is compensated.
        planned: By the plan [N m].
        row: Constants of the arm, shape (len(FIELDS),).
        z: Of the arm, shape (SIZE,) or (FELT_SIZE,).
        state: x at the time at which the torque acts, shape (4,).
    """
    friction, _ = sliding_torque(row, state)
    return planned + compensated(of, friction, state[1], planned) - other_torque(z, state[0], state[1])


@compiled
def write_motor_torques(
    of: Compensation, found: Estimate, mean: Floats, pairs: Floats, time: Floats, torques: Floats
) -> None:
    """Write the torques of n arms.

    Args:
        of: What of friction is compensated.
        found: What is estimated of the arms.
        mean: z of them, shape (n, SIZE or FELT_SIZE).
        pairs: Rows of their plans before and after the time, shape (n, 2, 10).
        time: At which the torques act, since the episode's start [samples], shape (n,).
        torques: [N m], shape (n,), written.
    """
    for arm in range(len(time)):
        _, share = step_of_plan(time[arm])
        state = found.states[arm]
        planned = torque_between(pairs[arm, 0], pairs[arm, 1], share, state, 0.0)  # the gain does not weigh its change
        torques[arm] = motor_torque(of, planned, found.table[arm], mean[arm], state)


class AdaptiveDesign(NamedTuple):
    """What is constant about the law for one arm."""

    filter: Design
    cost: PlanCost
    compensation: Compensation
    improvements: int  # steps by which the first plan is improved


class ArmMemory(NamedTuple):
    """Memory of the law for one arm."""

    notes: Notes  # what is known of it
    logs: Floats  # `Estimate.logs` that the plan was made for, shape (6,)
    plan: Floats  # shape (1200, 10)
    inputs: Inputs  # from here on, nothing has to be kept from sample to sample
    found: Estimate
    identification: Workspace
    planning: PlanRoom


def arm_memory() -> ArmMemory:
    """Memory for one arm."""
    found, inputs = empty_estimate(1), inputs_of(np.zeros(1), np.zeros(1), np.zeros(1, np.bool_))
    logs, plan = np.zeros(found.logs.shape[1]), np.zeros((EPISODE_STEPS, PLAN_COLUMNS))
    return ArmMemory(empty_notes(1, SIZE), logs, plan, inputs, found, workspace_for(1), plan_room())


@compiled
def begun(design: AdaptiveDesign | SpreadDesign, now: Sample, begins: bool, memory: ArmMemory | SpreadMemory) -> None:
    """Identify the arm; where an episode begins, plan its move, which takes much longer than a sample."""
    memory.inputs.angle[0], memory.inputs.command[0] = now.motor_angle, now.last_command
    memory.inputs.begins[0] = begins
    found = memory.found
    identify(design.filter, memory.inputs, memory.notes, memory.identification)
    estimate(design.filter, memory.notes, memory.identification, found)
    if begins:
        move, time = MoveShape(now.start, now.goal, now.duration, now.ramp_time), now.step + found.delay[0]
        row, state = found.table[0], found.states[0]
        plan_task(move, row, design.cost, time, state, design.improvements, memory.planning, memory.plan)
        for k in range(len(memory.logs)):
            memory.logs[k] = found.logs[0, k]


@compiled
def torque(design: AdaptiveDesign | SpreadDesign, now: Sample, memory: ArmMemory | SpreadMemory) -> float:
    """Torque [N m] by the plan, once `begun` has been there."""
    found = memory.found
    planned = torque_of_plan(memory.plan, now.step + found.delay[0], found.states[0], 0.0)
    return motor_torque(design.compensation, planned, found.table[0], memory.notes.tracks.mean[0], found.states[0])


@compiled
def renewed(design: AdaptiveDesign, now: Sample, memory: ArmMemory) -> None:
    """Plan the move anew where the plan is stale; it acts from the next sample on, so there is time for it."""
    found = memory.found
    if is_stale(now.step, found.logs[0], memory.logs):
        move = MoveShape(now.start, now.goal, now.duration, now.ramp_time)
        plan_squares(move, found.table[0], design.cost, now.step, memory.planning, memory.plan)
        for k in range(len(memory.logs)):
            memory.logs[k] = found.logs[0, k]


@compiled
def law(design: AdaptiveDesign, now: Sample, begins: bool, memory: ArmMemory) -> float:
    """Torque [N m] of one sample, before it is cut at its limit."""
    begun(design, now, begins, memory)
    result = torque(design, now, memory)
    renewed(design, now, memory)
    return result


class SpreadDesign(NamedTuple):
    """What is constant about the law that spreads plans made anew over samples; fields as of `AdaptiveDesign`."""

    filter: Design
    cost: PlanCost
    compensation: Compensation
    improvements: int
    rows: int  # samples of the plan that are made in one sample


class SpreadMemory(NamedTuple):
    """Memory of the law that spreads plans made anew; the first fields as of `ArmMemory`."""

    notes: Notes
    logs: Floats
    plan: Floats
    inputs: Inputs
    found: Estimate
    identification: Workspace
    planning: PlanRoom
    to_go: CostToGo  # of the plan that is being made
    row: Floats  # constants that it is made for, shape (len(FIELDS),)
    left: Integers  # samples of it that are left to make, shape (1,)


def spread_memory() -> SpreadMemory:
    """Memory for one arm."""
    return SpreadMemory(*arm_memory(), no_cost(5), np.zeros(len(FIELDS)), np.zeros(1, np.intp))


@compiled
def spread_law(design: SpreadDesign, now: Sample, begins: bool, memory: SpreadMemory) -> float:
    """As `law`, with plans made anew over several samples: for processors on which one takes longer than a sample.

    A plan is made from its end. Until the recursion is there, a sample has the plan of before.
    """
    begun(design, now, begins, memory)
    result = torque(design, now, memory)
    move, found, to_go = MoveShape(now.start, now.goal, now.duration, now.ramp_time), memory.found, memory.to_go
    if begins:
        memory.left[0] = 0
    if memory.left[0] > now.step:
        first = max(memory.left[0] - design.rows, now.step)
        plant, model = plant_of(memory.row), memory.planning.model
        plan_backwards(move, plant, model, design.cost, to_go, first, memory.left[0], memory.plan)
        memory.left[0] = first
    elif is_stale(now.step, found.logs[0], memory.logs):
        write_linear_arm(found.table[0], memory.planning.model)
        memory.row[:] = found.table[0]
        to_go.matrix[:] = 0.0
        to_go.vector[:] = 0.0
        memory.left[0] = len(memory.plan)
        for k in range(len(memory.logs)):
            memory.logs[k] = found.logs[0, k]
    return result
