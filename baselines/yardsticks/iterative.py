"""Textbook iterative learning: the paper's controller, and a feed-forward that takes the motor's error to zero.

    tau[k] = tau_paper[k] + f_j[k]          f_1 = 0          f_(j+1) = f_j + v_j

tau_paper is eq. (11) with the gains of Table 2, feedback included. v_j is the norm-optimal change (Gunnarsson and
Norrlof 2001; see `baselines.planning.norm_optimal`) for the nominal linear loop,

    dx[k+1] = (A - b k_fb) dx[k] + b v[k],      k_fb = [M_a1 K_p, M_a1 K_v - V_a1, 0, K_4]

about the reference, Coulomb friction left out, with what the drive measures as the error: e = l_tip (theta_a / G -
theta_ref), as far as the tip of a rigid arm of the whole length l_tip would be away, and its rate by differencing.

It makes the same move on the same arm again, which no ranked controller may do: a yardstick.
"""

from __future__ import annotations

import numpy as np

from baselines.controller import ClassicalController
from baselines.models.linear import at_angle, linear_arm
from baselines.planning.norm_optimal import Trial, Weights, followed, optimal_change
from baselines.reading import Reading
from baselines.servo.paper import PaperController
from beltarm_env import EPISODE_STEPS, ArmParams
from beltarm_env.arrays import Flags, Floats
from beltarm_env.task.cost import POSITION_SCALE, VELOCITY_SCALE

_EFFORT = 1.0  # R [1/(N m)^2]
_SMOOTHNESS = 1000.0  # r [1/(N m)^2]: the filter against learning the encoder's rounding


class IterativeController(ClassicalController[Floats]):
    """Controller of one trial of n arms, which notes what it reads for the next one.

    Args:
        feed_forward: f_j [N m], shape (n, T); None in the first trial, which is the paper's controller's.
        params: The nominal arm.
    """

    profile = None

    def __init__(self, feed_forward: Floats | None = None, params: ArmParams | None = None) -> None:
        super().__init__(params or ArmParams())
        self.feed_forward = feed_forward
        self._paper = PaperController(self.params)
        self._readings: list[Reading] = []

    def law(self, reading: Reading, begins: Flags, memory: Floats | None) -> tuple[Floats, Floats]:
        """Torque [N m] of one sample, see `ClassicalController`.

        Raises:
            ValueError: If the feed-forward is not of as many arms.
        """
        if memory is None:
            self._readings.clear()
        self._readings.append(reading)
        torque, memory = self._paper.law(reading, begins, memory)
        if self.feed_forward is None:
            return torque, memory
        if len(torque) != len(self.feed_forward):
            raise ValueError(f"the feed-forward is of {len(self.feed_forward)} arms, got observations of {len(torque)}")
        return torque + self.feed_forward[np.arange(len(torque)), np.minimum(reading.step, EPISODE_STEPS - 1)], memory

    def following(self) -> IterativeController:
        """Controller of the next trial. For arms that did not finish this one it has this one's feed-forward.

        Raises:
            ValueError: If this controller did not make one whole trial.
        """
        readings = self._readings
        if len(readings) != EPISODE_STEPS:
            raise ValueError(f"a trial must have {EPISODE_STEPS} samples, this one has {len(readings)}: run one move")
        count = len(readings[0].step)
        torque = np.zeros((count, EPISODE_STEPS)) if self.feed_forward is None else self.feed_forward.copy()
        after = [*readings[1:], readings[-1]]  # nothing is seen after the last sample
        angle = np.stack([r.motor_angle / self.params.gear_ratio - r.reference_angle for r in after], axis=1)
        speed = np.stack([r.motor_speed / self.params.gear_ratio - r.reference_speed for r in after], axis=1)
        reference = np.stack([r.reference_angle for r in readings], axis=1)
        for i in range(count):
            if all(reading.step[i] == k for k, reading in enumerate(readings)):
                torque[i] += self._change(angle[i], speed[i], reference[i], torque[i])
        return IterativeController(torque, self.params)

    def _change(self, angle: Floats, speed: Floats, reference: Floats, torque: Floats) -> Floats:
        """Change v for one arm, from its errors [rad, rad/s], reference [rad] and feed-forward so far, all (T,)."""
        p, gains = self.params, self._paper.gains
        arm = linear_arm(p)
        by_torque = at_angle(arm.by_torque, reference)
        inertia = p.motor_inertia
        feedback = [inertia * gains.angle, inertia * gains.speed - p.motor_viscous_friction, 0.0, gains.torsion_speed]
        transition = at_angle(arm.transition, reference) - by_torque[:, :, None] * np.array(feedback)
        length, none = 2 * p.link_length + p.hand_length, np.zeros_like(angle)
        of_state = np.zeros((len(angle), 4, 4))
        of_state[:, 0, 0] = of_state[:, 2, 1] = length / p.gear_ratio
        trial = Trial(transition, by_torque, np.column_stack([length * angle, none, length * speed, none]), of_state)
        scales = np.repeat(np.array([POSITION_SCALE, VELOCITY_SCALE]), 2)
        weights = Weights(np.tile(1 / scales**2, (len(angle), 1)), np.full(len(angle), _SMOOTHNESS), _EFFORT)
        change, gain, _ = optimal_change(trial, weights, torque)
        return followed(trial, change, gain)
