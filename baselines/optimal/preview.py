"""Preview LQG: an optimal plan for the move, and a Kalman filter that models stiction.

    tau_m = tau_ff - K [x - x_ref; tau_last] - d + tau_f           plan and gains: `baselines.planning.plan`

with the plan at the time at which the command acts, and the estimates x, of the state then, and d of
`baselines.estimation.observer`. tau_last is what the plan's law asked for one sample ago, as far as the limit left room
for it. Friction tau_f is compensated as `baselines.models.friction` says, by the estimated speed at that time. All
parameters are those of the design model. Separation of estimation and control holds for the linear arm only; friction
and parameters that differ break it, which is why the noise of the filter and the weights of the torque are tuned.

`ObserverController` is the base of all controllers that feed back what this observer estimates: one law for one arm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from baselines.controller import LawKernel, TunedController, run_law
from baselines.estimation.accelerometer import AXES, SPREAD, accelerometer_design, correct_by_both, unfiltered
from baselines.estimation.observer import (
    AHEAD,
    DISTURBANCE,
    ESTIMATE_SIZE,
    Correction,
    Measured,
    Noise,
    ObserverDesign,
    correct,
    observe,
    observe_arm,
    observer_design,
)
from baselines.gains import Gains, tunable
from baselines.models.friction import SmoothCompensation, dry_friction, smooth_friction
from baselines.models.linear import LinearArm, linear_arm
from baselines.planning.plan import (
    PLAN_COLUMNS,
    Plans,
    Weights,
    plan_move,
    planned,
    replaced,
    rows_at,
    step_of_plan,
    torque_between,
)
from baselines.reading import Reading, Sample, chosen, copied_memory, move_of, one_or_many, require_memory
from beltarm_env import EPISODE_STEPS, ArmParams
from beltarm_env.arrays import Flags, Floats, Singles
from beltarm_env.engine import compiled
from beltarm_env.kernels.simulate import Room, room_for
from beltarm_env.simulation import ArmSimulation

ADDED, OWN = ESTIMATE_SIZE, ESTIMATE_SIZE + 1
"""Entries of a law's memory after the estimate: torque beside the feedback's at the last sample [N m]; and from `OWN`
on what the law keeps besides."""


class ObserverController(TunedController[Any]):
    """Base of controllers with an observer; a subclass names its `feedback_law`, and knows the design of `observer`."""

    needs_servo = True
    feedback_law: ClassVar[Callable[..., float]]
    """See `LawKernel.law`; of its memory only the estimate counts where a move begins."""
    correction: ClassVar[Correction] = staticmethod(correct)
    memory_size: ClassVar[int] = OWN
    _simulation: ArmSimulation | None = None  # of as many arms as there were so far

    def law(self, reading: Reading, begins: Flags, memory: Any) -> tuple[Floats, Any]:
        """Torque [N m] of one sample, see `ClassicalController`."""
        rows = self._observed(reading, begins, memory)
        return self._torques(reading, begins, rows), rows

    def _observed(self, reading: Reading, begins: Flags, memory: Floats | None) -> Floats:
        """Copy of the laws' memory, shape (n, memory_size), with the estimates of this sample."""
        count = len(begins)
        rows = copied_memory(memory, count, self.memory_size)
        simulation, self._simulation = self._simulation, None  # while it is in use: another thread makes its own
        if simulation is None or len(simulation.limits) < count:
            simulation = ArmSimulation(self.params, count)
        measured = self._measured(reading, begins, rows)
        observe(type(self).correction, self._design.observer, measured, begins, rows, simulation.room)
        self._simulation = simulation
        return rows

    def _measured(self, reading: Reading, begins: Flags, rows: Floats) -> Measured:
        """What the observer reads; what it has to remember of that is written to the laws' memory."""
        return Measured(reading.motor_angle, reading.last_command)

    def _torques(self, reading: Reading, begins: Flags, rows: Floats) -> Floats:
        torques = np.empty(len(begins))
        run_law(type(self).feedback_law, self._design, reading, begins, rows, torques)
        return torques


_END = OWN + 2 * PLAN_COLUMNS
_LOW, _HIGH = slice(OWN, OWN + PLAN_COLUMNS), slice(OWN + PLAN_COLUMNS, _END)  # of the memory: rows of the plan


@dataclass(frozen=True)
class PreviewGains(Gains):
    """Weights of the plan, noise of the filter and friction compensation."""

    velocity_weight: float = tunable(1.0, 0.01, 10.0, log=True)  # w_v     of the tip's velocity error
    torque_weight: float = tunable(10.0, 1e-2, 1e4, log=True)  # rho     [1/(N m)^2]
    change_weight: float = tunable(20.0, 1e-2, 1e5, log=True)  # R     [1/(N m)^2]
    torque_noise: float = tunable(5e-3, 1e-4, 0.1, log=True)  # [N m]      process noise at the motor
    acceleration_noise: float = tunable(0.3, 0.01, 300.0, log=True)  # [rad/s^2]  process noise of the torsion
    disturbance_noise: float = tunable(1e-3, 1e-4, 10.0, log=True)  # [N m/sqrt(s)]  growth of d
    friction_share: float = tunable(1.0, 0.0, 1.3)  # c         of the design model's friction that is compensated
    friction_speed: float = tunable(1.0, 0.05, 20.0, log=True)  # omega_0 [rad/s]  motor speed that decides its sign
    rest_width: float = tunable(0.02, 0.0001, 0.3, log=True)  # [N m]     torque that decides it while the motor rests

    def weights(self) -> Weights:
        """Weights of the tip's velocity error, of the torque and of its change."""
        return Weights(self.velocity_weight, self.torque_weight, self.change_weight)

    def noise(self) -> Noise:
        """Process noise of the filter."""
        return Noise(self.torque_noise, self.acceleration_noise, self.disturbance_noise)

    def compensation(self, params: ArmParams) -> SmoothCompensation:
        """Compensation of the design model's friction."""
        friction = dry_friction(params.row())
        return SmoothCompensation(friction, self.friction_share, self.friction_speed, self.rest_width)


class PreviewDesign(NamedTuple):
    """What the law for one arm knows."""

    observer: ObserverDesign
    model: LinearArm
    weights: Weights
    friction: SmoothCompensation


@compiled
def _torque(design: PreviewDesign, now: Sample, begins: bool, row: Floats) -> float:
    """Motor torque [N m], see `ObserverController`; the row has those of the plan around the time of `ahead`."""
    ahead, last = row[AHEAD], 0.0 if begins else now.last_command - row[ADDED]
    _, share = step_of_plan(now.step + design.observer.delay)
    torque = torque_between(row[_LOW], row[_HIGH], share, ahead, last)
    row[ADDED] = smooth_friction(design.friction, ahead[1], torque) - row[DISTURBANCE]
    return torque + row[ADDED]


class PlannedArm(NamedTuple):
    """Memory of observer, law and plan of one arm, written in place."""

    rows: Floats  # see `ObservedArm`
    room: Room
    plan: Floats  # shape (1200, 10)


@compiled
def preview_law(design: PreviewDesign, now: Sample, begins: bool, memory: PlannedArm) -> float:
    """Torque [N m] of one sample of one arm, see `LawKernel`."""
    plan, row = memory.plan, memory.rows[0]
    observe_arm(design.observer, now, begins, memory.rows, memory.room)
    if begins:
        plan_move(move_of(now), design.observer.row, design.model, design.weights, plan)
    step, _ = step_of_plan(now.step + design.observer.delay)
    row[_LOW], row[_HIGH] = plan[step], plan[step + 1]
    return _torque(design, now, begins, row)


class PreviewMemory(NamedTuple):
    """Memory of n arms."""

    rows: Floats  # of their laws, shape (n, size)
    plans: Plans


class PreviewController(ObserverController):
    """Preview LQG on encoder observations."""

    gains_type = PreviewGains
    feedback_law = staticmethod(_torque)
    memory_size = _END

    def _known(self) -> PreviewDesign:
        p, g = self.params, self.gains
        return PreviewDesign(observer_design(p, g.noise()), linear_arm(p), g.weights(), g.compensation(p))

    def kernel(self) -> LawKernel:
        """The law for one arm, with its observer.

        Raises:
            TypeError: If there is an accelerometer, which a `Sample` does not have.
        """
        if self.sensors != "encoder":
            raise TypeError("the law for one arm reads the encoder alone: take the kernel of PreviewController")
        rows, plan = np.zeros((1, self.memory_size)), np.zeros((EPISODE_STEPS, PLAN_COLUMNS))
        return LawKernel(preview_law, self._design, PlannedArm(rows, room_for(1), plan))

    def law(self, reading: Reading, begins: Flags, memory: PreviewMemory | None) -> tuple[Floats, PreviewMemory]:
        """Torque [N m] of one sample, see `ClassicalController`."""
        require_memory(memory, PreviewMemory)
        design = self._design

        def plan(arm: int) -> Floats:
            return planned(reading.move[arm], design.observer.row, design.weights, design.model)

        rows = self._observed(reading, begins, memory.rows if memory else None)
        plans = replaced(memory.plans if memory else None, begins, plan)
        rows[:, OWN:_END] = rows_at(plans, reading.step + design.observer.delay).reshape(len(begins), -1)
        return self._torques(reading, begins, rows), PreviewMemory(rows, plans)


class AccelerometerPreviewController(PreviewController):
    """Preview LQG on encoder and accelerometer."""

    sensors = "accelerometer"
    correction = staticmethod(correct_by_both)
    memory_size = _END + 2 * AXES + 1  # its last entry is 1 where the zero-g output is known

    @one_or_many
    def predict(
        self,
        observation: Singles,
        state: PreviewMemory | None = None,
        episode_start: Flags | None = None,
        deterministic: bool = True,
    ) -> tuple[Singles, PreviewMemory]:
        """Torque over its limit, see `ClassicalController`; the zero-g output lasts from move to move."""
        if state is not None and episode_start is not None and np.any(episode_start):
            state = state._replace(rows=chosen(np.asarray(episode_start), np.zeros_like(state.rows), state.rows))
        return super().predict(observation, state, episode_start, deterministic)

    def _known(self) -> PreviewDesign:
        return super()._known()._replace(observer=accelerometer_design(self.params, self.gains.noise()))

    def _measured(self, reading: Reading, begins: Flags, rows: Floats) -> Measured:
        assert reading.acceleration is not None
        before, bias, known = rows[:, _END : _END + AXES], rows[:, _END + AXES : -1], rows[:, -1]
        first = known == 0.0
        before[first] = bias[first] = reading.acceleration[first]
        known[:] = 1.0
        acceleration, variance = unfiltered(reading.acceleration, before)
        acceleration[variance > SPREAD**2] = np.nan
        before[:] = reading.acceleration
        return Measured(reading.motor_angle, reading.last_command, acceleration - bias)
