"""Law of `baselines.optimal.adaptive` for one arm.

A slow processor may call the law's parts by themselves: `torque` needs what `begun` has found in the same sample, and
`renewed`, which seldom has something to do, may take until the next one. Where it takes longer, a plan is made piece by
piece.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from baselines.estimation.believed_arm import LOGS, SIZE, other_torque
from baselines.estimation.filter_design import Design, Inputs, Room, empty_inputs, room_for, write_inputs
from baselines.estimation.identification import Belief, Estimate, empty_belief, empty_estimate, estimate, identify
from baselines.models.friction import sliding_torque
from baselines.models.linear import write_linear_arm
from baselines.planning.plan import (
    PLAN_COLUMNS,
    Weights,
    plan_backwards,
    problem_of,
    step_of_plan,
    torque_between,
    torque_of_plan,
)
from baselines.planning.replanning import is_stale, steps_of
from baselines.planning.riccati import CostToGo, no_cost
from baselines.planning.task_plan import PlanRoom, Start, plan_room, plan_task, refine
from baselines.reading import Sample, move_of
from beltarm_env import EPISODE_STEPS
from beltarm_env.arm import FIELDS
from beltarm_env.arrays import Floats, Integers
from beltarm_env.engine import compiled, inlined


class Compensation(NamedTuple):
    """How friction is compensated."""

    share: float  # c
    width: float  # torque of the plan that is meant in full [N m]


@inlined
def compensated(of: Compensation, friction: float, direction: float, torque: float) -> float:
    """Compute the torque c tau_f dir [N m] that overcomes friction.

    Args:
        of: What is compensated.
        friction: Of a motor that slides forward [N m].
        direction: In which it slides, -1 or 1; 0 where it sticks, and the torque decides.
        torque: Asked of it beside that [N m].
    """
    return of.share * friction * (direction if direction != 0.0 else min(max(torque / of.width, -1.0), 1.0))


@inlined
def motor_torque(of: Compensation, planned: float, row: Floats, z: Floats, state: Floats, direction: float) -> float:
    """Add to the torque of a plan [N m] what friction, ripple and d take.

    Args:
        of: What of friction is compensated.
        planned: By the plan [N m].
        row: Constants of the arm, shape (len(FIELDS),).
        z: Of the arm, shape (SIZE,) or (ACCELEROMETER_SIZE,).
        state: x at the time at which the torque acts, shape (4,).
        direction: Friction mode then.
    """
    friction, _ = sliding_torque(row, state)
    return planned + compensated(of, friction, direction, planned) - other_torque(z, state[0], state[1])


@compiled
def write_motor_torques(
    of: Compensation, found: Estimate, mean: Floats, pairs: Floats, time: Floats, torques: Floats
) -> None:
    """Write the torques of n arms.

    Args:
        of: What of friction is compensated.
        found: What is estimated of the arms.
        mean: z of them, shape (n, SIZE or ACCELEROMETER_SIZE).
        pairs: Rows of their plans before and after the time, shape (n, 2, 10).
        time: At which the torques act, since the move's start [samples], shape (n,).
        torques: [N m], shape (n,), written.
    """
    for arm in range(len(time)):
        _, share = step_of_plan(time[arm])
        state = found.states[arm]
        planned = torque_between(pairs[arm, 0], pairs[arm, 1], share, state, 0.0)  # the gain does not weigh its change
        torques[arm] = motor_torque(of, planned, found.table[arm], mean[arm], state, found.direction[arm])


class AdaptiveDesign(NamedTuple):
    """What is constant about the law for one arm."""

    filter: Design
    weights: Weights
    compensation: Compensation
    improvements: int  # steps by which the first plan is improved, and at most those around the reference's end
    rows: int  # most samples of a plan made anew that are planned in one sample


class ArmMemory(NamedTuple):
    """Memory of the law for one arm."""

    belief: Belief  # what is known of it
    logs: Floats  # `Estimate.logs` that the plan was made for, shape (6,)
    plan: Floats  # shape (1200, 10)
    to_go: CostToGo  # of the plan that is being made anew
    row: Floats  # constants that it is made for, shape (len(FIELDS),)
    left: Integers  # samples of it that are left to plan, shape (1,)
    inputs: Inputs  # from here on, nothing is kept from sample to sample, but `planning.model` while a plan is made
    found: Estimate
    identification: Room
    planning: PlanRoom


def arm_memory() -> ArmMemory:
    """Memory for one arm."""
    found, logs = empty_estimate(1), np.zeros(LOGS.stop - LOGS.start)
    return ArmMemory(
        empty_belief(1, SIZE),
        logs,
        np.zeros((EPISODE_STEPS, PLAN_COLUMNS)),
        no_cost(5),
        np.zeros(len(FIELDS)),
        np.zeros(1, np.intp),
        empty_inputs(),
        found,
        room_for(1),
        plan_room(),
    )


@compiled
def begun(design: AdaptiveDesign, now: Sample, begins: bool, memory: ArmMemory) -> None:
    """Identify the arm; where a move begins, plan it, which takes much longer than a sample."""
    write_inputs(now, begins, memory.inputs)
    found = memory.found
    identify(design.filter, memory.inputs, memory.belief, memory.identification)
    estimate(design.filter, memory.belief, memory.identification.simulation, found)
    if begins or now.step == 0:
        write_linear_arm(found.table[0], design.filter.nominal.model, memory.planning.model)
        start = Start(0, now.step + found.delay[0], found.states[0], design.improvements)
        plan_task(move_of(now), found.table[0], design.weights, start, memory.planning, memory.plan)
        memory.left[0] = 0
        memory.logs[:] = found.logs[0]


@compiled
def torque(design: AdaptiveDesign, now: Sample, memory: ArmMemory) -> float:
    """Torque [N m] by the plan, once `begun` has been there."""
    found = memory.found
    planned = torque_of_plan(memory.plan, now.step + found.delay[0], found.states[0], 0.0)
    z, direction = memory.belief.tracks.mean[0], found.direction[0]
    return motor_torque(design.compensation, planned, found.table[0], z, found.states[0], direction)


@compiled
def renewed(design: AdaptiveDesign, now: Sample, memory: ArmMemory) -> None:
    """Plan the move anew where the plan is stale; it acts from the next sample on, so there is time for it.

    A plan is made from its end, `design.rows` samples of it at a time. Until the recursion is there, a sample has the
    plan of before. In the sample in which it is there it is made to begin where the arm is, and around the reference's
    end it is improved.
    """
    found, to_go, model = memory.found, memory.to_go, memory.planning.model
    if memory.left[0] <= now.step and is_stale(now.duration, now.step, found.logs[0], memory.logs):
        write_linear_arm(found.table[0], design.filter.nominal.model, model)
        memory.row[:] = found.table[0]
        to_go.matrix[:] = 0.0
        to_go.vector[:] = 0.0
        memory.left[0] = len(memory.plan)
        memory.logs[:] = found.logs[0]
    if memory.left[0] > now.step:
        first, problem = (
            max(memory.left[0] - design.rows, now.step),
            problem_of(move_of(now), memory.row, model, design.weights),
        )
        plan_backwards(problem, to_go, first, memory.left[0], memory.plan)
        memory.left[0] = first
        if first == now.step:
            steps = steps_of(now.duration, now.step, design.improvements)
            start = Start(first, now.step + found.delay[0], found.states[0], steps)
            refine(problem, start, memory.planning.steps, memory.plan)


@compiled
def law(design: AdaptiveDesign, now: Sample, begins: bool, memory: ArmMemory) -> float:
    """Torque [N m] of one sample, before it is cut at its limit."""
    begun(design, now, begins, memory)
    result = torque(design, now, memory)
    renewed(design, now, memory)
    return result
