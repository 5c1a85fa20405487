"""Ranges that the constants of an arm are drawn from, episode by episode."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from beltarm_env.arm import FIELDS, NOMINAL, ArmParams, params_table
from beltarm_env.arrays import Floats

Ranges = Mapping[str, tuple[float, float]]


def _around(name: str, share: float) -> tuple[float, float]:
    nominal = getattr(NOMINAL, name)
    return (1 - share) * nominal, (1 + share) * nominal


TRAIN_RANGES: Ranges = {
    "motor_inertia": _around("motor_inertia", 0.10),
    "motor_viscous_friction": _around("motor_viscous_friction", 0.30),
    "coulomb_friction": _around("coulomb_friction", 0.30),
    "arm_inertia": _around("arm_inertia", 0.20),
    "arm_inertia_swing": _around("arm_inertia_swing", 0.20),
    "belt_stiffness": _around("belt_stiffness", 0.20),
    "belt_damping_ratio": (0.002, 0.018),
    "payload_mass": (0.0, 0.2),
}
"""Ranges of the arms that training, tuning and the `randomized` split draw from, uniformly and independently."""


def resolve_ranges(randomization: Literal["off", "train"] | Ranges) -> dict[str, tuple[float, float]]:
    """Resolve the ranges of the fields that vary.

    Args:
        randomization: "off", "train" (`TRAIN_RANGES`), or a mapping from field name to (low, high).

    Raises:
        ValueError: On an unknown word or field, on low > high, or where an end of the range makes no arm.
        TypeError: If it is neither a word nor a mapping of pairs.
    """
    if isinstance(randomization, str):
        if randomization not in ("off", "train"):
            raise ValueError(f"randomization must be 'off', 'train' or a mapping of ranges, got {randomization!r}")
        return {} if randomization == "off" else dict(TRAIN_RANGES)
    if not isinstance(randomization, Mapping):
        raise TypeError(f"randomization must be 'off', 'train' or a mapping of ranges, got {randomization!r}")
    ranges = {}
    for name, pair in randomization.items():
        if name not in FIELDS:
            raise ValueError(f"randomization names an unknown parameter {name!r}; known: {', '.join(FIELDS)}")
        try:
            low, high = pair
        except (TypeError, ValueError):
            raise TypeError(f"randomization[{name!r}] must be a pair (low, high), got {pair!r}") from None
        for end in (low, high):
            ArmParams(**{name: end})
        if low > high:
            raise ValueError(f"randomization[{name!r}] has low {low!r} above high {high!r}; swap them")
        ranges[name] = (float(low), float(high))
    return ranges


def range_bounds(ranges: Ranges) -> Floats:
    """Return the lowest and highest value of every field, shape (2, len(FIELDS)); equal where a field does not vary."""
    return params_table([ArmParams(**{name: pair[end] for name, pair in ranges.items()}) for end in (0, 1)])
