"""One sample of a controller as kernels, from the encoder's count to the motor's torque; kernels of one arm.

Between count and controller stands the environment's own observation, single precision and scales included, so the
drive's processor computes the torque that was compared, to the last bit.

A controller proposes a base torque, a residual where it has learned one, and how surprised its observer is. The guard,
where there is one, chooses between them.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from agents.policy.correction import Seen, correct
from agents.residual.controller import combined
from agents.residual.knowledge import cut
from baselines.estimation.filter_design import write_inputs
from baselines.estimation.identification import identify
from baselines.guard.guard import ASKS, CHANGED, GuardInputs, guarded_torque
from baselines.reading import Sample, sample_from
from beltarm_env.arm import Plant
from beltarm_env.arrays import Floats, Integers, Singles
from beltarm_env.engine import compiled
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.layout import IDEAL, LANES, store_plant
from beltarm_env.kernels.observe import observe_block
from beltarm_env.kernels.tile import TILE_ROWS
from beltarm_env.observation import ENCODER, size
from beltarm_env.physics.models import LUMPED
from beltarm_env.task.reference import TRAPEZOID, MoveShape

Kernel = Callable[..., Any]


NOTHING, MOVE, EPISODE = range(3)
"""What begins at a sample: nothing, a further move of an episode, or an episode."""


class Device(NamedTuple):
    """Memory of the loop for one arm."""

    block: Floats  # one arm as `beltarm_env.kernels.layout` has it: encoder, move, gripper, last command
    tile: Singles  # of the observation, on its way
    observation: Singles  # shape (1, size)
    begins: Integers  # EPISODE or MOVE until the first sample of one is over, then NOTHING, shape (1,)


def empty_device(lanes: int = LANES) -> Device:
    """Memory of a loop, for a number of lanes per block."""
    return Device(
        np.zeros(at.ROWS * lanes),
        np.zeros(TILE_ROWS * lanes, np.float32),
        np.zeros((1, size()), np.float32),
        np.zeros(1, np.intp),
    )


@compiled
def begin(device: Device, plant: Plant, resolution: float, move: MoveShape, holds_part: bool, count: int) -> None:
    """Begin a move with an arm at rest.

    The plant has the gear ratio of the drive, `resolution` is that of the encoder [rad per count], `count` its count.
    """
    block = device.block
    for row in range(at.ROWS):
        block[row * LANES] = 0.0
    store_plant(block, 0, plant)
    block[at.RESOLUTION * LANES] = resolution
    for k in range(at.COUNT_HISTORY):
        block[(at.COUNTS + k) * LANES] = float(count)
    go_on(device, move, holds_part)
    device.begins[0] = EPISODE


@compiled
def go_on(device: Device, move: MoveShape, holds_part: bool) -> None:
    """Begin a further move; what was measured and commanded before stays."""
    block = device.block
    for k, value in enumerate(move):
        block[(at.MOVE + k) * LANES] = value
    block[at.HOLDS_PART * LANES] = 1.0 if holds_part else 0.0
    block[at.STEP * LANES], device.begins[0] = 0.0, MOVE


@compiled
def observe(device: Device, count: int) -> None:
    """Write the observation of a sample."""
    block = device.block
    block[(at.COUNTS + 1) * LANES] = block[at.COUNTS * LANES]
    block[at.COUNTS * LANES] = float(count)
    observe_block(block, device.tile, device.observation, at.StepSettings(TRAPEZOID, ENCODER, LUMPED, IDEAL, False))


@compiled
def commanded(device: Device, action: float, limit: float) -> float:
    """Torque of an action, from -1 to 1 [N m]; the sample is over."""
    block = device.block
    block[at.ACTION * LANES] = action
    block[at.STEP * LANES] += 1.0
    device.begins[0] = NOTHING
    return action * limit


class Proposal(NamedTuple):
    """Torques that a controller proposes at a sample."""

    base: float  # torque over its limit
    residual: float  # the same, to be added to it
    action: float  # both, cut at the limit
    surprise: float  # w of the observer; 1 where there is none


class Learned(NamedTuple):
    """Design, or memory, of a base with a learned residual."""

    base: Any  # of the base's law
    filter: Any  # of an identification that runs beside the base; None where the base's is shared, or there is none
    correction: Any  # of `agents.policy.correction.correct`


class Filtering(NamedTuple):
    """Memory of an identification beside the base."""

    belief: Any
    inputs: Any
    work: Any


class Guarded(NamedTuple):
    """Design, or memory, of a controller behind the guard; its own alone where there is no guard."""

    own: Any
    servo: Any = None  # of the servo's law
    guard: Any = None


class GuardMemory(NamedTuple):
    """Memory of the guard."""

    row: Floats  # shape (GUARD_SIZE,)
    asked: Integers  # whether it asked for the servo at the last sample, shape (1,)


def classical(law: Kernel, identifies: bool) -> Kernel:
    """Proposal of a classical controller by its law; `identifies` tells whether the law has an observer."""

    def propose(design: Any, limit: float, device: Device, now: Sample, begins: bool, memory: Any) -> Proposal:
        torque = law(design, now, begins, memory)
        action: Any = np.float32(cut(torque / limit, 1.0))
        return Proposal(action, 0.0, action, memory.belief.tracks.surprise[0] if identifies else 1.0)

    return propose


def learned(law: Kernel, informed: bool, shared: bool) -> Kernel:
    """Proposal of a base with a residual.

    `informed`: the agent observes what an identification believes; `shared`: that identification is the base's own.
    """

    def propose(design: Learned, limit: float, device: Device, now: Sample, begins: bool, memory: Learned) -> Proposal:
        torque = law(design.base, now, begins, memory.base)
        base: Any = np.float32(cut(torque / limit, 1.0))
        belief, surprise = None, 1.0
        if informed:
            if not shared:
                write_inputs(now, begins, memory.filter.inputs)
                identify(design.filter, memory.filter.inputs, memory.filter.belief, memory.filter.work)
            belief = memory.base.belief if shared else memory.filter.belief
            surprise = belief.tracks.surprise[0]
        seen = Seen(device.observation[0], now, belief)
        share, anew = design.correction.limit, device.begins[0] == EPISODE
        residual = correct(design.correction, seen, base, begins, anew, memory.correction)
        return Proposal(base, share * residual, combined(base, residual, share), surprise)

    return propose


def step_of(propose: Kernel, guarded: bool = False, servo: Kernel | None = None, remembers: bool = False) -> Kernel:
    """Step of a controller, which may remember from move to move; the guard behind it may fall back to a servo law."""

    def step(design: Guarded, limit: float, device: Device, memory: Guarded, count: int) -> float:
        observe(device, count)
        now = sample_from(device.observation[0], limit)
        begins, anew = device.begins[0] != NOTHING, device.begins[0] == EPISODE
        proposal = propose(design.own, limit, device, now, anew if remembers else begins, memory.own)
        if not guarded:
            return commanded(device, proposal.action if proposal.action == proposal.action else 0.0, limit)
        row, asked = memory.guard.row, memory.guard.asked
        asks = row[ASKS] != 0.0 and not begins
        fallback = np.nan
        if servo is not None:
            if asks:
                torque = servo(design.servo, now, asked[0] == 0, memory.servo)
                single: Any = np.float32(cut(torque / limit, 1.0))
                fallback = limit * single
            asked[0] = 1 if asks else 0
        base, residual = limit * proposal.base, limit * proposal.residual
        inputs = GuardInputs(base, residual, fallback, now.motor_angle, proposal.surprise, now.last_command)
        torque = guarded_torque(design.guard, inputs, begins, anew, row)
        cautious: Any = np.float32(torque / limit)
        return commanded(device, cautious if row[CHANGED] != 0.0 else proposal.action, limit)

    return step
