"""Memory layout of a batch of arms: blocks of `LANES` arms, one row per quantity.

A block is a flat float64 array in which quantity `row` of lane `j` sits at `row * LANES + j`. The constant distance
between rows lets the compiler prove that they do not overlap, and hence vectorise a loop over lanes that reads and
writes dozens of them; it also keeps a block's working set together in the cache. A single arm is a block of one lane,
for which there are kernels of their own, see `for_lanes`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Final, NamedTuple, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from beltarm_env.arm import Plant
from beltarm_env.arrays import Floats
from beltarm_env.engine import inlined, with_constants
from beltarm_env.physics.drive import Drive
from beltarm_env.physics.models import Model
from beltarm_env.physics.state import ArmState
from beltarm_env.physics.torque import Stages
from beltarm_env.task.reference import MoveShape
from beltarm_env.timing import LATENCY_SAMPLES

LANES = 136
Rows = Annotated[Floats, "rows of LANES"]
"""Arrays of rows, one after the other, with a number for each lane; in a program for one arm a row is one number."""
_P = ParamSpec("_P")
_R = TypeVar("_R")

STATE = 0
PLANT = STATE + len(ArmState._fields)
KINEMATICS = PLANT + Plant._fields.index("double_link")  # the rest of the plant: not in the equations of motion
DRIVE = PLANT + len(Plant._fields)
SPRING = DRIVE + Drive._fields.index("spring")
LAG_TIME = DRIVE + len(Drive._fields)  # T_i [s]
LAG_RATE = LAG_TIME + 1  # 1 / T_i [1/s], 0 for a motor that follows at once
MOVE = LAG_RATE + 1
SUBSTEPS = MOVE + len(MoveShape._fields)  # integration steps per sample
RESOLUTION = SUBSTEPS + 1  # encoder [rad per count]
DELAY = RESOLUTION + 1  # of the measurements, its whole part [samples]
STEP = DELAY + 1  # samples since the move's start
ACTION = STEP + 1  # last torque commanded, over its limit
HOLDS_PART = ACTION + 1  # whether the gripper holds a part: 1 or 0
COUNTS = HOLDS_PART + 1  # encoder counts now, 1, 2 and 3 samples ago
COUNT_HISTORY = 4
TIP_SPEEDS = COUNTS + COUNT_HISTORY  # tachometer now, 1 and 2 samples ago [m/s]
TIP_HISTORY = 3
FRACTION = TIP_SPEEDS + TIP_HISTORY  # rest of the delay: the sensors are read so much of a sample before it
BEFORE = FRACTION + 1  # state one sample ago; kept only where there is such a rest
TIP_VELOCITY = BEFORE + len(ArmState._fields)  # of the accelerometer's last reading: x, y [m/s]
TIP_ACCELERATION = TIP_VELOCITY + 2  # low-passed: x, y [m/s^2]
ALONG = TIP_ACCELERATION + 2  # accelerometer along the hand now, 1 and 2 samples ago [m/s^2]
ACROSS = ALONG + 3  # and across it
BIASES = ACROSS + 3  # of both [m/s^2]
NOISE_SEED = BIASES + 2
TOTALS = NOISE_SEED + 1  # over the move: the three cost terms, squared tip error, largest tip error
REAL_DRIVE = TOTALS + 5  # 1 where the drive is real, 0 where it is ideal
SPLIT = REAL_DRIVE + 1  # when a command arrives within a sample [s]
LATE = SPLIT + 1  # whole samples by which it is late
BY_BEFORE = LATE + 1  # shares that the torque commanded before has in the torques of a step's stages
BY_AFTER = BY_BEFORE + len(Stages._fields)  # and that commanded after
GAIN = BY_AFTER + len(Stages._fields)  # torque over command, 1 + k
VISCOUS = GAIN + 1  # friction at the move's start [N m s/rad], [N m]
COULOMB = VISCOUS + 1
DRIFT = COULOMB + 1  # of friction, per sample
TORQUE = DRIFT + 1  # of the motor now [N m]
TARGETS = TORQUE + 1  # torques commanded in this sample, 1, 2 and 3 ago [N m]
DEFLECTION = TARGETS + LATENCY_SAMPLES + 1  # of a motor that gives before it slips [rad]; `friction.SLIPS` if it does
EARLIER = DEFLECTION + 1  # samples of the episode before the move
MOVES_LEFT = EARLIER + 1  # after this one
EARLIER_TOTALS = MOVES_LEFT + 1  # over the moves before: as TOTALS
FRICTION_LEVEL = EARLIER_TOTALS + 5  # at the move's start over that at the episode's
SWINGS = FRICTION_LEVEL + 1  # most of x, -x, y, -y of the tip error after the move's end [m]
UNSTILL = SWINGS + 4  # samples after which the tip error was beyond `STILL_BAND` for the last time
ROWS = UNSTILL + 1

RealDrive = bool | None
IDEAL: Final = None
REAL: Final = True
"""Whether real drives are among the arms: a kernel compiled for IDEAL has none of their equations."""


class StepSettings(NamedTuple):
    """What all arms of a batch have in common in a step."""

    profile: int  # index into `reference.PROFILES`
    tier: int  # index into `observation.SENSORS`
    model: Model  # whose equations of motion
    real_drive: RealDrive  # whether real drives are among the arms
    integrate: bool  # whether the kernels move the arms; not where another engine has moved them


class Setup(NamedTuple):
    """What episodes of a batch of N arms begin with."""

    resolution: float  # of the encoder [rad per count]
    delays: Floats  # of the measurements [samples], shape (N,)
    real_drives: NDArray[np.bool_]  # which arms have a real drive, shape (N,); kernels that begin moves change it
    num_moves: int  # of an episode
    profile: int  # index into `reference.PROFILES`
    model: Model  # whose equations of motion


MAX_DELAY = 2
_VECTOR = 8  # lanes that the widest vector units take at once
_LINE = 64  # bytes of a cache line


def aligned_zeros(count: int) -> NDArray[np.float64]:
    """Allocate zeros where a cache line begins, for a vector that lies in two lines takes twice as long."""
    room = np.zeros(count + _LINE // 8)
    first = -room.ctypes.data % _LINE // 8
    return room[first : first + count]


def aligned_rows(count: int, size: int) -> NDArray[np.float64]:
    """Allocate rows of zeros of whole vectors, `size` or more, each of which begins where a cache line does."""
    width = -(-size // _VECTOR) * _VECTOR
    return aligned_zeros(count * width).reshape(count, width)


def empty_blocks(num_arms: int, lanes: int = LANES) -> NDArray[np.float64]:
    """Allocate zeroed blocks for `num_arms` arms, shape (blocks, ROWS * lanes)."""
    blocks = -(-num_arms // lanes)
    return aligned_zeros(blocks * ROWS * lanes).reshape(blocks, ROWS * lanes)


def for_lanes(kernel: Callable[_P, _R], lanes: int) -> Callable[_P, _R]:
    """Return a kernel for blocks of so many lanes."""
    return kernel if lanes == LANES else with_constants(kernel, LANES=lanes)


def rows(blocks: NDArray[np.float64], first: int, count: int, num_arms: int) -> NDArray[np.float64]:
    """Copy `count` rows from row `first` on: shape (num_arms, count)."""
    table = blocks.reshape(len(blocks), ROWS, -1)[:, first : first + count]
    return np.array(table.swapaxes(1, 2), order="C").reshape(-1, count)[:num_arms]


def put_rows(blocks: NDArray[np.float64], first: int, values: NDArray[np.float64]) -> None:
    """Write rows from row `first` on, for all arms, from values of shape (arms, rows)."""
    arms = np.arange(len(values))
    table = blocks.reshape(len(blocks), ROWS, -1)
    lanes = table.shape[2]
    table[arms // lanes, first : first + values.shape[1], arms % lanes] = values


@inlined
def whole_vectors(count: int) -> int:
    """Return so many lanes that they fill whole vectors: what is left over would be stepped one by one.

    A single arm is, which takes less time than to fill a vector with its copies.
    """
    return count if count == 1 else -(-count // _VECTOR) * _VECTOR


@inlined
def load_state(block: NDArray[np.float64], row: int, lane: int) -> ArmState:
    """Load the state of one lane, from four rows starting at `row`."""
    at = row * LANES + lane
    return ArmState._make(block[at + k * LANES] for k in range(len(ArmState._fields)))


@inlined
def store_state(block: NDArray[np.float64], row: int, lane: int, x: ArmState) -> None:
    """Write a lane's state to four rows starting at `row`."""
    at = row * LANES + lane
    for k, value in enumerate(x):
        block[at + k * LANES] = value


@inlined
def load_plant(block: NDArray[np.float64], lane: int) -> Plant:
    """Load the plant coefficients of one lane."""
    at = PLANT * LANES + lane
    return Plant._make(block[at + k * LANES] for k in range(len(Plant._fields)))


@inlined
def drive_among(block: NDArray[np.float64], lane: int, real_drive: RealDrive) -> Drive | None:
    """Load the coefficients of one lane's drive; None among ideal ones."""
    if real_drive is IDEAL:
        return None
    return load_drive(block, lane)


@inlined
def load_drive(block: NDArray[np.float64], lane: int) -> Drive:
    """Load the coefficients of one lane's real drive."""
    at = DRIVE * LANES + lane
    return Drive._make(block[at + k * LANES] for k in range(len(Drive._fields)))


@inlined
def load_stages(block: NDArray[np.float64], row: int, lane: int) -> Stages:
    """Load a number for each stage of a step, from as many rows starting at `row`."""
    at = row * LANES + lane
    return Stages._make(block[at + k * LANES] for k in range(len(Stages._fields)))


@inlined
def store_stages(block: NDArray[np.float64], row: int, lane: int, stages: Stages) -> None:
    """Write a number for each stage of a step to as many rows starting at `row`."""
    at = row * LANES + lane
    for k, value in enumerate(stages):
        block[at + k * LANES] = value


@inlined
def load_move(block: NDArray[np.float64], lane: int) -> MoveShape:
    """Load the move of one lane."""
    at = MOVE * LANES + lane
    return MoveShape._make(block[at + k * LANES] for k in range(len(MoveShape._fields)))


@inlined
def store_plant(block: NDArray[np.float64], lane: int, plant: Plant) -> None:
    """Write a lane's plant coefficients."""
    at = PLANT * LANES + lane
    for k, value in enumerate(plant):
        block[at + k * LANES] = value


@inlined
def store_drive(block: NDArray[np.float64], lane: int, drive: Drive) -> None:
    """Write a lane's drive coefficients."""
    at = DRIVE * LANES + lane
    for k, value in enumerate(drive):
        block[at + k * LANES] = value
