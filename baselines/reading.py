"""Observations decoded into physical units, for a batch of arms."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import wraps
from typing import Any, NamedTuple

import numpy as np

from beltarm_env import CONTROL_PERIOD, EPISODE_STEPS, ArmParams, observation
from beltarm_env.arrays import Flags, Floats, Integers, Singles
from beltarm_env.engine import compiled, inlined
from beltarm_env.physics.trigonometry import ROUNDER
from beltarm_env.task.reference import MoveShape


class Reading(NamedTuple):
    """Measurements and reference of n arms; arrays of shape (n,) but for `move`."""

    angle_error: Floats  # reference minus measured motor angle [rad]
    speed_error: Floats  # reference minus measured motor speed [rad/s]
    motor_angle: Floats  # theta_a by the encoder [rad]
    motor_speed: Floats  # by differencing it [rad/s]
    reference_angle: Floats  # of the joint [rad]
    reference_speed: Floats  # [rad/s]
    reference_acceleration: Floats  # [rad/s^2]
    move: Floats  # start, goal [rad], duration, ramp time [s]; shape (n, 4)
    step: Integers  # control periods since the move's start; on a drive that runs on, at most 1333
    last_command: Floats  # torque commanded over the last period [N m]
    holds_part: Floats  # 1 where the gripper holds a part, else 0
    torsion: Floats | None  # theta_s [rad] and its rate [rad/s], shape (n, 2); of sensors="full" alone
    acceleration: Floats | None  # of the tip along and across the hand [m/s^2], (n, 2); of "accelerometer" alone


_MOVE_FIELD = Reading._fields.index("move")


class Sample(NamedTuple):
    """Measurements and reference of one arm, as a kernel sees them; fields as of `Reading`."""

    angle_error: float
    speed_error: float
    motor_angle: float
    motor_speed: float
    reference_angle: float
    reference_speed: float
    reference_acceleration: float
    start: float
    goal: float
    duration: float
    ramp_time: float
    step: int
    last_command: float
    holds_part: float


@inlined
def sample_of(reading: Reading, arm: int) -> Sample:
    """What one arm of a batch reads."""
    parts: Any = reading
    measured = (part[arm] for part in parts[:_MOVE_FIELD])
    move = (reading.move[arm, k] for k in range(4))
    return Sample._make((*measured, *move, reading.step[arm], reading.last_command[arm], reading.holds_part[arm]))


@inlined
def move_of(now: Sample) -> MoveShape:
    """The move that one arm is on."""
    return MoveShape(now.start, now.goal, now.duration, now.ramp_time)


_SCALES = observation.scales()
_ENCODER_SIZE = len(_SCALES)  # other tiers have their own entries after it
_BEFORE_STEP = tuple(map(observation.index, ("motor_angle_error", "motor_speed_error", *Sample._fields[2:11])))
"""Entries of an observation, in the order of a `Sample`'s fields up to the step."""
_STEP = _MOVE_FIELD + 4  # of a `Sample`'s fields
_ELAPSED, _LAST, _HOLDS = map(observation.index, ("elapsed_time", "last_command", "holds_part"))
_DURATION, _RAMP = map(observation.index, ("duration", "ramp_time"))
_FIRST = 0.5 * CONTROL_PERIOD / _SCALES[_ELAPSED]  # elapsed time that belongs to the first sample, scaled


@inlined
def sample_from(seen: Singles, torque_limit: float) -> Sample:
    """Decode one arm's observation, shape (size,): as `read` does, in a kernel.

    Args:
        seen: Of the encoder alone.
        torque_limit: That commands are scaled by [N m].
    """
    entries, elapsed = (seen[k] * _SCALES[k] for k in _BEFORE_STEP), seen[_ELAPSED] * _SCALES[_ELAPSED] / CONTROL_PERIOD
    command, holds_part = seen[_LAST] * _SCALES[_LAST] * torque_limit, seen[_HOLDS] * _SCALES[_HOLDS]
    return Sample._make((*entries, int((elapsed + ROUNDER) - ROUNDER), command, holds_part))


def one_or_many(predict: Callable[..., tuple[Singles, Any]]) -> Callable[..., tuple[Singles, Any]]:
    """Let a method `predict` take the observation of a single arm, of shape (size,), as well; its action is (1,).

    `episode_start` may be one flag for all. What is no number of 32 or 64 bits becomes one; other shapes are refused.
    """

    @wraps(predict)
    def either(
        self: Any, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Singles, Any]:
        seen = observation if isinstance(observation, np.ndarray) else np.asarray(observation)
        seen = seen if seen.dtype.char in "fd" else seen.astype(np.float32)
        if seen.ndim == 1:
            action, memory = either(self, seen[None], state, episode_start, deterministic)
            return action[0], memory
        if seen.ndim != 2:
            raise ValueError(f"observations must have shape (size,) or (n, size), got {seen.shape}")
        if episode_start is not None and getattr(episode_start, "shape", ()) != (len(seen),):
            flags, count = np.asarray(episode_start, np.bool_), len(seen)
            if flags.shape not in ((count,), (1,), ()):
                raise ValueError(
                    f"episode_start must have shape ({count},) for as many observations, got {flags.shape}"
                )
            episode_start = np.broadcast_to(flags, count).copy()
        return predict(self, seen, state, episode_start, deterministic)

    return either


def read(observations: Singles, params: ArmParams, sensors: str = "encoder") -> Reading:
    """Decode observations of shape (n, size).

    Args:
        observations: Of `sensors` or of a tier with more entries, which are ignored.
        params: Arm with the torque limit that commands are scaled by.
        sensors: "encoder", "full" for the torsion as well, or "accelerometer" for the tip's acceleration.

    Raises:
        ValueError: If there are fewer entries than the sensors have, or no sensor gives one of them.
    """
    _require_entries(observations, sensors)
    size = observation.size(sensors)
    seen = np.empty((len(Sample._fields), len(observations)))
    sound = _write_samples(np.ascontiguousarray(observations[:, :size]), params.torque_limit, seen)
    if not sound:
        raise ValueError(
            "observations must be finite, elapsed_time within 0 and 1.8 s, and duration above ramp_time above 0, got "
            + _worst(observations)
        )
    extra = observations[:, _ENCODER_SIZE:size] * observation.scales(sensors)[_ENCODER_SIZE:]
    start = _MOVE_FIELD
    return Reading(
        *seen[:start],
        move=np.ascontiguousarray(seen[start:_STEP].T),
        step=seen[_STEP].astype(np.intp),
        last_command=seen[_STEP + 1],
        holds_part=seen[_STEP + 2],
        torsion=extra if sensors == "full" else None,
        acceleration=extra if sensors == "accelerometer" else None,
    )


def _require_entries(observations: Singles, sensors: str = "encoder") -> None:
    size = observation.size(sensors)
    if observations.ndim != 2 or observations.shape[1] < size:
        remedy = "" if sensors == "encoder" else f": use an environment with sensors={sensors!r}"
        raise ValueError(f"observations must have shape (n, {size}) or wider, got {observations.shape}{remedy}")


def _worst(observations: Singles) -> str:
    """Name an entry of an observation that no sensor gives."""
    wrong, elapsed = ~np.isfinite(observations), observations[:, _ELAPSED] * _SCALES[_ELAPSED] / CONTROL_PERIOD
    wrong[:, _ELAPSED] |= ~((elapsed > -0.5) & (elapsed < EPISODE_STEPS + 0.5))
    ramp = observations[:, _RAMP] * _SCALES[_RAMP]
    wrong[:, _RAMP] |= ~(ramp > 0)
    wrong[:, _DURATION] |= ~(observations[:, _DURATION] * _SCALES[_DURATION] > ramp)
    arm, entry = np.argwhere(wrong)[0]
    name = observation.ENTRIES["encoder"][entry].name if entry < _ENCODER_SIZE else f"entry {entry}"
    return f"{name} {observations[arm, entry]:g} for arm {arm}"


@compiled
def _write_samples(observations: Singles, torque_limit: float, samples: Floats) -> bool:
    """Write the samples of n arms, a row for each field, which laws read faster; return whether all are in bounds."""
    sound = True
    for i in range(len(observations)):
        doubt = 0.0
        for k in range(observations.shape[1]):
            doubt += observations[i, k] - observations[i, k]  # 0 of what is finite
        elapsed = observations[i, _ELAPSED] * _SCALES[_ELAPSED] / CONTROL_PERIOD
        ramp = observations[i, _RAMP] * _SCALES[_RAMP]
        moves = (ramp > 0) & (observations[i, _DURATION] * _SCALES[_DURATION] > ramp)
        bounded = (doubt == 0.0) & (elapsed > -0.5) & (elapsed < EPISODE_STEPS + 0.5) & moves
        sound = sound and bounded
        if bounded:
            for k, value in enumerate(sample_from(observations[i], torque_limit)):
                samples[k, i] = value
    return sound


def chosen(which: Flags, these: Any, others: Any) -> Any:
    """Rows of `these` for arms in `which`, shape (n,), and of `others` for the rest; arrays with the arms first."""
    return np.where(which.reshape(-1, *[1] * (these.ndim - 1)), these, others)


def beginning(memory: object, episode_start: Flags | None, observations: Singles, remembers: bool = False) -> Flags:
    """Which arms begin a move with this call, shape (n,): all of them if there is no memory yet.

    A move begins where an episode does, and where none of its time has passed.

    Args:
        memory: Of a controller, None before its first call.
        episode_start: Which arms begin an episode, shape (n,); None for none of them.
        observations: Shape (n, size).
        remembers: Whether the controller's memory lasts from move to move, so that only an episode begins anew.

    Raises:
        ValueError: If observations have fewer entries than the encoder's.
    """
    _require_entries(observations)
    if memory is None:
        return np.ones(len(observations), np.bool_)
    if remembers:
        return np.zeros(len(observations), np.bool_) if episode_start is None else np.asarray(episode_start, np.bool_)
    begins = observations[:, _ELAPSED] < _FIRST
    return begins if episode_start is None else begins | np.asarray(episode_start, np.bool_)


def warn_if_amid_a_move(observations: Singles) -> None:
    """Warn that a controller which remembers was called without its state, unless all moves begin."""
    if (observations[:, _ELAPSED] >= _FIRST).any():
        forgot = "predict was called amid a move with state=None, and begins anew: pass the state that it returned last"
        warnings.warn(forgot, stacklevel=4)


def require_memory(memory: object, kind: type) -> None:
    """Refuse, by ValueError, what is neither None nor the memory of a kind of controllers."""
    if memory is not None and not isinstance(memory, kind):
        name = type(memory).__name__
        raise ValueError(
            f"state must be the {kind.__name__} that this controller returned, got {name}: begin with None"
        )


def copied_memory(memory: Any, *shape: int) -> Any:
    """Copy an array that a controller remembers, see `require_shape`; zeros where nothing is remembered yet."""
    if memory is None:
        return np.zeros(shape)
    require_shape(memory, *shape)
    return memory.astype(np.float64)


def require_shape(memory: Any, *shape: int) -> None:
    """Refuse, by ValueError, what is no array of this shape: the memory of other arms, or of another controller."""
    if not isinstance(memory, np.ndarray) or memory.shape != shape:
        found = f"shape {memory.shape}" if isinstance(memory, np.ndarray) else type(memory).__name__
        raise ValueError(
            f"state must be what this controller returned for these {shape[0]} observations, of shape {shape}, got "
            f"{found}: begin with state=None"
        )
