"""One sample of the stick-slip observer, for one arm and for many: the kernels of `baselines.estimation.observer`.

Of many arms, the model is simulated side by side; the correction is that of one arm, arm by arm.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from baselines.models.linear import between, place
from baselines.reading import Sample
from beltarm_env.arm import COLUMN
from beltarm_env.arrays import Flags, Floats
from beltarm_env.engine import compiled, inlined
from beltarm_env.kernels.layout import LANES
from beltarm_env.kernels.simulate import (
    Room,
    X,
    advance_arm,
    hold_friction,
    load_arm,
    look_ahead,
    rest_arm,
)
from beltarm_env.physics.models import LUMPED
from beltarm_env.task.sensors import ENCODER_COUNTS

QUANTUM = 2 * np.pi / ENCODER_COUNTS
"""One count of the encoder [rad]."""
SLIDES = 2 * QUANTUM
"""An innovation that a motor at rest cannot cause [rad]."""
AT_REST = 0.2
"""Correction of the angle of a motor at rest, per sample."""
_AT_REST = np.array([AT_REST, 0.0, 0.0, 0.0, 0.0])
LARGEST_TORQUE = 0.05
"""Of d [N m]: beyond any friction's error."""
LARGEST = np.array([300.0, 2000.0, 2.0, 200.0])
"""Of x: keeps an estimate that has diverged finite."""


class ObserverDesign(NamedTuple):
    """What a filter of one arm knows: the design model, and its gains."""

    row: Floats  # constants of the design model, as the fields of `ArmParams`
    gains: Floats  # L at each of `ANGLES`, shape (46, 5)
    delay: float  # dead time of the drive [samples]


class Track(NamedTuple):
    """Memory of a filter of one arm, written in place."""

    state: Floats  # of arm and drive, shape (size,)
    ahead: Floats  # x at the time at which a command of now acts, shape (4,)
    disturbance: Floats  # d [N m], shape (1,)
    moved: Floats  # room for a state, shape (size,)
    room: Room


@inlined
def acting_torque(command: float, motor_speed: float, disturbance: float) -> float:
    """Torque u + d [N m]; a motor that sticks has no disturbance."""
    return command + (disturbance if motor_speed != 0.0 else 0.0)


@inlined
def limited(value: float, largest: float) -> float:
    """The value within its bounds, -largest and largest."""
    return min(max(value, -largest), largest)


@inlined
def sticks(state: Floats, motor_angle: float) -> bool:
    """Whether a motor is taken to stick, by its predicted state, shape (size,), and the encoder [rad]."""
    return (state[1] == 0.0) & (abs(motor_angle - state[0]) <= SLIDES)


@compiled
def correct(design: ObserverDesign, state: Floats, disturbance: float, motor_angle: float) -> float:
    """Correct the predicted state of one arm by its encoder, and return the corrected disturbance [N m].

    Args:
        design: Of the filter.
        state: Predicted, shape (size,); x in it is written.
        disturbance: d [N m], that of the last sample.
        motor_angle: theta_a by the encoder [rad].
    """
    at_rest, innovation = sticks(state, motor_angle), motor_angle - state[0]
    row, weight = place(state[0] / design.row[COLUMN.gear_ratio])
    for i in range(X):
        gain = _AT_REST[i] if at_rest else between(design.gains[row, i], design.gains[row + 1, i], weight)
        state[i] = limited(state[i] + gain * innovation, LARGEST[i])
    gain = _AT_REST[X] if at_rest else between(design.gains[row, X], design.gains[row + 1, X], weight)
    return limited(disturbance + gain * innovation, LARGEST_TORQUE)


@compiled
def track_arm(design: ObserverDesign, now: Sample, begins: bool, track: Track) -> None:
    """Bring the estimate of one arm up to this sample, see `StickSlipObserver.update`."""
    limit, command = float(design.row[COLUMN.torque_limit]), 0.0 if begins else now.last_command
    if begins:
        load_arm(track.room.blocks, 0, design.row, LUMPED)
        hold_friction(track.room.blocks, 0)
        rest_arm(track.room.blocks, 0, now.motor_angle, track.state)
        track.disturbance[0] = 0.0
    else:
        torque = acting_torque(command, track.state[1], track.disturbance[0])
        advance_arm(track.room, track.state, torque, limit, LUMPED)
        track.disturbance[0] = correct(design, track.state, track.disturbance[0], now.motor_angle)
    torque = acting_torque(command, track.state[1], track.disturbance[0])
    look_ahead(track.room, track.state, torque, limit, design.delay, LUMPED, track.ahead, track.moved)


@compiled
def acting_torques(commands: Floats, begins: Flags, states: Floats, disturbances: Floats, torques: Floats) -> None:
    """Write the torques that act on n arms [N m], see `acting_torque`; those that begin have no command yet."""
    for i in range(len(states)):
        torques[i] = acting_torque(0.0 if begins[i] else commands[i], states[i, 1], disturbances[i])


@compiled
def correct_arms(
    design: ObserverDesign, states: Floats, last: Floats, motor_angles: Floats, begins: Flags, disturbances: Floats
) -> None:
    """Correct the predicted states of n arms, and write their disturbances [N m] from those of the last sample."""
    for i in range(len(states)):
        disturbances[i] = 0.0 if begins[i] else correct(design, states[i], last[i], motor_angles[i])


@compiled
def begin_arms(blocks: Floats, motor_angles: Floats, begins: Flags, states: Floats, disturbances: Floats) -> None:
    """Put those of n arms that begin at rest where their encoders are [rad], without a disturbance."""
    for i in range(len(states)):
        if begins[i]:
            rest_arm(blocks[i // LANES], i % LANES, motor_angles[i], states[i])
            disturbances[i] = 0.0
