"""The observation vector: its layout, scaling and meaning, in one place.

Controllers and agents alike see this vector and nothing else. Every entry is a measured or a known quantity, divided by
a documented scale so that it is of order 1, and clipped at a documented bound. Errors are scaled by the precision
wanted, not by their range: 1.5 rad at the motor is 1 degree at the joint.

Measured quantities come from the motor's encoder: the angle in whole counts, the speed as the difference of two samples
over the control period. Its index pulse makes the angle within the motor's turn absolute; sine and cosine of twice that
angle are what torque ripple, friction and errors of the gear repeat with. The reference ahead is given at `LOOKAHEADS`,
and the move itself by start, goal, duration, ramp time and elapsed time: with its `profile`, which is not observed,
enough to rebuild the reference at any time. Of the torque there is what was commanded: what a drive makes of a command,
it does not report. Whether the gripper holds a part is known, for who closes it knows; the part's mass is not.
"""

from __future__ import annotations

from typing import Literal, NamedTuple, get_args

import numpy as np

from beltarm_env.arrays import Floats, Singles

LAYOUT = 3
"""Version of the entries: raise it where one is added or moved, or means something else."""
LOOKAHEADS = (0.03, 0.06, 0.12, 0.20, 0.40)
"""How far ahead of the current sample the reference is shown [s]."""


class Entry(NamedTuple):
    """One entry of the observation: scaled value = clip(physical, -bound, bound) / scale."""

    name: str
    unit: str
    scale: float
    bound: float


_MEASURED = (
    Entry("motor_angle_error", "rad", 1.5, 200.0),
    Entry("motor_speed_error", "rad/s", 8.0, 2000.0),
    Entry("motor_speed", "rad/s", 100.0, 2000.0),
    Entry("motor_angle", "rad", 100.0, 200.0),
    Entry("sin_2_motor_angle", "-", 1.0, 1.0),
    Entry("cos_2_motor_angle", "-", 1.0, 1.0),
)
_REFERENCE = (
    Entry("reference_angle", "rad", 1.0, 2.0),
    Entry("reference_speed", "rad/s", 1.0, 20.0),
    Entry("reference_acceleration", "rad/s^2", 10.0, 200.0),
    *(Entry(f"reference_speed_ahead_{1000 * ahead:.0f}ms", "rad/s", 1.0, 20.0) for ahead in LOOKAHEADS),
    *(Entry(f"reference_acceleration_ahead_{1000 * ahead:.0f}ms", "rad/s^2", 10.0, 200.0) for ahead in LOOKAHEADS),
)
_MOVE = (
    Entry("start", "rad", 1.0, 2.0),
    Entry("goal", "rad", 1.0, 2.0),
    Entry("duration", "s", 1.0, 2.0),
    Entry("ramp_time", "s", 0.2, 2.0),
    Entry("elapsed_time", "s", 1.0, 2.0),
    Entry("last_command", "of limit", 1.0, 1.0),
    Entry("holds_part", "-", 1.0, 1.0),
)
_ACCELERATIONS = (
    Entry("tip_acceleration_along", "m/s^2", 10.0, 80.0),
    Entry("tip_acceleration_across", "m/s^2", 10.0, 80.0),
)
_ENCODER = (*_MEASURED, *_REFERENCE, *_MOVE)

Sensors = Literal["encoder", "tip", "full", "accelerometer"]
SENSORS: tuple[Sensors, ...] = get_args(Sensors)
ENCODER, TIP, FULL, ACCELEROMETER = range(4)
ENTRIES: dict[str, tuple[Entry, ...]] = {
    "encoder": _ENCODER,
    "tip": (*_ENCODER, Entry("tip_speed", "m/s", 0.2, 20.0)),
    "full": (*_ENCODER, Entry("torsion", "rad", 0.05, 2.0), Entry("torsion_speed", "rad/s", 1.0, 200.0)),
    "accelerometer": (*_ENCODER, *_ACCELERATIONS),
}
"""The entries of each sensor tier, in the order of the vector."""
_SCALES: dict[str, Floats] = {
    sensors: np.array([entry.scale for entry in entries]) for sensors, entries in ENTRIES.items()
}


def size(sensors: str = "encoder") -> int:
    """Count the entries of a sensor tier's observation."""
    return len(ENTRIES[sensors])


def index(name: str, sensors: str = "encoder") -> int:
    """Find the position of the entry called `name`.

    Raises:
        ValueError: If the tier has no such entry.
    """
    names = [entry.name for entry in ENTRIES[sensors]]
    if name not in names:
        raise ValueError(f"no observation entry {name!r} with sensors={sensors!r}; entries: {', '.join(names)}")
    return names.index(name)


def scales(sensors: str = "encoder") -> Floats:
    """Return the physical value of 1.0 in each entry, shape (size,)."""
    return _SCALES[sensors].copy()


def bounds(sensors: str = "encoder") -> Singles:
    """Return the largest magnitude of each scaled entry, shape (size,)."""
    return np.array([entry.bound / entry.scale for entry in ENTRIES[sensors]], dtype=np.float32)


def decode(observation: Singles, sensors: str = "encoder") -> dict[str, Floats]:
    """Turn observations into physical units, by name.

    Args:
        observation: Shape (..., size).
        sensors: The sensor tier that produced it.

    Returns:
        One array of shape (...) per entry, in the unit of its `Entry`.

    Raises:
        ValueError: If the last axis does not have the tier's size.
    """
    observation = np.asarray(observation)
    if observation.shape[-1:] != (size(sensors),):
        raise ValueError(
            f"an observation with sensors={sensors!r} has {size(sensors)} entries, got shape {observation.shape}"
        )
    physical = observation * _SCALES[sensors]
    return {entry.name: physical[..., k] for k, entry in enumerate(ENTRIES[sensors])}
