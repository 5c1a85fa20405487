"""Margins that tuned gains have to keep: on the design model and at corners of the training ranges, at every angle."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from baselines.estimation.believed_arm import IDENTIFIED
from baselines.loops.margins import Margins, margins_from_poles
from baselines.loops.models import Loop, Poles, System, laws_at_angles, poles_of, sampled_arm
from baselines.models.corners import CORNERS
from baselines.models.linear import ANGLES
from baselines.optimal.adaptive import AdaptiveController
from beltarm_env import ArmParams
from beltarm_env.arrays import Floats

_IDENTIFIED_DRIVE = ("command_latency", "current_loop_time_constant", "belt_stiffening")


class LeastMargins(NamedTuple):
    """The worst of a controller over arms and angles, and where."""

    growth: float  # largest |z| of a closed pole, less 1: negative where all loops are stable
    modulus: float  # 0 if a loop is unstable
    modulus_at: str
    delay: float  # [samples]; 0 if a loop is unstable
    delay_at: str


def margins_on(controller: Any) -> tuple[Margins, Poles]:
    """Margins, and poles z of the closed loop, of a controller on all of `CORNERS` at all angles.

    Returns:
        Margins of shape (arms, 46) each, and poles of shape (arms, 46, m).

    Raises:
        ValueError: If there is no linear law for the controller.
    """
    loops = list[Loop]()
    laws = [] if isinstance(controller, AdaptiveController) else laws_at_angles(controller)
    for name, arm in CORNERS.items():
        own = laws or laws_at_angles(believing(controller, arm))
        loops += map(Loop, own, _arm_at_angles(name))
    opened, closed = poles_of(loops)
    found, shape = margins_from_poles(opened, closed), (len(CORNERS), len(ANGLES))
    shaped: Any = [each.reshape(shape) for each in found]
    return Margins(*shaped), closed.reshape(*shape, -1)


def least_margins(controller: Any) -> LeastMargins:
    """Least margins of a controller over all of `CORNERS` and all angles; errors as of `margins_on`."""
    found, closed = margins_on(controller)
    growth = np.abs(closed).max(axis=-1) - 1
    # Where loops are unstable, the worst is the one that diverges fastest.
    modulus, delay = (np.where(found.stable, values, -growth) for values in (found.modulus, found.delay))
    return LeastMargins(
        growth=float(growth.max()),
        modulus=max(0.0, float(modulus.min())),
        modulus_at=_place(modulus),
        delay=max(0.0, float(delay.min())),
        delay_at=_place(delay),
    )


def _place(values: Floats) -> str:
    arm, k = divmod(int(values.argmin()), len(ANGLES))
    return f"{[*CORNERS][arm]}, {np.degrees(ANGLES[k]):.0f}°"


@cache
def _arm_at_angles(name: str) -> list[System]:
    return [sampled_arm(CORNERS[name], float(angle)) for angle in ANGLES]


def believing(controller: Any, arm: ArmParams) -> Any:
    """A controller that identifies its arm, as it is once it has found the constants and the delay of this one.

    An encoder tells constants of motion over torque alone: it finds them over 1 + k, k the torque constant's error.
    """
    mine, told = controller.params, 1 + arm.torque_constant_error
    found = {name: getattr(arm, name) / told for name in IDENTIFIED}
    found["arm_inertia_swing"] += 4 * mine.link_length**2 * (arm.payload_mass / told - mine.payload_mass)
    found |= {name: getattr(arm, name) for name in _IDENTIFIED_DRIVE}
    return type(controller)(controller.gains, params=replace(mine, **found))


@dataclass(frozen=True)
class MarginCondition:
    """Least margins, on all of `CORNERS`, of a loop that may be connected to a motor."""

    modulus: float = 0.4
    delay: float = 1.0  # [samples] beyond the latency of the arm

    def shortfall(self, controller: Any) -> float:
        """How far a controller falls short: 0 if it does not, up to 1 by margins, up to 2 the faster a loop diverges.

        Raises:
            ValueError: If there is no linear law for the controller.
        """
        least = least_margins(controller)
        if least.growth >= 0:
            return 1 + least.growth / (1 + least.growth)
        return max(0.0, 1 - least.modulus / self.modulus, 1 - least.delay / self.delay)
