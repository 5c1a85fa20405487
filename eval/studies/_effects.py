"""The effects of the drive one at a time and all together: names, units, and arms that have them in a given size.

The size of an effect is relative to the upper end of its training range: 0 is the ideal drive, 1 the worst that tuning
and training may see.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from beltarm_env import CONTROL_PERIOD
from beltarm_env.arm import COLUMN, DRIVE_EFFECTS
from beltarm_env.arrays import Floats
from beltarm_env.task.ranges import DRIVE_RANGES

ALL, IDEAL = "all", "ideal"
"""All effects together, and none."""


class Effect(NamedTuple):
    """How an effect is shown."""

    title: str
    unit: str
    scale: float  # of the unit: value shown over SI value
    sign: str = ""  # before values
    column: str = ""  # shorter title

    def worst(self, name: str) -> str:
        """Upper end of the training range with its unit."""
        return f"{self.sign}{self.shown(name, 1.0)} {self.unit}"

    def shown(self, name: str, size: float) -> str:
        """Value at a size, without unit."""
        end = 1.0 if name == ALL else DRIVE_RANGES[name][1]
        return f"{size * end * self.scale:.4g}"


EFFECTS = {
    "current_loop_time_constant": Effect("current loop's time constant", "ms", 1e3, column="current loop"),
    "command_latency": Effect("latency of the command", "samples", 1 / CONTROL_PERIOD, column="latency"),
    "torque_constant_error": Effect("error of the torque constant", "%", 100, "±", "torque constant"),
    "static_friction_excess": Effect("breakaway over Coulomb friction", "%", 100, "+", "breakaway"),
    "friction_variation": Effect("variation of friction over the turn", "%", 100, "±", "friction over the turn"),
    "torque_ripple": Effect("torque ripple", "mN m", 1e3),
    "kinematic_error": Effect("kinematic error of the gear", "mrad", 1e3, column="kinematic error"),
    "belt_stiffening": Effect("softer and stiffer belt", "%", 100, "±", "belt"),
    "friction_drift": Effect("drift of friction in the episode", "%", 100, "±", "drift of friction"),
    ALL: Effect("all of them", "% of the upper ends", 100),
}
"""By the name of the field, in the order of `DRIVE_EFFECTS`; and all together."""
assert (*DRIVE_EFFECTS, ALL) == tuple(EFFECTS)


def heading(name: str) -> str:
    """Title of an effect at the upper end of its training range."""
    if name in (ALL, IDEAL):
        return name
    effect = EFFECTS[name]
    return f"{effect.column or effect.title} {effect.worst(name)}"


def with_effect(table: Floats, name: str, size: float) -> Floats:
    """Arms whose drive is ideal but for one of `EFFECTS`, in a size over the upper end of its training range.

    Arms are rows of `table`. Phases, orders, Stribeck speeds and the signs of effects that have one stay as drawn.
    """
    driven = table.copy()
    for field in DRIVE_EFFECTS:
        column = getattr(COLUMN, field)
        there = name in (field, ALL) and size > 0
        driven[:, column] = np.copysign(size * DRIVE_RANGES[field][1], table[:, column]) if there else 0.0
    return driven
