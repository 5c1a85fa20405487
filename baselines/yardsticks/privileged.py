"""Privileged preview LQG: a yardstick with true constants and true state, never ranked among the controllers.

The law of `baselines.optimal.preview` without an observer: the plan is that of the true arm, and its state is read from
the environment's full observation (motor angle and speed by the encoder, torsion exactly).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from baselines.controller import ClassicalController
from baselines.gains import tuned
from baselines.models.friction import breakaway_direction
from baselines.optimal.adaptive import AdaptiveGains
from baselines.optimal.plan import Plans, planned_torque, replanned
from baselines.optimal.preview import PreviewGains
from baselines.reading import Reading
from beltarm_env import ArmParams
from beltarm_env.arm import COLUMN, params_table
from beltarm_env.arrays import Flags, Floats


class PrivilegedController(ClassicalController[Plans]):
    """Preview LQG that knows its arms, on observations with `sensors="full"`.

    Args:
        arms: The true constants, one for each row of the observations, with one gear ratio and torque limit.
        gains: Weights of the plan and of the friction compensation.
    """

    sensors = "full"

    def __init__(self, arms: Sequence[ArmParams], gains: PreviewGains | None = None) -> None:
        super().__init__(arms[0])
        self.gains = gains or PreviewGains()
        self._table = params_table(arms)
        self._friction = self._table[:, COLUMN.coulomb_friction]
        self._weights = self.gains.weights()

    def law(self, reading: Reading, begins: Flags, memory: Plans | None) -> tuple[Floats, Plans]:
        """Torque [N m] of one sample, see `ClassicalController`.

        Raises:
            ValueError: If there are not as many rows as arms.
        """
        if len(begins) != len(self._table):
            raise ValueError(f"this yardstick knows {len(self._table)} arms, got observations of {len(begins)}")
        plans = replanned(memory, begins, reading.move, self._table, self._weights)
        assert reading.torsion is not None, "decoded with the torsion, see `sensors`"
        x = np.column_stack([reading.motor_angle, reading.motor_speed, reading.torsion])
        torque = planned_torque(plans, reading.step, x)
        direction = breakaway_direction(reading.motor_speed, torque, self.gains.friction_speed)
        return torque + self.gains.friction_share * self._friction * direction, plans


def privileged_controller(
    arms: Sequence[ArmParams], gains: Literal["default", "adaptive"] = "default"
) -> PrivilegedController:
    """Yardstick for given arms.

    Args:
        arms: The true constants, one for each row of the observations.
        gains: Weights of plan and friction compensation: "default" are untuned; "adaptive" are the tuned ones of
            `adaptive`, beside which the yardstick then shows what not knowing the arm costs.

    Raises:
        ValueError: If the file of gains is damaged or out of date.
    """
    if gains == "default":
        return PrivilegedController(arms)
    g = tuned("adaptive", AdaptiveGains)
    shared = ("velocity_weight", "torque_weight", "friction_share", "friction_speed")
    return PrivilegedController(arms, PreviewGains(**{name: getattr(g, name) for name in shared}))
