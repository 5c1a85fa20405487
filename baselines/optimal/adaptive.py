"""Adaptive preview LQG: the arm is identified while it moves, and the move replanned for the identified arm.

    tau_m = tau_ff[k] - K[k] (x - x_ref[k]) + tau_c dir

as in `baselines.optimal.preview`, with state, tau_c and the arm's constants from `baselines.estimation.identification`,
which also finds the encoder's delay and resolution. Every 30 ms the rest of the move is replanned for arms whose
estimated constants have changed by more than 2 % (certainty equivalence: K. J. Astrom, B. Wittenmark: Adaptive Control,
1995). At an episode's start the arm is nominal: nothing is carried over from one episode to the next.

Where that plan demands more than four times the torque limit, an optimal plan with a hundredfold weight of the torque
takes over: saturation lowers the loop's gain, and beyond the halving that every LQ regulator tolerates the feedback may
excite the vibration instead of damping it (after G. F. Wredenhagen, P. R. Belanger: Piecewise-linear LQ control for
systems with input constraints, Automatica 30, 1994). It is computed on demand, for few arms need it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baselines.controller import ClassicalController
from baselines.estimation.arm_ekf import IDENTIFIED, Uncertainty
from baselines.estimation.identification import ArmIdentifier, Belief, IdentifyingController
from baselines.gains import Gains, tunable, tuned
from baselines.models.friction import breakaway_direction
from baselines.optimal.plan import Plans, Weights, planned_torque, replanned
from baselines.reading import Reading
from beltarm_env import ArmParams
from beltarm_env.arrays import Flags, Floats

_EVERY = 20  # samples between plans
_CHANGE = 0.02  # of a constant, relative, from which a plan is stale
_BEYOND = 4.0  # torque over its limit from which the careful plan is used
_DEARER = 100.0  # its weight of the torque over that of the other
_FRICTION = IDENTIFIED.index("coulomb_friction")


@dataclass(frozen=True)
class AdaptiveGains(Gains):
    """Weights of the plan, prior uncertainty and noise of the identification."""

    velocity_weight: float = tunable(0.3, 0.01, 10.0, log=True)  # w_v     of the tip's velocity error
    torque_weight: float = tunable(100.0, 1e-2, 1e4, log=True)  # rho     [1/(N m)^2]
    swing_doubt: float = tunable(0.35, 0.03, 1.0, log=True)  # [-]      of ln S before anything is known
    stiffness_doubt: float = tunable(0.12, 0.01, 0.5, log=True)  # [-]      of ln K_s
    friction_doubt: float = tunable(0.17, 0.01, 0.5, log=True)  # [-]      of ln V_a1, ln tau_c
    torque_noise: float = tunable(3e-3, 1e-5, 0.1, log=True)  # [N m]      process noise at the motor
    acceleration_noise: float = tunable(1.0, 0.03, 100.0, log=True)  # [rad/s^2]  process noise of the torsion
    friction_share: float = tunable(1.0, 0.5, 1.3)  # [-]        of tau_c that is compensated
    friction_speed: float = tunable(0.5, 0.05, 20.0, log=True)  # [rad/s]    motor speed below which the plan decides

    def uncertainty(self) -> Uncertainty:
        """Prior uncertainty and noise of the identification's filter."""
        return Uncertainty(
            swing=self.swing_doubt,
            stiffness=self.stiffness_doubt,
            friction=self.friction_doubt,
            torque=self.torque_noise,
            acceleration=self.acceleration_noise,
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
        plans = replanned(self.plans, which, reading.move, identifier.table(belief), weights)
        return PlanCache(plans, np.where(which[:, None], belief.logs, self.logs))


@dataclass(frozen=True)
class AdaptiveMemory:
    """Belief about n arms, and their plans."""

    belief: Belief
    bold: PlanCache
    careful: PlanCache  # with the torque weighted more, for the arms that needed it


class AdaptiveController(ClassicalController[AdaptiveMemory], IdentifyingController[AdaptiveMemory]):
    """Adaptive preview LQG on encoder observations.

    Args:
        gains: Weights, prior uncertainty and noise.
        params: The nominal arm.
    """

    def __init__(self, gains: AdaptiveGains | None = None, params: ArmParams | None = None) -> None:
        super().__init__(params)
        self.gains = gains or AdaptiveGains()
        self._bold = Weights(self.gains.velocity_weight, self.gains.torque_weight)
        self._careful = Weights(self.gains.velocity_weight, self.gains.torque_weight * _DEARER)
        self._identifier = ArmIdentifier(self.params, self.gains.uncertainty())

    def belief(self, memory: AdaptiveMemory) -> Belief:
        """Belief at the sample that the memory belongs to."""
        return memory.belief

    def law(self, reading: Reading, begins: Flags, memory: AdaptiveMemory | None) -> tuple[Floats, AdaptiveMemory]:
        """Torque [N m] of one sample, see `ClassicalController`."""
        belief = self._identified(reading, begins, memory.belief if memory else None)
        bold = memory.bold.drop(begins) if memory else PlanCache.empty(belief)
        careful = memory.careful.drop(begins) if memory else PlanCache.empty(belief)
        bold = bold.replan(bold.is_stale(belief, reading), reading, belief, self._identifier, self._bold)
        torque = planned_torque(bold.plans, reading.step, belief.state)
        beyond = np.abs(torque) > _BEYOND * self.params.torque_limit
        due = beyond & careful.is_stale(belief, reading)
        careful = careful.replan(due, reading, belief, self._identifier, self._careful)
        for arm in np.flatnonzero(beyond):
            only = slice(arm, arm + 1)
            torque[only] = planned_torque(careful.plans[only], reading.step[only], belief.state[only])
        direction = breakaway_direction(belief.state[:, 1], torque, self.gains.friction_speed)
        friction = self.params.coulomb_friction * np.exp(belief.logs[:, _FRICTION])
        return torque + self.gains.friction_share * friction * direction, AdaptiveMemory(belief, bold, careful)

    def _identified(self, reading: Reading, begins: Flags, belief: Belief | None) -> Belief:
        """Belief at this sample, from that of the last one."""
        return self._identifier.update(belief, reading, begins)


def tuned_identifier(params: ArmParams | None = None) -> ArmIdentifier:
    """Identification with the tuned gains of this controller.

    Args:
        params: The nominal arm.

    Raises:
        ValueError: If the file of gains is damaged or out of date.
    """
    return ArmIdentifier(params or ArmParams(), tuned("adaptive", AdaptiveGains).uncertainty())
