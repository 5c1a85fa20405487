"""Preview LQG: an optimal plan for the move, and a Kalman filter that models stiction.

    tau_m = tau_ff - K [x - x_ref; tau_last] - d + tau_f           plan and gains: `baselines.planning.plan`

with the plan at the time at which the command acts, and the estimates x, of the state then, and d of
`baselines.estimation.observer`. tau_last is what the plan's law asked for one sample ago, as far as the limit left room
for it. Friction tau_f is compensated as `baselines.models.friction` says, by the estimated speed at that time. All
parameters are those of the design model. Separation of estimation and control holds for the linear arm only; friction
and parameters that differ break it, which is why the noise of the filter and the weights of the torque are tuned.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from baselines.controller import ClassicalController, LawKernel
from baselines.estimation.observer import Estimate, Noise, StickSlipObserver
from baselines.estimation.tracking import ObserverDesign, Track, track_arm
from baselines.gains import Gains, tunable
from baselines.models.friction import SmoothCompensation, dry_friction, smooth_friction
from baselines.models.linear import LinearArms, linear_arm
from baselines.planning.plan import (
    PLAN_COLUMNS,
    PlanCost,
    Plans,
    Weights,
    plan_cost,
    plan_rows,
    replaced,
    rows_at,
    step_of_plan,
    torque_between,
)
from baselines.reading import Reading, Sample
from beltarm_env import EPISODE_STEPS, ArmParams
from beltarm_env.arm import Plant
from beltarm_env.arrays import Flags, Floats
from beltarm_env.engine import compiled, inlined
from beltarm_env.task.reference import MoveShape


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
    plant: Plant
    model: LinearArms  # of this one arm
    cost: PlanCost
    friction: SmoothCompensation


class PreviewArm(NamedTuple):
    """Memory of the law for one arm, written in place."""

    track: Track  # of the observer
    plan: Floats  # shape (1200, 10)
    added: Floats  # torque beside the plan's [N m], shape (1,)


@inlined
def _torques(
    design: PreviewDesign, low: Floats, high: Floats, share: float, ahead: Floats, disturbance: float, last: float
) -> tuple[float, float]:
    """Torque by a plan between two of its rows, and what is added to it [N m]; see `torque_between`."""
    torque = torque_between(low, high, share, ahead, last)
    return torque, smooth_friction(design.friction, ahead[1], torque) - disturbance


@compiled
def preview_law(design: PreviewDesign, now: Sample, begins: bool, memory: PreviewArm) -> float:
    """Torque [N m] of one sample of one arm, see `LawKernel`."""
    track = memory.track
    track_arm(design.observer, now, begins, track)
    if begins:
        move = MoveShape(now.start, now.goal, now.duration, now.ramp_time)
        plan_rows(move, design.plant, design.model, design.cost, 0, memory.plan)
    last = 0.0 if begins else now.last_command - memory.added[0]
    step, share = step_of_plan(now.step + design.observer.delay)
    low, high = memory.plan[step], memory.plan[step + 1]
    torque, added = _torques(design, low, high, share, track.ahead, track.disturbance[0], last)
    memory.added[0] = added
    return torque + added


@compiled
def _law_of_arms(
    design: PreviewDesign,
    pairs: Floats,
    time: Floats,
    commands: Floats,
    begins: Flags,
    ahead: Floats,
    disturbances: Floats,
    before: Floats,
) -> tuple[Floats, Floats]:
    """Torques of n arms, and what of them is beside the plan [N m]; `before` is that of the last sample."""
    torques, added = np.empty(len(time)), np.empty(len(time))
    for i in range(len(time)):
        _, share = step_of_plan(time[i])
        last = 0.0 if begins[i] else commands[i] - before[i]
        torque, added[i] = _torques(design, pairs[i, 0], pairs[i, 1], share, ahead[i], disturbances[i], last)
        torques[i] = torque + added[i]
    return torques, added


@dataclass(frozen=True)
class PreviewMemory:
    """Plan and estimate of n arms."""

    plans: Plans
    estimate: Estimate
    added: Floats  # torque beside the plan's [N m], shape (n,)


class PreviewController(ClassicalController[PreviewMemory]):
    """Preview LQG on encoder observations.

    Args:
        gains: Weights and noise.
        params: The design model.
    """

    observer: ClassVar[type[StickSlipObserver]] = StickSlipObserver

    def __init__(self, gains: PreviewGains | None = None, params: ArmParams | None = None) -> None:
        super().__init__(params)
        self.gains = gains or PreviewGains()
        self._observer = self.observer(self.params, self.gains.noise())
        self._design = PreviewDesign(
            self._observer.design,
            self.params.plant(),
            linear_arm(self.params),
            plan_cost(self.gains.weights()),
            self.gains.compensation(self.params),
        )

    def kernel(self) -> LawKernel:
        """The law for one arm."""
        plan = np.zeros((EPISODE_STEPS, PLAN_COLUMNS))
        return LawKernel(preview_law, self._design, PreviewArm(self._observer.track(), plan, np.zeros(1)))

    def law(self, reading: Reading, begins: Flags, memory: PreviewMemory | None) -> tuple[Floats, PreviewMemory]:
        """Torque [N m] of one sample, see `ClassicalController`."""
        estimate = self._observer.update(memory.estimate if memory else None, reading, begins)
        plans = replaced(memory.plans if memory else None, begins, lambda arm: self._planned(reading.move[arm]))
        time = reading.step.astype(np.float64) + self._design.observer.delay
        torques, added = _law_of_arms(
            self._design,
            rows_at(plans, time),
            time,
            reading.last_command,
            begins,
            estimate.ahead,
            estimate.disturbance,
            memory.added if memory else np.zeros(len(begins)),
        )
        return torques, PreviewMemory(plans, estimate, added)

    def _planned(self, move: Floats) -> Floats:
        """Plan of one move."""
        rows, design = np.empty((EPISODE_STEPS, PLAN_COLUMNS)), self._design
        plan_rows(MoveShape(*move.tolist()), design.plant, design.model, design.cost, 0, rows)
        return rows
