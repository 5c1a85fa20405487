"""One control sample for a block of arms, from the torque commands to the observations.

`step_arms` serves a batch and `step_arm` a single arm; both run `_step_block`, so there is one copy of the dynamics, of
the sensors, of the cost and of the observation. Each phase is a flat loop over the lanes of a block that LLVM
vectorises.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltarm_env import _layout as at
from beltarm_env._constants import CONTROL_PERIOD, EPISODE_STEPS
from beltarm_env._jit import compiled
from beltarm_env._layout import LANES, load_move, load_plant, load_state, store_plant
from beltarm_env._observe import observe_block
from beltarm_env.cost import MAX_COST, step_cost
from beltarm_env.kinematics import outside_workspace, reference_tip, tip_motion
from beltarm_env.motion import move_block
from beltarm_env.observation import TIP
from beltarm_env.params import integration_substeps, plant_of
from beltarm_env.reference import reference_at
from beltarm_env.sensors import to_counts

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Flags = NDArray[np.bool_]

# Scratch rows of a step, in a block of their own.
COMMAND = 0  # action, then torque [N m]
TERMS = COMMAND + 1  # tip error and the three cost terms
REWARD = TERMS + 4
TERMINATED = REWARD + 1
TRUNCATED = TERMINATED + 1
SCRATCH_ROWS = TRUNCATED + 1


@compiled
def _apply_commands(block: Floats, scratch: Floats, count: int) -> None:
    """Motor torques from actions, which are cut to [-1, 1]."""
    for j in range(count):
        fraction = min(max(scratch[COMMAND * LANES + j], -1.0), 1.0)
        scratch[COMMAND * LANES + j] = load_plant(block, j).torque_limit * fraction


@compiled
def _sense(block: Floats, count: int, tier: int) -> None:
    """Shift the sensors' histories by one sample and read them anew."""
    for j in range(count):
        block[(at.COUNTS + 3) * LANES + j] = block[(at.COUNTS + 2) * LANES + j]
        block[(at.COUNTS + 2) * LANES + j] = block[(at.COUNTS + 1) * LANES + j]
        block[(at.COUNTS + 1) * LANES + j] = block[at.COUNTS * LANES + j]
        x = load_state(block, at.STATE, j)
        block[at.COUNTS * LANES + j] = to_counts(x.motor_angle, block[at.RESOLUTION * LANES + j])
    if tier == TIP:
        for j in range(count):
            block[(at.TIP_SPEEDS + 2) * LANES + j] = block[(at.TIP_SPEEDS + 1) * LANES + j]
            block[(at.TIP_SPEEDS + 1) * LANES + j] = block[at.TIP_SPEEDS * LANES + j]
            tip = tip_motion(load_state(block, at.STATE, j), load_plant(block, j))
            block[at.TIP_SPEEDS * LANES + j] = tip.x_speed


@compiled
def _charge(block: Floats, scratch: Floats, count: int, profile: int) -> None:
    """Cost of the step, the episode's totals, and whether it is over."""
    for j in range(count):
        x = load_state(block, at.STATE, j)
        plant = load_plant(block, j)
        torque = scratch[COMMAND * LANES + j]
        step = block[at.STEP * LANES + j] + 1.0
        reference = reference_at(profile, load_move(block, j), step * CONTROL_PERIOD)
        cost = step_cost(
            tip_motion(x, plant), reference.angle, reference.speed, torque, block[at.TORQUE * LANES + j], plant
        )
        block[at.STEP * LANES + j] = step
        block[at.TORQUE * LANES + j] = torque
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
def _step_block(block: Floats, scratch: Floats, observations: Singles, profile: int, tier: int) -> None:
    """One control period for the arms of one block; actions are in scratch, results go to scratch."""
    count = len(observations)
    _apply_commands(block, scratch, count)
    move_block(block, scratch[COMMAND * LANES : (COMMAND + 1) * LANES], count)
    _sense(block, count, tier)
    _charge(block, scratch, count, profile)
    observe_block(block, observations, profile, tier)


@compiled
def step_arms(
    blocks: Floats,
    actions: Floats,
    observations: Singles,
    rewards: Floats,
    terminated: Flags,
    truncated: Flags,
    terms: Floats,
    profile: int,
    tier: int,
) -> None:
    """Step N arms by one control period, results written in place.

    Args:
        blocks: The arms, as `_layout` describes.
        actions: Torque over the torque limit, shape (N,), cut to [-1, 1].
        observations: Shape (N, size).
        rewards: Shape (N,).
        terminated: Shape (N,).
        truncated: Shape (N,).
        terms: Tip error [m] and the three cost terms, shape (4, N).
        profile: Index into `reference.PROFILES`.
        tier: Index into `observation.SENSORS`.
    """
    scratch = np.empty(SCRATCH_ROWS * LANES)
    for k in range(len(blocks)):
        low = k * LANES
        count = min(LANES, len(actions) - low)
        for j in range(count):
            scratch[COMMAND * LANES + j] = actions[low + j]
        _step_block(blocks[k], scratch, observations[low : low + count], profile, tier)
        for j in range(count):
            rewards[low + j] = scratch[REWARD * LANES + j]
            terminated[low + j] = scratch[TERMINATED * LANES + j] != 0.0
            truncated[low + j] = scratch[TRUNCATED * LANES + j] != 0.0
        for row in range(4):
            for j in range(count):
                terms[row, low + j] = scratch[(TERMS + row) * LANES + j]


@compiled
def step_arm(
    block: Floats, action: float, observation: Singles, profile: int, tier: int
) -> tuple[float, bool, bool, float, float, float, float]:
    """Step the arm in lane 0 of `block` by one control period.

    Args:
        block: One block, as `_layout` describes.
        action: Torque over the torque limit, cut to [-1, 1].
        observation: Written in place, shape (size,).
        profile: Index into `reference.PROFILES`.
        tier: Index into `observation.SENSORS`.

    Returns:
        Reward, terminated, truncated, tip error [m], and the three cost terms.
    """
    scratch = np.empty(SCRATCH_ROWS * LANES)
    scratch[COMMAND * LANES] = action
    _step_block(block, scratch, observation.reshape(1, -1), profile, tier)
    return (
        scratch[REWARD * LANES],
        scratch[TERMINATED * LANES] != 0.0,
        scratch[TRUNCATED * LANES] != 0.0,
        scratch[TERMS * LANES],
        scratch[(TERMS + 1) * LANES],
        scratch[(TERMS + 2) * LANES],
        scratch[(TERMS + 3) * LANES],
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
) -> None:
    """Begin a new episode in n arms.

    Args:
        blocks: The arms, as `_layout` describes.
        arms: Which ones, shape (n,).
        table: Their parameters, shape (n, len(FIELDS)).
        moves: Their moves, shape (n, 4).
        states: Their states, shape (n, 4).
        resolution: Of the encoder [rad per count].
        delay: Of the measurements [samples].
    """
    for i in range(len(arms)):
        block, j = blocks[arms[i] // LANES], arms[i] % LANES
        plant = plant_of(table[i])
        for row in range(at.ROWS):
            block[row * LANES + j] = 0.0
        for k in range(4):
            block[(at.STATE + k) * LANES + j] = states[i, k]
            block[(at.MOVE + k) * LANES + j] = moves[i, k]
            before = states[i, 0] - k * CONTROL_PERIOD * states[i, 1]
            block[(at.COUNTS + k) * LANES + j] = to_counts(before, resolution)
        store_plant(block, j, plant)
        tip_speed = tip_motion(load_state(block, at.STATE, j), plant).x_speed
        for k in range(3):
            block[(at.TIP_SPEEDS + k) * LANES + j] = tip_speed
        block[at.SUBSTEPS * LANES + j] = integration_substeps(plant)
        block[at.RESOLUTION * LANES + j] = resolution
        block[at.DELAY * LANES + j] = delay


@compiled
def observe_arms(blocks: Floats, observations: Singles, chosen: Flags, profile: int, tier: int) -> None:
    """Write the observations of all arms in those blocks where `chosen`, shape (blocks,), is true."""
    for k in range(len(blocks)):
        if chosen[k]:
            low = k * LANES
            high = min(low + LANES, len(observations))
            observe_block(blocks[k], observations[low:high], profile, tier)


@compiled
def tip_errors(blocks: Floats, errors: Floats, profile: int) -> None:
    """Write tip minus reference tip, position [m] and velocity [m/s], x and y each, into `errors`, shape (N, 4)."""
    for i in range(len(errors)):
        block, j = blocks[i // LANES], i % LANES
        plant = load_plant(block, j)
        tip = tip_motion(load_state(block, at.STATE, j), plant)
        reference = reference_at(profile, load_move(block, j), block[at.STEP * LANES + j] * CONTROL_PERIOD)
        x, x_speed = reference_tip(reference.angle, reference.speed, plant)
        errors[i, 0] = tip.x - x
        errors[i, 1] = tip.y
        errors[i, 2] = tip.x_speed - x_speed
        errors[i, 3] = tip.y_speed
