"""Arms that studies draw, the effects of their drives, and controllers that several studies run on them.

The size of an effect is relative to the upper end of its training range: 0 is the ideal drive, 1 the worst that tuning
and training may see.
"""

from dataclasses import fields, replace
from typing import Any, NamedTuple

import numpy as np

from baselines.gains import tuned
from baselines.optimal.adaptive import AdaptiveController, AdaptiveGains
from baselines.yardsticks.privileged import PrivilegedController
from beltarm_env import CONTROL_PERIOD, BeltArmVectorEnv
from beltarm_env.arm import COLUMN, DRIVE_EFFECTS
from beltarm_env.arrays import Floats
from beltarm_env.task.ranges import DRIVE_RANGES

_NOISE = ("torque", "acceleration", "disturbance", "memory", "kinematic_error")  # of `Uncertainty`, beside doubts
_UNEXPLAINED = 5e-3  # [N m], of a filter that identifies nothing: what one torque has to stand for then


def drawn(count: int, seed: int, randomization: Any = "train") -> BeltArmVectorEnv:
    """Arms at the beginning of their moves, as `rollout` draws them: arm i has seed + i."""
    env = BeltArmVectorEnv(count, randomization=randomization)
    env.reset(seed=seed)
    return env


def privileged(count: int, seed: int, randomization: Any = "train") -> PrivilegedController:
    """The oracle for the arms that `drawn` draws."""
    return PrivilegedController(list(drawn(count, seed, randomization).params))


class _Forgetful(AdaptiveController):
    """`adaptive` that meets its arm anew in every move."""

    remembers = False


def believing(*held: str, remembers: bool = False) -> AdaptiveController:
    """`adaptive`, which plans with squares, and believes some of its `Uncertainty` to be what the design model says.

    `held` is what it believes; where it `remembers`, its belief lasts from move to move.
    """
    gains, kind = tuned("adaptive", AdaptiveGains), AdaptiveController if remembers else _Forgetful
    return kind(gains, uncertainty=replace(gains.uncertainty(), **dict.fromkeys(held, 0.0)), improvements=0)


def identifying_nothing() -> AdaptiveController:
    """`adaptive` that believes in the design model, and explains what it sees by a disturbance."""
    gains = tuned("adaptive", AdaptiveGains)
    sure = {doubt.name: 0.0 for doubt in fields(gains.uncertainty()) if doubt.name not in _NOISE}
    doubts = replace(gains.uncertainty(), **sure, disturbance=max(_UNEXPLAINED, gains.unexplained_torque))
    return _Forgetful(gains, uncertainty=doubts, improvements=0)


# Effects of the drive

ALL, IDEAL = "all", "ideal"
"""All effects together, and none."""


class Effect(NamedTuple):
    """How an effect is shown."""

    title: str
    unit: str
    scale: float  # of the unit: value shown over SI value
    sign: str = ""  # before values
    column: str = ""  # shorter title

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
"""By the name of the field of an effect that the training ranges have; and all together."""


def heading(name: str, size: float = 1.0) -> str:
    """Title of an effect in a size, by default at the upper end of its training range."""
    if name in (ALL, IDEAL):
        return name
    effect = EFFECTS[name]
    return f"{effect.column or effect.title} {effect.sign}{effect.shown(name, size)} {effect.unit}"


def with_effect(table: Floats, name: str, size: float) -> Floats:
    """Arms whose drive is ideal but for one of `EFFECTS`, in a size over the upper end of its training range.

    Arms are rows of `table`. Phases, orders, Stribeck speeds and the signs of effects that have one stay as drawn.
    """
    real = table.copy()
    for field in DRIVE_EFFECTS:
        column = getattr(COLUMN, field)
        there = name in (field, ALL) and field in EFFECTS and size > 0
        real[:, column] = np.copysign(size * DRIVE_RANGES[field][1], table[:, column]) if there else 0.0
    return real
