"""Privileged preview LQG: a yardstick with true constants and true state, never ranked among the controllers.

The law of `baselines.optimal.adaptive` without an identification: the plan for the task's own cost is that of the true
arm; friction over the turn and as it has drifted, torque ripple and the torque constant are the true ones. The state is
simulated on the true arm from what was commanded; the environment's full observation corrects it (motor angle and speed
by the encoder where its rounding does not explain the difference, torsion exactly).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from baselines.controller import ClassicalController
from baselines.estimation.observer import QUANTUM
from baselines.gains import tuned
from baselines.models.friction import sliding_torque
from baselines.models.linear import dead_time
from baselines.optimal.adaptive import AdaptiveGains
from baselines.optimal.adaptive_law import Compensation, compensated
from baselines.planning.plan import rows_at, step_of_plan, torque_between
from baselines.planning.replanning import PlanCache, Situation
from baselines.reading import Reading
from beltarm_env import CONTROL_PERIOD, EPISODE_STEPS, ArmParams
from beltarm_env.arm import COLUMN, params_table
from beltarm_env.arrays import Flags, Floats, Integers
from beltarm_env.engine import compiled
from beltarm_env.physics.friction import SLIPS
from beltarm_env.simulation import ArmSimulation, X

_FRICTION = [COLUMN.motor_viscous_friction, COLUMN.coulomb_friction]  # columns that drift


@dataclass(frozen=True)
class PrivilegedMemory:
    """Plans and states of n arms."""

    cache: PlanCache
    arms: Floats  # states of arms and drives, as `ArmSimulation` has them
    number: Integers  # of each arm's move in the one episode that it is made for, shape (n,)


class TrueArms(NamedTuple):
    """What is known of n arms at a time."""

    table: Floats  # constants, columns as `ArmParams`
    states: Floats  # x, shape (n, 4)
    direction: Floats  # in which each motor slides; 0 where it sticks, shape (n,)


@compiled
def _write_torques(of: Compensation, arms: TrueArms, pairs: Floats, time: Floats, torques: Floats) -> None:
    """Write the torques of n arms.

    Args:
        of: What of friction is compensated.
        arms: The arms when the torques act.
        pairs: Rows of their plans before and after that time, shape (n, 2, 10).
        time: It, since the move's start [samples], shape (n,).
        torques: [N m], shape (n,), written.
    """
    table, states, direction = arms
    for arm in range(len(time)):
        _, share = step_of_plan(time[arm])
        planned = torque_between(pairs[arm, 0], pairs[arm, 1], share, states[arm], 0.0)
        friction, ripple = sliding_torque(table[arm], states[arm])
        torques[arm] = planned + (compensated(of, friction, direction[arm], planned) - ripple)


class PrivilegedController(ClassicalController[PrivilegedMemory]):
    """Preview LQG that knows its arms, on observations with `sensors="full"`.

    Args:
        *arms: The true constants in each move of an episode, one for each row of the observations, with one gear ratio
            and torque limit. The last ones hold in all further moves.
        gains: Those of `adaptive`: its tuned ones if not given, so that what not knowing the arm costs is seen.
        model: Whose equations of motion the arms obey, "lumped" or "lagrangian".

    Raises:
        ValueError: If the file of gains is damaged or out of date.
    """

    sensors = "full"

    def __init__(self, *arms: Sequence[ArmParams], gains: AdaptiveGains | None = None, model: str = "lumped") -> None:
        super().__init__(arms[0][0])
        self._gains = tuned("adaptive", AdaptiveGains) if gains is None else gains
        self._tables = np.array([params_table(in_move) for in_move in arms])
        self._delays = np.array([dead_time(arm) for arm in arms[0]]) / CONTROL_PERIOD
        self._table, self._simulation = self._tables[0], ArmSimulation(arms[0], model=model)

    def law(self, reading: Reading, begins: Flags, memory: PrivilegedMemory | None) -> tuple[Floats, PrivilegedMemory]:
        """Torque [N m] of one sample, see `ClassicalController`.

        Raises:
            ValueError: If there are not as many rows as arms.
        """
        if len(begins) != len(self._table):
            raise ValueError(f"this yardstick knows {len(self._table)} arms, got observations of {len(begins)}")
        number = np.zeros(len(begins), np.intp) if memory is None else memory.number + begins
        number = np.minimum(number, len(self._tables) - 1)
        rests = begins & (number == 0)
        command = np.where(rests, 0.0, reading.last_command)
        arms = self._simulation.at_rest(reading.motor_angle)
        if memory is not None:
            arms = np.where(rests[:, None], arms, self._simulation.advance(memory.arms, command))
        table = self._tables[number, np.arange(len(number))]  # of the arms as they are in these moves, a copy
        drifted = 1 + table[:, COLUMN.friction_drift] * (reading.step + 0.5) / EPISODE_STEPS
        table[:, _FRICTION] *= drifted[:, None]
        if not np.array_equal(table, self._table):
            self._table = table
            self._simulation.set_table(table)
        self._correct(arms, reading)
        ahead, constant = self._simulation.ahead(arms, command, self._delays), np.zeros((len(begins), 1))
        time = reading.step + self._delays
        of_arm = ahead, constant, self._table, self._simulation.model
        now, weights = Situation(reading.move, reading.step, time, *of_arm), self.gains.weights()
        cache = (
            (memory.cache if memory else PlanCache.empty(constant)).begun(begins, now, weights).renewed(now, weights)
        )
        gives = self._table[:, COLUMN.presliding_deflection] > 0
        sticks = gives & (np.abs(arms[:, -1]) < SLIPS)
        direction, torques = np.where(sticks, 0.0, np.sign(arms[:, 1])), np.empty(len(begins))
        of = Compensation(self.gains.friction_share, self.gains.rest_width)
        _write_torques(of, TrueArms(self._table, ahead, direction), rows_at(cache.plans, time), time, torques)
        return torques / (1 + self._table[:, COLUMN.torque_constant_error]), PrivilegedMemory(cache, arms, number)

    @staticmethod
    def _correct(arms: Floats, reading: Reading) -> None:
        """Bring simulated states, shape (n, size), to what is measured beyond the rounding of the encoder.

        Within a count the simulation of the true arm is the better one: a motor gives by as little before it slips.
        """
        assert reading.torsion is not None, "decoded with the torsion, see `sensors`"
        off = np.abs(reading.motor_angle - arms[:, 0]) > QUANTUM
        arms[:, 2:X] = reading.torsion
        arms[off, 0], arms[off, 1] = reading.motor_angle[off], reading.motor_speed[off]
