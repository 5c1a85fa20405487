"""One control sample for a block of arms, from the torque commands to the observations.

`step_arms` serves a batch and `step_arm` a single arm; both run `_step_block`, so there is one copy of the dynamics, of
the sensors, of the cost and of the observation. Each phase is a flat loop over the lanes of a block that LLVM
vectorises.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beltarm_env.arm import integration_substeps, plant_of
from beltarm_env.jit import compiled, inlined
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.advance import WORK_ROWS, move_block
from beltarm_env.kernels.layout import LANES, load_move, load_plant, load_state, store_plant, store_state
from beltarm_env.kernels.observe import TILE_ROWS, observe_block
from beltarm_env.observation import TIP
from beltarm_env.physics.kinematics import contained, outside_workspace, tip_error, tip_motion
from beltarm_env.physics.models import Model
from beltarm_env.physics.plant import ArmState
from beltarm_env.task.cost import MAX_COST, step_cost
from beltarm_env.task.reference import TRAPEZOID, reference_at
from beltarm_env.task.sensors import to_counts
from beltarm_env.timing import CONTROL_PERIOD, EPISODE_STEPS

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Flags = NDArray[np.bool_]

# Scratch rows of a step.
ACTION = 0  # torque over its limit
TERMS = ACTION + 1  # tip error and the three cost terms
REWARD = TERMS + 4
TERMINATED = REWARD + 1
TRUNCATED = TERMINATED + 1
_WORK = TRUNCATED + 1  # rows of `motion`
_SCRATCH_ROWS = _WORK + WORK_ROWS


def new_scratch() -> tuple[Floats, Singles]:
    """Memory that the kernels work in, for one block at a time; allocated once because allocation takes time."""
    return np.zeros(_SCRATCH_ROWS * LANES), np.zeros(TILE_ROWS * LANES, dtype=np.float32)


@compiled
def _sense(block: Floats, count: int, tier: int) -> None:
    """Shift the sensors' histories by one sample and read them anew, from states that did not run away."""
    for j in range(count):
        block[(at.COUNTS + 3) * LANES + j] = block[(at.COUNTS + 2) * LANES + j]
        block[(at.COUNTS + 2) * LANES + j] = block[(at.COUNTS + 1) * LANES + j]
        block[(at.COUNTS + 1) * LANES + j] = block[at.COUNTS * LANES + j]
        x = contained(load_state(block, at.STATE, j), load_plant(block, j))
        store_state(block, at.STATE, j, x)
        block[at.COUNTS * LANES + j] = to_counts(x.motor_angle, block[at.RESOLUTION * LANES + j])
    if tier == TIP:
        for j in range(count):
            block[(at.TIP_SPEEDS + 2) * LANES + j] = block[(at.TIP_SPEEDS + 1) * LANES + j]
            block[(at.TIP_SPEEDS + 1) * LANES + j] = block[at.TIP_SPEEDS * LANES + j]
            tip = tip_motion(load_state(block, at.STATE, j), load_plant(block, j))
            block[at.TIP_SPEEDS * LANES + j] = tip.x_speed


@inlined
def _charge_profile(block: Floats, scratch: Floats, count: int, profile: int) -> None:
    """Cost of the step, the episode's totals, and whether it is over."""
    for j in range(count):
        x = load_state(block, at.STATE, j)
        plant = load_plant(block, j)
        action = scratch[ACTION * LANES + j]
        step = block[at.STEP * LANES + j] + 1.0
        reference = reference_at(profile, load_move(block, j), step * CONTROL_PERIOD)
        cost = step_cost(
            tip_motion(x, plant), reference.angle, reference.speed, action, block[at.ACTION * LANES + j], plant
        )
        block[at.STEP * LANES + j] = step
        block[at.ACTION * LANES + j] = action
        scratch[TERMS * LANES + j] = cost.tip_error
        scratch[(TERMS + 1) * LANES + j] = cost.position
        scratch[(TERMS + 2) * LANES + j] = cost.velocity
        scratch[(TERMS + 3) * LANES + j] = cost.torque_rate
        block[at.TOTALS * LANES + j] += cost.position
        block[(at.TOTALS + 1) * LANES + j] += cost.velocity
        block[(at.TOTALS + 2) * LANES + j] += cost.torque_rate
        block[(at.TOTALS + 3) * LANES + j] += cost.tip_error * cost.tip_error
        largest = block[(at.TOTALS + 4) * LANES + j]
        block[(at.TOTALS + 4) * LANES + j] = cost.tip_error if cost.tip_error > largest else largest
        outside = outside_workspace(x, plant)
        remaining = EPISODE_STEPS - step if outside else 0.0
        scratch[REWARD * LANES + j] = -(cost.position + cost.velocity + cost.torque_rate + MAX_COST * remaining)
        scratch[TERMINATED * LANES + j] = 1.0 if outside else 0.0
        scratch[TRUNCATED * LANES + j] = 1.0 if (step >= EPISODE_STEPS) & (not outside) else 0.0


@compiled
def _charge(block: Floats, scratch: Floats, count: int, profile: int) -> None:
    if profile == TRAPEZOID:  # the usual case as a constant, so that its loop does not compute the other profiles
        _charge_profile(block, scratch, count, TRAPEZOID)
    else:
        _charge_profile(block, scratch, count, profile)


@compiled
def _step_block(
    block: Floats, scratch: Floats, tile: Singles, observations: Singles, profile: int, tier: int, model: Model
) -> None:
    """One control period for the arms of one block; actions are in scratch, results go to scratch."""
    count = len(observations)
    if model is None or model:  # not ELSEWHERE; in this form numba compiles the test away for LUMPED
        move_block(block, scratch[_WORK * LANES :], scratch[ACTION * LANES : (ACTION + 1) * LANES], count, model)
    _sense(block, count, tier)
    _charge(block, scratch, count, profile)
    observe_block(block, tile, observations, profile, tier)


@compiled
def step_arms(
    blocks: Floats,
    scratch: Floats,
    tile: Singles,
    actions: Floats,
    observations: Singles,
    rewards: Floats,
    terminated: Flags,
    truncated: Flags,
    terms: Floats,
    profile: int,
    tier: int,
    model: Model,
) -> None:
    """Step N arms by one control period, results written in place.

    Args:
        blocks: The arms, as `_layout` describes.
        scratch: From `new_scratch`.
        tile: From `new_scratch`.
        actions: Torque over the torque limit, shape (N,), cut to [-1, 1].
        observations: Shape (N, size).
        rewards: Shape (N,).
        terminated: Shape (N,).
        truncated: Shape (N,).
        terms: Tip error [m] and the three cost terms, shape (4, N).
        profile: Index into `reference.PROFILES`.
        tier: Index into `observation.SENSORS`.
        model: Whose equations of motion.
    """
    for k in range(len(blocks)):
        low = k * LANES
        high = min(low + LANES, len(actions))
        _take_actions(actions[low:high], scratch)
        _step_block(blocks[k], scratch, tile, observations[low:high], profile, tier, model)
        _give_flags(scratch, TERMINATED, terminated[low:high])
        _give_flags(scratch, TRUNCATED, truncated[low:high])
        _give(scratch, REWARD, rewards[low:high])
        for row in range(len(terms)):
            _give(scratch, TERMS + row, terms[row, low:high])


@compiled
def _take_actions(actions: Floats, scratch: Floats) -> None:
    for j in range(len(actions)):
        scratch[ACTION * LANES + j] = min(max(actions[j], -1.0), 1.0)


@compiled
def _give(scratch: Floats, row: int, values: Floats) -> None:
    source = scratch[row * LANES : (row + 1) * LANES]
    for j in range(len(values)):
        values[j] = source[j]


@compiled
def _give_flags(scratch: Floats, row: int, flags: Flags) -> None:
    source = scratch[row * LANES : (row + 1) * LANES]
    for j in range(len(flags)):
        flags[j] = source[j] != 0.0


@compiled
def step_arm(
    blocks: Floats,
    scratch: Floats,
    tile: Singles,
    action: float,
    observation: Singles,
    profile: int,
    tier: int,
    model: Model,
) -> tuple[float, bool, bool, float, float, float, float]:
    """Step a single arm, lane 0 of the first block, by one control period.

    Args:
        blocks: The arm, as `_layout` describes.
        scratch: From `new_scratch`.
        tile: From `new_scratch`.
        action: Torque over the torque limit, cut to [-1, 1].
        observation: Written in place, shape (size,).
        profile: Index into `reference.PROFILES`.
        tier: Index into `observation.SENSORS`.
        model: Whose equations of motion.

    Returns:
        Reward, terminated, truncated, tip error [m], and the three cost terms.
    """
    scratch[ACTION * LANES] = min(max(action, -1.0), 1.0)
    _step_block(blocks[0], scratch, tile, observation.reshape(1, -1), profile, tier, model)
    return (
        float(scratch[REWARD * LANES]),
        bool(scratch[TERMINATED * LANES] != 0.0),
        bool(scratch[TRUNCATED * LANES] != 0.0),
        float(scratch[TERMS * LANES]),
        float(scratch[(TERMS + 1) * LANES]),
        float(scratch[(TERMS + 2) * LANES]),
        float(scratch[(TERMS + 3) * LANES]),
    )


@compiled
def begin_episodes(
    blocks: Floats,
    arms: NDArray[np.intp],
    table: Floats,
    moves: Floats,
    states: Floats,
    resolution: float,
    delay: int,
    model: Model,
) -> None:
    """Begin a new episode in n arms.

    Args:
        blocks: The arms, as `_layout` describes.
        arms: Which ones, shape (n,).
        table: Their parameters, shape (n, len(FIELDS)).
        moves: Their moves, shape (n, 4).
        states: Their states, shape (n, 4); NaN for at rest at the move's start.
        resolution: Of the encoder [rad per count].
        delay: Of the measurements [samples].
        model: Whose equations of motion.
    """
    for i in range(len(arms)):
        block, j = blocks[arms[i] // LANES], arms[i] % LANES
        plant = plant_of(table[i])
        for row in range(at.ROWS):
            block[row * LANES + j] = 0.0
        x = ArmState(states[i, 0], states[i, 1], states[i, 2], states[i, 3])
        if x.motor_angle != x.motor_angle:
            x = ArmState(moves[i, 0] * plant.gear, 0.0, 0.0, 0.0)
        store_state(block, at.STATE, j, x)
        for k in range(4):
            block[(at.MOVE + k) * LANES + j] = moves[i, k]
            before = x.motor_angle - k * CONTROL_PERIOD * x.motor_speed
            block[(at.COUNTS + k) * LANES + j] = to_counts(before, resolution)
        store_plant(block, j, plant)
        tip_speed = tip_motion(load_state(block, at.STATE, j), plant).x_speed
        for k in range(3):
            block[(at.TIP_SPEEDS + k) * LANES + j] = tip_speed
        block[at.SUBSTEPS * LANES + j] = integration_substeps(plant, model)
        block[at.RESOLUTION * LANES + j] = resolution
        block[at.DELAY * LANES + j] = delay


@compiled
def episode_totals(blocks: Floats, arms: NDArray[np.intp], terminated: Flags, totals: Floats) -> None:
    """What episodes came to, written to the columns of some arms.

    Args:
        blocks: The arms, as `_layout` describes.
        arms: Which ones, shape (n,).
        terminated: Which arms left the workspace and are charged for the steps that are left, shape (N,).
        totals: Cost, its position, velocity and torque-rate terms, steps, RMS and largest tip error [m], shape (7, N).
    """
    for arm in arms:
        block, j = blocks[arm // LANES], arm % LANES
        steps = block[at.STEP * LANES + j]
        cost = MAX_COST * (EPISODE_STEPS - steps) if terminated[arm] else 0.0
        for k in range(3):
            totals[1 + k, arm] = block[(at.TOTALS + k) * LANES + j]
            cost += totals[1 + k, arm]
        totals[0, arm] = cost
        totals[4, arm] = steps
        totals[5, arm] = math.sqrt(block[(at.TOTALS + 3) * LANES + j] / steps)
        totals[6, arm] = block[(at.TOTALS + 4) * LANES + j]


@compiled
def observe_arms(blocks: Floats, tile: Singles, observations: Singles, chosen: Flags, profile: int, tier: int) -> None:
    """Write the observations of all arms in those blocks where `chosen`, shape (blocks,), is true."""
    for k in range(len(blocks)):
        if chosen[k]:
            low = k * LANES
            high = min(low + LANES, len(observations))
            observe_block(blocks[k], tile, observations[low:high], profile, tier)


@compiled
def tip_errors(blocks: Floats, errors: Floats, profile: int) -> None:
    """Write tip minus reference tip, position [m] and velocity [m/s], x and y each, into `errors`, shape (N, 4)."""
    for i in range(len(errors)):
        block, j = blocks[i // LANES], i % LANES
        plant = load_plant(block, j)
        tip = tip_motion(load_state(block, at.STATE, j), plant)
        reference = reference_at(profile, load_move(block, j), block[at.STEP * LANES + j] * CONTROL_PERIOD)
        errors[i, 0], errors[i, 1], errors[i, 2], errors[i, 3] = tip_error(tip, reference.angle, reference.speed, plant)
