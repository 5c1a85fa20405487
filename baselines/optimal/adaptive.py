"""Adaptive preview LQG: arm and drive are identified while the arm moves, and the move replanned for them.

    tau_m = tau_ff[k + D] - K[k + D] (x^ - x_ref[k + D]) - d + c tau_f dir

as in `baselines.optimal.preview`, with everything from `baselines.estimation.identification`. A command acts D samples
after it is given, so plan and state are those of that time: x^ is predicted over the delay under the commands given
before, and the loop that remains is the plan's own (O. J. M. Smith, Chem. Eng. Progress 53, 1957, for a plant that is
simulated from an estimated state). d is ripple and whatever torque else the filter finds, tau_f the friction that it
believes in, breakaway and its variation over the turn included. Its direction is that of the predicted speed. Below a
small speed it is that of the torque asked for, over a ramp through zero: a torque too small to be meant does not make
a motor at rest break away.

Every 30 ms the rest of the move is replanned for arms whose estimated constants have changed by more than 2 %
(certainty equivalence: K. J. Astrom, B. Wittenmark: Adaptive Control, 1995). At an episode's start the arm is that of
the design model: nothing is carried over from one episode to the next. The plan takes a belt that stiffens for one of
its mean stiffness K_s, which it has at the torsion of a moderate move.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baselines.controller import ClassicalController
from baselines.estimation.arm_ekf import Uncertainty
from baselines.estimation.believed_arm import nominal_row
from baselines.estimation.identification import ArmIdentifier, Belief, IdentifyingController
from baselines.gains import Gains, tunable, tuned
from baselines.optimal.plan import Plans, Weights, plan_moves, planned_torque, replanned
from baselines.reading import Reading
from beltarm_env import ArmParams, design_model
from beltarm_env.arm import COLUMN
from beltarm_env.arrays import Flags, Floats

_EVERY = 20  # samples between plans
_CHANGE = 0.02  # of a constant, relative, from which a plan is stale


@dataclass(frozen=True)
class AdaptiveGains(Gains):
    """Weights of the plan, prior uncertainty and noise of the identification."""

    velocity_weight: float = tunable(0.5, 0.01, 10.0, log=True)  # w_v     of the tip's velocity error
    torque_weight: float = tunable(10.0, 1.0, 1e3, log=True)  # rho     [1/(N m)^2]
    swing_doubt: float = tunable(0.3, 0.05, 1.0, log=True)  # [-]      of ln S before anything is known
    stiffness_doubt: float = tunable(0.3, 0.05, 0.6, log=True)  # [-]      of ln K_s
    friction_doubt: float = tunable(0.2, 0.05, 0.5, log=True)  # [-]      of ln V_a1, ln tau_c
    torque_noise: float = tunable(3e-3, 3e-4, 0.03, log=True)  # [N m]      process noise at the motor
    acceleration_noise: float = tunable(1.0, 0.1, 10.0, log=True)  # [rad/s^2]  process noise of the torsion
    unexplained_torque: float = tunable(5e-4, 5e-5, 1e-2, log=True)  # [N m]      unexplained torque that decays
    friction_share: float = tunable(1.0, 0.5, 1.3)  # c  [-]     of the friction that is compensated
    friction_speed: float = tunable(0.5, 0.05, 20.0, log=True)  # [rad/s]    motor speed below which the plan decides
    rest_width: float = tunable(0.01, 1e-3, 0.1, log=True)  # [N m]      torque of the plan that is meant in full

    def uncertainty(self) -> Uncertainty:
        """Prior uncertainty and noise of the identification's filter."""
        return Uncertainty(
            swing=self.swing_doubt,
            stiffness=self.stiffness_doubt,
            friction=self.friction_doubt,
            torque=self.torque_noise,
            acceleration=self.acceleration_noise,
            disturbance=self.unexplained_torque,
        )


@dataclass(frozen=True)
class PlanCache:
    """Plans of n arms, with the estimated constants that they were computed for."""

    plans: Plans
    logs: Floats  # `Belief.logs` at the time, shape (n, 6); NaN where there is no plan

    @classmethod
    def empty(cls, belief: Belief) -> PlanCache:
        """Cache without any plan."""
        return cls([np.empty(0)] * len(belief.logs), np.full_like(belief.logs, np.nan))

    def is_stale(self, belief: Belief, reading: Reading) -> Flags:
        """Which arms need a new plan, shape (n,): those without one, and every 30 ms those whose belief has changed."""
        changed = np.abs(belief.logs - self.logs).max(axis=1) > _CHANGE
        return np.isnan(self.logs[:, 0]) | (changed & (reading.step % _EVERY == 0))

    def drop(self, which: Flags) -> PlanCache:
        """Cache without the plans of some arms."""
        return PlanCache(self.plans, np.where(which[:, None], np.nan, self.logs)) if which.any() else self

    def replan(
        self, which: Flags, reading: Reading, belief: Belief, identifier: ArmIdentifier, weights: Weights
    ) -> PlanCache:
        """Cache with new plans for some arms, for their estimated constants."""
        if not which.any():
            return self
        table = _planned_for(identifier.table(belief))
        plans = replanned(self.plans, which, reading.move, table, weights)
        return PlanCache(plans, np.where(which[:, None], belief.logs, self.logs))


@dataclass(frozen=True)
class AdaptiveMemory:
    """Belief about n arms, and their plans."""

    belief: Belief
    cache: PlanCache


class AdaptiveController(ClassicalController[AdaptiveMemory], IdentifyingController[AdaptiveMemory]):
    """Adaptive preview LQG on encoder observations.

    Args:
        gains: Weights, prior uncertainty and noise.
        params: The nominal arm; the design model if not given.
        uncertainty: What the identification doubts; by default what the gains say.
    """

    def __init__(
        self,
        gains: AdaptiveGains | None = None,
        params: ArmParams | None = None,
        uncertainty: Uncertainty | None = None,
    ) -> None:
        super().__init__(params or design_model())
        self.gains = gains or AdaptiveGains()
        self._weights = Weights(self.gains.velocity_weight, self.gains.torque_weight, 0.0)
        felt = self.sensors == "accelerometer"
        self._identifier = ArmIdentifier(self.params, uncertainty or self.gains.uncertainty(), felt)

    def belief(self, memory: AdaptiveMemory) -> Belief:
        """Belief at the sample that the memory belongs to."""
        return memory.belief

    def resting_gain(self, joint: float) -> Floats:
        """Gain K of the plan for the nominal arm at rest at an angle [rad], long before the end, shape (4,)."""
        move = np.array([[joint, joint, 0.5, 0.2]])
        table = _planned_for(nominal_row(self.params)[None])
        return plan_moves(move, table, self._weights).gain[0, 0, :4]

    def law(self, reading: Reading, begins: Flags, memory: AdaptiveMemory | None) -> tuple[Floats, AdaptiveMemory]:
        """Torque [N m] of one sample, see `ClassicalController`."""
        belief = self._identified(reading, begins, memory.belief if memory else None)
        cache = memory.cache.drop(begins) if memory else PlanCache.empty(belief)
        cache = cache.replan(cache.is_stale(belief, reading), reading, belief, self._identifier, self._weights)
        state = self._identifier.ahead(belief)
        last = np.zeros(len(begins))  # on which nothing depends: the plan does not weigh the change of the torque
        torque = planned_torque(cache.plans, reading.step + belief.delay, state, last)
        friction, others = self._identifier.motor_torques(belief, state)
        asked = np.clip(torque / self.gains.rest_width, -1.0, 1.0)
        direction = np.where(np.abs(state[:, 1]) > self.gains.friction_speed, np.sign(state[:, 1]), asked)
        return torque + self.gains.friction_share * friction * direction - others, AdaptiveMemory(belief, cache)

    def _identified(self, reading: Reading, begins: Flags, belief: Belief | None) -> Belief:
        """Belief at this sample, from that of the last one."""
        return self._identifier.update(belief, reading, begins)


def _planned_for(table: Floats) -> Floats:
    """Constants that plans are made for: those of `table`, with the belt's mean stiffness."""
    table[:, COLUMN.belt_stiffening] = 0.0
    return table


def tuned_identifier(params: ArmParams | None = None) -> ArmIdentifier:
    """Identification with the tuned gains of this controller.

    Args:
        params: The nominal arm; the design model if not given.

    Raises:
        ValueError: If the file of gains is damaged or out of date.
    """
    return ArmIdentifier(params or design_model(), tuned("adaptive", AdaptiveGains).uncertainty())
