"""Margins that tuned gains have to keep: on the design model and at corners of the training ranges, at every angle.

Eleven constants that the training ranges vary touch the linear loop, `LOOP_FIELDS`. Of their 2048 corners nine are
asked about, chosen by what fails:

- the belt's damping always at its lower end, and viscous friction but once: they damp the mode for every loop;
- a light arm on a stiff belt behind a late drive: the fastest mode with the longest delay. A strong torque constant and
  a light motor are the highest gain, which most loops bear worst; with a weak one those fail whose observer expects it;
- the same with the slow mode of a load, of which a payload alone leaves the light arm's at 0 degrees;
- the slowest mode behind a heavy motor, which integral action excites;
- drives prompt and weak, for loops that rest on their gain, with stiff and with soft belts; and with a soft belt and
  much viscous friction, for observers that expect less of it.

Of 34 loops of all kinds with random gains, which were not looked at for the choice, those that pass here pass at all
2048 corners, and none has a modulus margin there that is more than 0.05 less. On 300 arms from within the ranges a loop
that feeds back the torsion of one simulated mode (`paper`) had less than at any corner: for a frequency in between.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from baselines.estimation.believed_arm import IDENTIFIED
from baselines.estimation.identification import IdentifyingController
from baselines.loops.margins import Margins, margins_from_poles
from baselines.loops.models import (
    Loop,
    Poles,
    System,
    arms_at_angles,
    closed_poles,
    laws_at_angles,
    open_poles,
    stacked,
)
from baselines.models.linear import ANGLES
from beltarm_env import ArmParams
from beltarm_env.arrays import Floats
from beltarm_env.task.ranges import TRAIN_RANGES, design_model

LOOP_FIELDS = (
    *("motor_inertia", "motor_viscous_friction", "arm_inertia", "arm_inertia_swing", "payload_mass"),
    *("belt_stiffness", "belt_stiffening", "belt_damping_ratio"),
    *("current_loop_time_constant", "command_latency", "torque_constant_error"),
)
"""Constants of an arm that its linear loop depends on, and that the training ranges vary."""


def corner(*high: str) -> ArmParams:
    """The arm at the upper ends of some training ranges and the lower ends of the others of `LOOP_FIELDS`."""
    ends = {name: TRAIN_RANGES[name][name in high] for name in LOOP_FIELDS}
    return replace(design_model(), **ends)


_IDENTIFIED_DRIVE = ("command_latency", "current_loop_time_constant", "belt_stiffening")
_LATE = ("current_loop_time_constant", "command_latency")
_STIFF_LATE = ("belt_stiffness", *_LATE)
_LOAD = ("arm_inertia_swing", "payload_mass")
CORNERS = {
    "design model": design_model(),
    "stiff, late, strong": corner(*_STIFF_LATE, "torque_constant_error"),
    "stiff, late": corner(*_STIFF_LATE),
    "stiff": corner("belt_stiffness"),
    "loaded, stiff, late, strong": corner(*_LOAD, *_STIFF_LATE, "torque_constant_error"),
    "payload, stiff, late, heavy motor": corner("motor_inertia", "payload_mass", *_STIFF_LATE),
    "loaded, softest, late, heavy motor": corner("motor_inertia", "arm_inertia", *_LOAD, "belt_stiffening", *_LATE),
    "soft": corner("arm_inertia"),
    "payload, soft": corner("arm_inertia", "payload_mass"),
    "viscous, soft": corner("motor_viscous_friction", "arm_inertia", "belt_stiffening"),
}
"""Arms on which margins are asked for, by name; what a name does not say is at its lower end."""


class LeastMargins(NamedTuple):
    """The worst of a controller over arms and angles, and where."""

    growth: float  # largest |z| of a closed pole, less 1: negative where all loops are stable
    modulus: float  # 0 if a loop is unstable
    modulus_at: str
    delay: float  # [samples]; 0 if a loop is unstable
    delay_at: str


def margins_on(controller: Any, arms: Sequence[str] = tuple(CORNERS)) -> tuple[Margins, Poles]:
    """Margins, and poles z of the closed loop, of a controller on some of `CORNERS` at all angles.

    Returns:
        Margins of shape (arms, 46) each, and poles of shape (arms, 46, m).

    Raises:
        ValueError: If there is no linear law for the controller.
    """
    names = tuple(arms)
    loops = Loop(_laws(controller, names), _arms(names))
    closed = closed_poles(loops)
    return margins_from_poles(open_poles(loops), closed), closed


def least_margins(controller: Any, arms: Sequence[str] = tuple(CORNERS)) -> LeastMargins:
    """Least margins of a controller over some of `CORNERS` and all angles; errors as of `margins_on`."""
    names = tuple(arms)
    found, closed = margins_on(controller, names)
    growth = np.abs(closed).max(axis=-1) - 1
    # Where loops are unstable, the worst is the one that diverges fastest.
    modulus, delay = (np.where(found.stable, values, -growth) for values in (found.modulus, found.delay))
    return LeastMargins(
        growth=float(growth.max()),
        modulus=max(0.0, float(modulus.min())),
        modulus_at=_place(modulus, names),
        delay=max(0.0, float(delay.min())),
        delay_at=_place(delay, names),
    )


def _place(values: Floats, names: tuple[str, ...]) -> str:
    arm, k = np.unravel_index(int(values.argmin()), values.shape)
    return f"{names[arm]}, {np.degrees(ANGLES[k]):.0f}°"


@lru_cache(maxsize=4)
def _arms(names: tuple[str, ...]) -> System:
    return arms_at_angles([CORNERS[name] for name in names])


def _laws(controller: Any, names: tuple[str, ...]) -> System:
    """The law at each angle; of a controller that identifies its arm, for each arm that it has found."""
    if not isinstance(controller, IdentifyingController):
        return laws_at_angles(controller)
    return stacked([laws_at_angles(believing(controller, CORNERS[name])) for name in names])


def believing(controller: Any, arm: ArmParams) -> Any:
    """A controller that identifies its arm, as it is once it has found the constants and the delay of this one."""
    mine = controller.params
    found = {name: getattr(arm, name) for name in (*IDENTIFIED, *_IDENTIFIED_DRIVE)}
    found["arm_inertia_swing"] += 4 * mine.link_length**2 * (arm.payload_mass - mine.payload_mass)
    return type(controller)(controller.gains, params=replace(mine, **found))


@dataclass(frozen=True)
class MarginCondition:
    """Least margins of a loop that may be connected to a motor."""

    modulus: float = 0.4
    delay: float = 1.0  # [samples] beyond the latency of the arm
    arms: tuple[str, ...] = tuple(CORNERS)

    def shortfall(self, controller: Any) -> float:
        """How far a controller falls short: 0 if it does not, up to 1 by margins, up to 2 the faster a loop diverges.

        Raises:
            ValueError: If there is no linear law for the controller.
        """
        least = least_margins(controller, self.arms)
        if least.growth >= 0:
            return 1 + least.growth / (1 + least.growth)
        return max(0.0, 1 - least.modulus / self.modulus, 1 - least.delay / self.delay)
