"""What a controller reads from its observation, in physical units."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltarm_env import CONTROL_PERIOD, ArmParams, observation
from beltarm_env.observation import index

Floats = NDArray[np.float64]

_ENTRIES = observation.size("encoder")
_SCALES = observation.scales("encoder")
_MOVE = slice(index("start"), index("ramp_time") + 1)


class Reading(NamedTuple):
    """Measurements and reference of n arms; arrays of shape (n,) but for `move`."""

    motor_angle: Floats  # theta_a by the encoder [rad]
    motor_speed: Floats  # by differencing it [rad/s]
    reference_angle: Floats  # of the joint [rad]
    reference_speed: Floats  # [rad/s]
    reference_acceleration: Floats  # [rad/s^2]
    move: Floats  # start, goal [rad], duration, ramp time [s]; shape (n, 4)
    step: NDArray[np.intp]  # control periods since the move's start
    last_torque: Floats  # held over the last period [N m]


def read(observations: NDArray[np.float32], params: ArmParams) -> Reading:
    """Decode observations of shape (n, size) for arms with the nominal gear ratio and torque limit of `params`.

    Raises:
        ValueError: If there are fewer entries than encoder and reference have.
    """
    if observations.ndim != 2 or observations.shape[1] < _ENTRIES:
        raise ValueError(f"observations must have shape (n, {_ENTRIES}) or wider, got {observations.shape}")
    values = observations[:, :_ENTRIES].astype(np.float64) * _SCALES
    error, _, speed, angle, reference_speed, acceleration = values[:, :6].T
    return Reading(
        motor_angle=params.gear_ratio * angle - error,
        motor_speed=speed,
        reference_angle=angle,
        reference_speed=reference_speed,
        reference_acceleration=acceleration,
        move=values[:, _MOVE],
        step=np.rint(values[:, index("elapsed_time")] / CONTROL_PERIOD).astype(np.intp),
        last_torque=values[:, index("last_torque")] * params.torque_limit,
    )


def beginning(memory: object, episode_start: NDArray[np.bool_] | None, count: int) -> NDArray[np.bool_]:
    """Which of `count` arms begin an episode with this call, shape (count,): all of them if there is no memory yet."""
    if memory is None:
        return np.ones(count, np.bool_)
    return np.zeros(count, np.bool_) if episode_start is None else np.asarray(episode_start, np.bool_)


def as_action(torque: Floats, params: ArmParams) -> NDArray[np.float32]:
    """Torque [N m] of shape (n,) as actions of shape (n, 1), cut at the limit."""
    return np.clip(torque / params.torque_limit, -1, 1).astype(np.float32)[:, None]
