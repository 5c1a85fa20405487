"""Ranges that the constants of an arm are drawn from, episode by episode, and the design model in their middle."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import Literal, cast

import numpy as np

from beltarm_env.arm import FIELDS, NOMINAL, WHOLE, ArmParams, params_table
from beltarm_env.arrays import Floats
from beltarm_env.engine import compiled
from beltarm_env.task.draws import OF_ARM
from beltarm_env.timing import CONTROL_PERIOD

Ranges = Mapping[str, tuple[float, float]]
Randomization = Literal["off", "ideal", "train"] | Ranges


EDITION = 2
"""Of arm and drive: raise it where the same episode would have another arm, as since 1, which had an ideal drive.

Presliding and shifts left it as it was: they only add episodes.
"""


def _around(name: str, share: float) -> tuple[float, float]:
    nominal = getattr(NOMINAL, name)
    return (1 - share) * nominal, (1 + share) * nominal


IDEAL_RANGES: Ranges = {
    "motor_inertia": _around("motor_inertia", 0.10),
    "motor_viscous_friction": _around("motor_viscous_friction", 0.30),
    "coulomb_friction": _around("coulomb_friction", 0.30),
    "arm_inertia": _around("arm_inertia", 0.20),
    "arm_inertia_swing": _around("arm_inertia_swing", 0.20),
    "belt_stiffness": _around("belt_stiffness", 0.20),
    "belt_damping_ratio": (0.002, 0.018),
    "payload_mass": (0.0, 0.2),
}
"""Ranges of arms with an ideal drive, each drawn uniformly and independently."""

_TURN = (0.0, 2 * math.pi)
DRIVE_RANGES: Ranges = {
    "current_loop_time_constant": (0.0001, 0.001),
    "command_latency": (0.0, 1.5 * CONTROL_PERIOD),
    "torque_constant_error": (-0.10, 0.10),
    "static_friction_excess": (0.0, 0.5),
    "stribeck_speed": (1.0, 10.0),
    "friction_variation": (0.0, 0.25),
    "friction_variation_phase": _TURN,
    "torque_ripple": (0.0, 0.02 * NOMINAL.torque_limit),
    "torque_ripple_order": (4.0, 12.0),
    "torque_ripple_phase": _TURN,
    "kinematic_error": (0.0, 0.0003),
    "kinematic_error_phase": _TURN,
    "belt_stiffening": (0.0, 0.25),
    "friction_drift": (-0.15, 0.15),
}
"""Ranges of the real drive, each drawn uniformly and independently; sources in docs/science/physics.md."""

PART_MASS = (0.05, 0.5)
"""Range of the masses that an arm carries in the loaded moves of a shift [kg], see `task.shift`."""

PRESLIDING: Ranges = {"presliding_deflection": (0.0003, 0.005)}
"""Range of a motor that gives before it slips [rad]; not among `TRAIN_RANGES`."""

TRAIN_RANGES: Ranges = {**IDEAL_RANGES, **DRIVE_RANGES}
"""Ranges of single moves, "train": arm and drive."""

SHIFT_RANGES: Ranges = {**TRAIN_RANGES, **PRESLIDING, "payload_mass": PART_MASS}
"""Ranges of working shifts, "train" with several moves: of tuning, of training, and of the split `shift`."""


RANGES: dict[str, Ranges] = {"off": {}, "ideal": IDEAL_RANGES, "train": TRAIN_RANGES}
"""By the word that users give as `randomization`, in episodes of one move."""

_OF_SHIFTS = {word: {**ranges, "payload_mass": PART_MASS} for word, ranges in RANGES.items()} | {"train": SHIFT_RANGES}

_WHOLE_COLUMNS = np.array([FIELDS.index(name) for name in WHOLE])
_OF_UNKNOWN_PHASE = ("friction_variation", "torque_ripple", "kinematic_error")


def design_model() -> ArmParams:
    """Return the arm that every controller may know before it moves: the middle of the training ranges, a data sheet.

    Ripple, kinematic error and variation of friction are zero in it: their phases differ from arm to arm, and over all
    phases their mean is zero.
    """
    middle = {name: 0.5 * (low + high) for name, (low, high) in TRAIN_RANGES.items() if not name.endswith("_phase")}
    return ArmParams(**{**middle, **dict.fromkeys(_OF_UNKNOWN_PHASE, 0.0)})


def resolve_ranges(randomization: Randomization, moves: int = 1) -> dict[str, tuple[float, float]]:
    """Resolve the ranges of the fields that vary.

    Args:
        randomization: "off", "ideal" (`IDEAL_RANGES`), "train" (`TRAIN_RANGES`), or a mapping from field name to
            (low, high).
        moves: Of an episode. Where there are several, "train" means `SHIFT_RANGES`, and parts weigh `PART_MASS` with
            any word.

    Raises:
        ValueError: On an unknown word or field, on low > high, or where an end of the range makes no arm.
        TypeError: If it is neither a word nor a mapping of pairs.
    """
    if isinstance(randomization, str):
        if randomization not in RANGES:
            raise ValueError(
                f"randomization must be 'off', 'ideal', 'train' or a mapping of ranges, got {randomization!r}"
            )
        return dict((RANGES if moves == 1 else _OF_SHIFTS)[randomization])
    if not isinstance(randomization, Mapping):
        raise TypeError(f"randomization must be 'off', 'ideal', 'train' or a mapping of ranges, got {randomization!r}")
    ranges = {}
    for name, pair in randomization.items():
        if name not in FIELDS:
            raise ValueError(f"randomization names an unknown parameter {name!r}; known: {', '.join(FIELDS)}")
        try:
            if isinstance(pair, set | frozenset | Mapping):
                raise TypeError  # which have no order
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


def shared_bounds(randomization: Randomization, moves: int) -> Floats:
    """Return `range_bounds` of `resolve_ranges`, of a word the same array for all environments: it must not be written.

    Raises:
        ValueError: See `resolve_ranges`.
        TypeError: See `resolve_ranges`.
    """
    if isinstance(randomization, str):
        return _bounds_of_word(str(randomization), moves)
    return range_bounds(resolve_ranges(randomization, moves))


@cache
def _bounds_of_word(word: str, moves: int) -> Floats:
    # It can be written as those of a mapping can: kernels for arrays that cannot are others.
    return range_bounds(resolve_ranges(cast("Randomization", word), moves))


@compiled
def draw_table(bounds: Floats, uniforms: Floats, table: Floats) -> None:
    """Draw n arms within bounds.

    Each field is uniform over its range, and one of whole numbers over the whole numbers in it.

    Args:
        bounds: From `range_bounds`, shape (2, len(FIELDS)).
        uniforms: Numbers in [0, 1), shape (n, DRAWS).
        table: Written, shape (n, len(FIELDS)).
    """
    for i in range(len(table)):
        for k in range(len(OF_ARM)):
            low, high, uniform = bounds[0, k], bounds[1, k], uniforms[i, OF_ARM[k]]
            table[i, k] = low + uniform * (high - low)
        for k in _WHOLE_COLUMNS:
            low, high, uniform = math.ceil(bounds[0, k]), math.floor(bounds[1, k]), uniforms[i, OF_ARM[k]]
            if low < high:
                table[i, k] = min(low + math.floor(uniform * (high - low + 1)), high)
