"""Textbook iterative learning: the paper's controller, and a feed-forward that takes the motor's error to zero.

    tau[k] = tau_paper[k] + f_j[k]          f_1 = 0          f_(j+1) = f_j + v_j

tau_paper is eq. (11) with the gains of Table 2, feedback included. v_j is the norm-optimal change (Gunnarsson and
Norrlof 2001; see `baselines.planning.norm_optimal`) for the nominal linear loop,

    dx[k+1] = (A - b k_fb) dx[k] + b v[k],      k_fb = [M_a1 K_p, M_a1 K_v - V_a1, 0, K_4]

about the reference, Coulomb friction left out, with what the drive measures as the error: e = l_tip (theta_a / G -
theta_ref), as far as the tip of a rigid arm of the whole length l_tip would be away, and its rate by differencing.

Learning that sees the motor alone makes the motor follow, and leaves the belt out. A yardstick for
`baselines.iterative.controller`, not ranked.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baselines.controller import ClassicalController
from baselines.iterative.lesson import Notes
from baselines.models.linear import at_angle, linear_arm
from baselines.planning.norm_optimal import Trial, Weights, followed, optimal_change
from baselines.reading import Reading
from baselines.servo.paper import PaperController
from beltarm_env import EPISODE_STEPS, ArmParams
from beltarm_env.arrays import Flags, Floats
from beltarm_env.task.cost import POSITION_SCALE, VELOCITY_SCALE

_EFFORT = 1.0  # R [1/(N m)^2]
_SMOOTHNESS = 1000.0  # r [1/(N m)^2]: the filter against learning the encoder's rounding


@dataclass(frozen=True)
class FeedForward:
    """Feed-forward learnt for n arms, each with its move."""

    moves: Floats  # start, goal [rad], duration, ramp time [s]; shape (n, 4)
    torque: Floats  # f_j [N m], shape (n, T)

    def at(self, reading: Reading) -> Floats:
        """Torque of this sample [N m], shape (n,); zero for an arm at another move.

        Raises:
            ValueError: If there are not as many arm.
        """
        if len(reading.step) != len(self.moves):
            raise ValueError(
                f"what was learnt is about {len(self.moves)} arms, got observations of {len(reading.step)}"
            )
        same = (reading.move == self.moves).all(axis=1)
        at_step = self.torque[np.arange(len(self.moves)), np.minimum(reading.step, EPISODE_STEPS - 1)]
        return np.where(same, at_step, 0.0)


class MotorLearningController(ClassicalController[Floats]):
    """Controller of one trial.

    Args:
        lesson: Result of the trials before; None in the first one, which is the paper's controller's.
        params: The nominal arm.
    """

    def __init__(self, lesson: FeedForward | None = None, params: ArmParams | None = None) -> None:
        super().__init__(params or ArmParams())
        self.lesson = lesson
        self._paper = PaperController(self.params)

    def law(self, reading: Reading, begins: Flags, memory: Floats | None) -> tuple[Floats, Floats]:
        """Torque [N m] of one sample, see `ClassicalController`.

        Raises:
            ValueError: If there are not as many arms as in the lesson.
        """
        torque, memory = self._paper.law(reading, begins, memory)
        return torque + self.lesson.at(reading) if self.lesson else torque, memory

    def learned(self, notes: Notes) -> FeedForward:
        """Feed-forward after a trial of this controller, added to what was known.

        Raises:
            ValueError: If the notes are not of one whole trial.
        """
        readings = notes.readings(self.params)
        moves = readings[0].move.copy()
        torque = self.lesson.torque.copy() if self.lesson else np.zeros((len(moves), EPISODE_STEPS))
        after = [*readings[1:], readings[-1]]  # nothing is seen after the last sample
        angle = np.stack([r.motor_angle / self.params.gear_ratio - r.reference_angle for r in after], axis=1)
        speed = np.stack([r.motor_speed / self.params.gear_ratio - r.reference_speed for r in after], axis=1)
        reference = np.stack([r.reference_angle for r in readings], axis=1)
        for i in range(len(moves)):
            if all(reading.step[i] == k for k, reading in enumerate(readings)):
                torque[i] += self._change(angle[i], speed[i], reference[i], torque[i])
        return FeedForward(moves, torque)

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
        change, gain = optimal_change(trial, weights, torque)
        return followed(trial, change, gain)[0]
