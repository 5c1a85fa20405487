"""Adaptive preview LQG: arm and drive are identified while the arm moves, and the move replanned for them.

    tau_m = tau_ff[k + D] - K[k + D] (x^ - x_ref[k + D]) - d + c tau_f dir

as in `baselines.optimal.preview`, with everything from `baselines.estimation.identification`. A command acts D samples
after it is given, so plan and state are those of that time: x^ is predicted over the delay under the commands given
before, and the loop that remains is the plan's own (O. J. M. Smith, Chem. Eng. Progress 53, 1957, for a plant that is
simulated from an estimated state). d is ripple and whatever torque else the filter finds, tau_f the friction that it
believes in, breakaway and its variation over the turn included. Its direction is that in which the motor slides. Where
it sticks, and gives by some milliradian before it slips, it is that of the torque asked for, over a ramp through zero:
a torque too small to be meant does not make a motor at rest break away.

tau_ff and x_ref are planned for the task's own cost first, and anew as the estimated constants change
(`baselines.planning.replanning`). At an episode's start the arm is that of the design model: nothing is carried over
from one episode to the next. From move to move of an episode the belief lasts, but for the part in the gripper. The
plan takes a belt that stiffens for one of its mean stiffness K_s, which it has at the torsion of a moderate move.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baselines.controller import ClassicalController, LawKernel, own_gains
from baselines.estimation.filter_design import Uncertainty
from baselines.estimation.identification import ArmIdentifier, Belief
from baselines.gains import Gains, tunable, tuned
from baselines.optimal.adaptive_law import AdaptiveDesign, Compensation, arm_memory, law, write_motor_torques
from baselines.planning.plan import Weights, rows_at
from baselines.planning.replanning import EVERY, STEPS, PlanCache, Situation
from baselines.reading import Reading, require_memory
from beltarm_env import EPISODE_STEPS, ArmParams, design_model
from beltarm_env.arrays import Flags, Floats


@dataclass(frozen=True)
class AdaptiveGains(Gains):
    """Weights of the plan, prior uncertainty and noise of the identification."""

    velocity_weight: float = tunable(0.5, 0.01, 10.0, log=True)  # w_v     of the tip's velocity error
    torque_weight: float = tunable(10.0, 1.0, 1e3, log=True)  # rho     [1/(N m)^2]
    swing_doubt: float = tunable(0.3, 0.05, 1.0, log=True)  # [-]      of ln S before anything is known
    stiffness_doubt: float = tunable(0.3, 0.05, 0.6, log=True)  # [-]      of ln K_s
    friction_doubt: float = tunable(0.2, 0.05, 0.5, log=True)  # [-]      of ln V_a1, ln tau_c
    torque_noise: float = tunable(2e-3, 3e-4, 0.03, log=True)  # [N m]      process noise at the motor
    acceleration_noise: float = tunable(0.5, 0.1, 10.0, log=True)  # [rad/s^2]  process noise of the torsion
    unexplained_torque: float = tunable(5e-4, 5e-5, 1e-2, log=True)  # [N m]      unexplained torque that decays
    friction_share: float = tunable(1.0, 0.5, 1.3)  # c  [-]     of the friction that is compensated
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

    def weights(self) -> Weights:
        """Weights of the plan."""
        return Weights(self.velocity_weight, self.torque_weight, 0.0)


@dataclass(frozen=True)
class AdaptiveMemory:
    """Belief about n arms, and their plans."""

    belief: Belief
    cache: PlanCache


class AdaptiveController(ClassicalController[AdaptiveMemory]):
    """Adaptive preview LQG on encoder observations.

    Args:
        gains: Weights, prior uncertainty and noise.
        params: The nominal arm; the design model if not given. A Coulomb friction of 0 is not doubted. Of ripple,
            kinematic error, friction drift and the torque constant's error nothing is believed beforehand.
        uncertainty: What the identification doubts; by default what the gains say.
        improvements: Steps by which the first plan is improved for the task's own cost, and the most of those of plans
            around the reference's end; 0 leaves all to the squares.
        model: Whose equations of motion filter and plan rely on, "lumped" or "lagrangian".

    Raises:
        TypeError: If the gains are those of another controller.
        ValueError: If the model is unknown, or a constant is beyond what can be identified.
    """

    gains_type = AdaptiveGains
    remembers = needs_servo = True

    def __init__(
        self,
        gains: AdaptiveGains | None = None,
        params: ArmParams | None = None,
        uncertainty: Uncertainty | None = None,
        improvements: int = STEPS,
        model: str = "lumped",
    ) -> None:
        super().__init__(params)
        self._gains = own_gains(gains, AdaptiveGains)
        self._weights, self._improvements = self.gains.weights(), improvements
        self._compensation = Compensation(self.gains.friction_share, self.gains.rest_width)
        self.uncertainty = uncertainty or self.gains.uncertainty()
        self._identifier = ArmIdentifier(self.params, self.uncertainty, self.sensors == "accelerometer", model)

    def belief(self, memory: AdaptiveMemory) -> Belief:
        """Belief at the sample that the memory belongs to."""
        return memory.belief

    def kernel(self, plan_samples: int = 1) -> LawKernel:
        """The law for one arm, on encoder observations.

        Args:
            plan_samples: Over how many samples a plan made anew is spread: a processor may take longer than one for it.

        Raises:
            TypeError: If there is an accelerometer, which the law for one arm does not see.
            ValueError: If these samples are fewer than 1, or more than lie between two plans.
        """
        if self.sensors == "accelerometer":
            raise TypeError("the law for one arm has the encoder alone")
        if not 1 <= plan_samples < EVERY:
            raise ValueError(f"a plan may be spread over 1 to {EVERY - 1} samples, got {plan_samples!r}")
        rows = -(-EPISODE_STEPS // plan_samples)
        knows = self._identifier.design, self._weights, self._compensation, self._improvements
        return LawKernel(law, AdaptiveDesign(*knows, rows), arm_memory())

    def law(self, reading: Reading, begins: Flags, memory: AdaptiveMemory | None) -> tuple[Floats, AdaptiveMemory]:
        """Torque [N m] of one sample, see `ClassicalController`."""
        require_memory(memory, AdaptiveMemory)
        belief = self._identified(reading, begins, memory.belief if memory else None)
        found = self._identifier.estimate(belief)
        time, torques = reading.step + found.delay, np.empty(len(begins))
        of_arm = found.states, found.logs, found.table, self._identifier.design.nominal.model
        now = Situation(reading.move, reading.step, time, *of_arm)
        cache = memory.cache if memory else PlanCache.empty(now.logs)
        cache = cache.begun(begins | (reading.step == 0), now, self._weights, self._improvements)
        write_motor_torques(self._compensation, found, belief.tracks.mean, rows_at(cache.plans, time), time, torques)
        return torques, AdaptiveMemory(belief, cache.renewed(now, self._weights, self._improvements))

    def _identified(self, reading: Reading, begins: Flags, belief: Belief | None) -> Belief:
        """Belief at this sample, from that of the last one."""
        return self._identifier.update(belief, reading, begins)


class AccelerometerAdaptiveController(AdaptiveController):
    """Adaptive preview LQG on encoder and accelerometer."""

    sensors = "accelerometer"


def tuned_identifier(params: ArmParams | None = None) -> ArmIdentifier:
    """Identification with the tuned gains of this controller.

    Args:
        params: The nominal arm; the design model if not given.

    Raises:
        ValueError: If the file of gains is damaged or out of date.
    """
    return ArmIdentifier(params or design_model(), tuned("adaptive", AdaptiveGains).uncertainty())
