"""Privileged preview LQG: a yardstick with true constants and true state, never ranked among the controllers.

The law of `baselines.optimal.adaptive` without an identification: the plan for the task's own cost is that of the true
arm, friction over the turn and torque ripple are the true ones, and the arm's state is read from the environment's full
observation (motor angle and speed by the encoder, torsion exactly). The motor's torque and the commands under way
follow from what was commanded, and the state when the command acts is simulated on the true arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from baselines.controller import ClassicalController
from baselines.gains import tuned
from baselines.models.actuator import dead_time
from baselines.models.friction import sliding_torques
from baselines.optimal.adaptive import AdaptiveGains
from baselines.planning.plan import planned_torque
from baselines.planning.replanning import PlanCache, Situation
from baselines.reading import Reading
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arm import params_table
from beltarm_env.arrays import Flags, Floats
from beltarm_env.simulation import ArmSimulation, X


@dataclass(frozen=True)
class PrivilegedMemory:
    """Plans and states of n arms."""

    cache: PlanCache
    arms: Floats  # states of arms and drives, as `ArmSimulation` has them


class PrivilegedController(ClassicalController[PrivilegedMemory]):
    """Preview LQG that knows its arms, on observations with `sensors="full"`.

    Args:
        arms: The true constants, one for each row of the observations, with one gear ratio and torque limit.
        gains: Those of `adaptive`: its tuned ones if not given, so that what not knowing the arm costs is seen.

    Raises:
        ValueError: If the file of gains is damaged or out of date.
    """

    sensors = "full"

    def __init__(self, arms: Sequence[ArmParams], gains: AdaptiveGains | None = None) -> None:
        super().__init__(arms[0])
        self.gains = gains or tuned("adaptive", AdaptiveGains)
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
        ahead, constant = self._simulation.ahead(arms, command, self._delays), np.zeros((len(begins), 1))
        time = reading.step + self._delays
        now = Situation(reading.move, reading.step, time, ahead, constant, self._table)
        cache = (memory.cache if memory else PlanCache.empty(constant)).begun(begins, now, self.gains.weights())
        torque = planned_torque(cache.plans, time, ahead, np.zeros(len(begins)))
        friction, ripple = sliding_torques(self._table, ahead)
        return torque + self.gains.compensated(friction, ahead[:, 1], torque) - ripple, PrivilegedMemory(cache, arms)
