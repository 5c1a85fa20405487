"""Privileged preview LQG: a yardstick with true constants and true state, never ranked among the controllers.

The law of `baselines.optimal.preview` without an observer: the plan is that of the true arm, and its state is read from
the environment's full observation (motor angle and speed by the encoder, torsion exactly). The motor's torque and the
commands under way follow from what was commanded, and the state when the command acts is simulated on the true arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from baselines.controller import ClassicalController
from baselines.gains import tuned
from baselines.models.actuator import dead_time
from baselines.optimal.adaptive import AdaptiveGains
from baselines.optimal.plan import Plans, planned_torque, replanned
from baselines.optimal.preview import PreviewGains
from baselines.reading import Reading, last_share
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arm import params_table
from beltarm_env.arrays import Flags, Floats
from beltarm_env.simulation import ArmSimulation, X


@dataclass(frozen=True)
class PrivilegedMemory:
    """Plans and states of n arms."""

    plans: Plans
    arms: Floats  # states of arms and drives, as `ArmSimulation` has them
    added: Floats  # torque beside the plan's [N m], shape (n,)


class PrivilegedController(ClassicalController[PrivilegedMemory]):
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
        self._delays = np.array([dead_time(arm) for arm in arms]) / CONTROL_PERIOD
        self._simulation = ArmSimulation(arms)

    def law(self, reading: Reading, begins: Flags, memory: PrivilegedMemory | None) -> tuple[Floats, PrivilegedMemory]:
        """Torque [N m] of one sample, see `ClassicalController`.

        Raises:
            ValueError: If there are not as many rows as arms.
        """
        if len(begins) != len(self._table):
            raise ValueError(f"this yardstick knows {len(self._table)} arms, got observations of {len(begins)}")
        assert reading.torsion is not None, "decoded with the torsion, see `sensors`"
        command = np.where(begins, 0.0, reading.last_command)
        arms = self._simulation.at_rest(reading.motor_angle)
        if memory is not None:
            arms = np.where(begins[:, None], arms, self._simulation.advance(memory.arms, command))
        arms[:, :X] = np.column_stack([reading.motor_angle, reading.motor_speed, reading.torsion])
        ahead = self._simulation.ahead(arms, command, self._delays)
        plans = replanned(memory.plans if memory else None, begins, reading.move, self._table, self.gains.weights())
        last = last_share(reading, memory.added if memory else None, begins)
        torque = planned_torque(plans, reading.step + self._delays, ahead, last)
        added = self.gains.friction(self._table, ahead[:, 1], torque)
        return torque + added, PrivilegedMemory(plans, arms, added)


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
    shared = {name: getattr(g, name) for name in ("velocity_weight", "torque_weight", "friction_share")}
    return PrivilegedController(arms, PreviewGains(**shared))
