"""What a drive's processor does every 1.5 ms: from the encoder's count to the torque, by the kernels of comparisons.

Between the count and a controller stands the environment's own observation, single precision and scales included, so
that the processor computes what was compared, to the last bit. A loop is a kernel for one arm:

    begin(device, move, count)                      a move begins, the arm at rest
    observe(device, count)                          the sample's observation
    torque = commanded(device, action)              what is told the drive, and remembered as the last command
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from beltarm_env.arm import Plant
from beltarm_env.arrays import Floats, Integers, Singles
from beltarm_env.jit import compiled
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.layout import IDEAL, LANES, store_plant
from beltarm_env.kernels.observe import observe_block
from beltarm_env.kernels.tile import TILE_ROWS
from beltarm_env.observation import ENCODER, size
from beltarm_env.task.reference import TRAPEZOID, MoveShape


class Device(NamedTuple):
    """Memory of the loop for one arm."""

    block: Floats  # one arm as `beltarm_env.kernels.layout` has it: encoder, move, last command
    tile: Singles  # of the observation, on its way
    observation: Singles  # shape (1, 25)
    begins: Integers  # 1 until the move's first sample is over, shape (1,)


def empty_device(lanes: int = LANES) -> Device:
    """Memory of a loop, for a number of lanes per block."""
    return Device(
        np.zeros(at.ROWS * lanes),
        np.zeros(TILE_ROWS * lanes, np.float32),
        np.zeros((1, size()), np.float32),
        np.zeros(1, np.intp),
    )


@compiled
def begin(device: Device, plant: Plant, resolution: float, move: MoveShape, count: int) -> None:
    """Begin a move with an arm at rest.

    Args:
        device: Written.
        plant: Arm with the gear ratio of the drive.
        resolution: Of the encoder [rad per count].
        move: What is asked of the arm.
        count: The encoder's.
    """
    block = device.block
    for row in range(at.ROWS):
        block[row * LANES] = 0.0
    store_plant(block, 0, plant)
    block[at.RESOLUTION * LANES] = resolution
    block[at.MOVE * LANES], block[(at.MOVE + 1) * LANES] = move.start, move.goal
    block[(at.MOVE + 2) * LANES], block[(at.MOVE + 3) * LANES] = move.duration, move.ramp_time
    for k in range(at.COUNT_HISTORY):
        block[(at.COUNTS + k) * LANES] = float(count)
    device.begins[0] = 1


@compiled
def observe(device: Device, count: int) -> None:
    """Write the observation of a sample."""
    block = device.block
    block[(at.COUNTS + 1) * LANES] = block[at.COUNTS * LANES]
    block[at.COUNTS * LANES] = float(count)
    observe_block(block, device.tile, device.observation, TRAPEZOID, ENCODER, IDEAL)


@compiled
def commanded(device: Device, action: float, limit: float) -> float:
    """Torque of an action, from -1 to 1 [N m]; the sample is over."""
    block = device.block
    block[at.ACTION * LANES] = action
    block[at.STEP * LANES] += 1.0
    device.begins[0] = 0
    return action * limit
