"""One arm as kernels for a program of C: its constants in, its motion out, by the environment's own kernels.

The arm is the lumped one, behind its real drive.
"""

from typing import NamedTuple

import numpy as np

from beltarm_env.arm import FIELDS, bounds_of
from beltarm_env.arrays import Floats
from beltarm_env.engine import compiled
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.advance import WORK_ROWS, advance_block, advance_part
from beltarm_env.kernels.layout import LANES, REAL, drive_among, load_drive, load_plant, load_state, store_state
from beltarm_env.kernels.simulate import load_arm
from beltarm_env.physics.drive import resting
from beltarm_env.physics.kinematics import HIGHEST, LOWEST, contained, outside_workspace, tip_motion
from beltarm_env.physics.models import LUMPED
from beltarm_env.physics.substeps import REMEDIES, integration_limits
from beltarm_env.task.sensors import to_counts
from beltarm_env.timing import EPISODE_STEPS

OUTPUTS = {
    "motor_angle": ("rad", "Angle of the motor theta_a"),
    "motor_speed": ("rad/s", "Speed of the motor omega_a"),
    "torsion": ("rad", "Torsion theta_s = theta_a / G - phi, with the arm's angle phi"),
    "torsion_speed": ("rad/s", "Its rate omega_s"),
    "tip_x": ("m", "Position of the tip along the nominal line of motion"),
    "tip_y": ("m", "Position of the tip across it"),
    "motor_torque": ("N m", "Torque of the motor, behind its current loop"),
    "encoder_count": ("", "Count of the encoder on the motor's shaft"),
}
"""Outputs with unit and description."""
_MOST_COUNTS = 2.0**31 - 1
_LOW, _HIGH, _ABOVE, _WHOLE = map(np.array, zip(*map(bounds_of, FIELDS), strict=True))


class Memory(NamedTuple):
    """Memory of one arm."""

    constants: Floats  # as the fields of `ArmParams`, shape (len(FIELDS),)
    block: Floats  # the arm as `beltarm_env.kernels.layout` has it
    within: Floats  # the same, within a sample
    work: Floats
    action: Floats  # torque over its limit, shape (1,)
    outputs: Floats  # shape (len(OUTPUTS),)


def empty_memory(lanes: int = LANES) -> Memory:
    """Memory of an arm, for a number of lanes per block."""
    lengths = (len(FIELDS), at.ROWS * lanes, at.ROWS * lanes, WORK_ROWS * lanes, lanes, len(OUTPUTS))
    return Memory(*map(np.zeros, lengths))


def _allowed(name: str) -> str:
    low, high, above, whole = bounds_of(name)
    least = "above" if above else "at least"
    return f"{name} must be finite, {least} {low:g} and at most {high:g}{', and a whole number' if whole else ''}"


REFUSALS = (
    "",
    *map(_allowed, FIELDS),
    f"initial_joint_angle must lie within {LOWEST:.4g} and {HIGHEST:.4g} rad",
    *(f"the arm is too fast to be integrated: {remedy}" for remedy in REMEDIES),
)
"""Why an arm is refused, by the number that `refusal` returns."""


@compiled
def refusal(memory: Memory, joint_angle: float) -> int:
    """Return why an arm is refused, as an index into `REFUSALS`; 0 if it is not."""
    for k in range(len(FIELDS)):
        value = memory.constants[k]
        inside = _LOW[k] <= value and value <= _HIGH[k]
        whole = np.floor(value) == value
        if not inside or (_ABOVE[k] and value == _LOW[k]) or (_WHOLE[k] and not whole):
            return 1 + k
    if not (LOWEST <= joint_angle and joint_angle <= HIGHEST):
        return 1 + len(FIELDS)
    number = 0
    for k, limit in enumerate(integration_limits(memory.constants, LUMPED)):
        number = 2 + len(FIELDS) + k if limit > 1.0 and number == 0 else number
    return number


@compiled
def begin(memory: Memory, joint_angle: float, resolution: float) -> None:
    """Set an arm up at rest, as an episode begins.

    Of its memory the constants stay. `joint_angle` is theta_a / G [rad], `resolution` the encoder's [rad per count].
    """
    block = memory.block
    for row in range(at.ROWS):
        block[row * LANES] = 0.0
    load_arm(block, 0, memory.constants, LUMPED)
    block[at.RESOLUTION * LANES] = resolution
    plant = load_plant(block, 0)
    store_state(block, at.STATE, 0, resting(joint_angle * plant.gear, plant, load_drive(block, 0)))
    _measure(block, memory.outputs)


@compiled
def step(memory: Memory, torque: float) -> bool:
    """Hold a torque command [N m] for one control period; tell whether the arm has left its workspace.

    Friction has drifted as far as it does when an episode would be over.
    """
    block = memory.block
    plant = load_plant(block, 0)
    action = min(max(torque / plant.torque_limit, -1.0), 1.0)
    memory.action[0] = action
    advance_block(block, memory.work, memory.action, 1, LUMPED, REAL)
    x = contained(load_state(block, at.STATE, 0), plant)
    store_state(block, at.STATE, 0, x)
    block[at.ACTION * LANES] = action
    block[at.STEP * LANES] = min(block[at.STEP * LANES] + 1.0, float(EPISODE_STEPS))
    _measure(block, memory.outputs)
    return outside_workspace(x, plant)


@compiled
def look(memory: Memory, torque: float, duration: float) -> None:
    """Measure the arm `duration` seconds into the control period over which a torque command [N m] is held.

    The arm itself stays at the period's beginning, so `step` gives the same however often it was looked at.
    """
    block = memory.within
    for row in range(at.ROWS):
        block[row * LANES] = memory.block[row * LANES]
    plant = load_plant(block, 0)
    action = min(max(torque / plant.torque_limit, -1.0), 1.0)
    memory.action[0] = action
    advance_part(block, memory.work, memory.action, duration, LUMPED)
    store_state(block, at.STATE, 0, contained(load_state(block, at.STATE, 0), plant))
    block[at.ACTION * LANES] = action
    _measure(block, memory.outputs)


@compiled
def _measure(block: Floats, outputs: Floats) -> None:
    x, plant = load_state(block, at.STATE, 0), load_plant(block, 0)
    tip = tip_motion(x, plant, drive_among(block, 0, REAL))
    real_drive = block[at.REAL_DRIVE * LANES] > 0.0
    commanded = block[at.ACTION * LANES] * plant.torque_limit
    count = to_counts(x.motor_angle, block[at.RESOLUTION * LANES])
    outputs[0], outputs[1], outputs[2], outputs[3] = x
    outputs[4], outputs[5] = tip.x, tip.y
    outputs[6] = block[at.TORQUE * LANES] if real_drive else commanded
    outputs[7] = min(max(count, -_MOST_COUNTS), _MOST_COUNTS)
