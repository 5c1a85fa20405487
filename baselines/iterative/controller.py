"""Iterative learning: the same move on the same arm, again and again. It is not ranked among the controllers.

    first trial      tau = tau_plan                                  as `baselines.optimal.adaptive`, bit for bit
    trial j + 1      tau[k] = tau_j[k] + c_j[k] - K_j[k] z[k]        where the motor of trial j yields to torque
                     tau[k] = tau_plan[k]                            where it sticks

with z = [x - x_j; tau[k-1] - tau_j[k-1]], and two things learnt between trials, from encoder and torque alone:

1. The arm. The logarithms of its constants, and how well they are known, begin where the trial before has ended. The
   plan of `baselines.planning.plan` is then made for that arm from the move's beginning on.
2. The torque. The whole trial is filtered once more with the constants that were known at its end, which gives its
   states x_j. About them the norm-optimal change c_j, K_j of `baselines.planning.norm_optimal` is computed, with the
   tip's estimated errors: the encoder does not see the tip, the identified arm does.

So it learns more than the plan knows: the exact kinematics, the inertia along the motion, the stops of the motor and
the norms of the cost, all of which the plan replaces by something linear or quadratic. While the motor sticks, torque
changes nothing; there the plan's law stands by, in case the motor is not where it was.

What is learnt is a `Lesson`, for arms in a given order, each with its move; nothing passes from trial to trial in any
other way. An arm that begins another move than the lesson's is new, and moved as in a first trial.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np

from baselines.estimation.identification import Belief
from baselines.gains import tuned
from baselines.iterative.lesson import Law, Lesson, Notes
from baselines.optimal.adaptive import AdaptiveController, AdaptiveGains, AdaptiveMemory
from baselines.planning.norm_optimal import Linearisation, norm_weights, optimal_change
from baselines.reading import Reading
from beltarm_env import EPISODE_STEPS, ArmParams
from beltarm_env.arrays import Flags, Floats
from beltarm_env.physics.drive import DRIVE_COLUMNS
from beltarm_env.physics.friction import SLIPS
from beltarm_env.task.reference import sampled_moves

_YIELDS = 1e-6  # speed that a torque gives the motor within a sample, below which it counts as stuck [rad/s / (N m)]


@dataclass(frozen=True, slots=True)
class Learning:
    """Settings of the torque's learning; chosen on arms with seeds 5 000 000 to 5 000 015, as the gains were."""

    effort: float = 1.0  # R [1/(N m)^2]
    softness: float = 0.01  # errors below this share of their scale in the cost weigh no more
    change_softness: float = 0.05  # torque changes below this share of the limit weigh no more

    def __post_init__(self) -> None:
        """Refuse what leaves the problem without a unique solution.

        Raises:
            ValueError: If a value is not positive and finite, naming it.
        """
        for name in self.__slots__:
            if not 0 < (value := getattr(self, name)) <= sys.float_info.max:
                raise ValueError(f"Learning.{name} must be positive and finite, got {value!r}")


class IterativeController(AdaptiveController):
    """Controller of one trial.

    Args:
        lesson: Result of the trials before; None in the first one.
        gains: Of the plan and of the identification; those of `adaptive` if not given.
        params: The nominal arm.
        learning: How the torque is learnt.
        learn_torque: Whether the torque is learnt, beside the arm.
    """

    def __init__(
        self,
        lesson: Lesson | None = None,
        gains: AdaptiveGains | None = None,
        params: ArmParams | None = None,
        learning: Learning | None = None,
        learn_torque: bool = True,
    ) -> None:
        super().__init__(gains or tuned("adaptive", AdaptiveGains), params)
        self.lesson = lesson
        self.learning = learning or Learning()
        self.learn_torque = learn_torque

    def law(self, reading: Reading, begins: Flags, memory: AdaptiveMemory | None) -> tuple[Floats, AdaptiveMemory]:
        """Torque [N m] of one sample, see `ClassicalController`.

        Raises:
            ValueError: If there are not as many arms as in the lesson.
        """
        torque, memory = super().law(reading, begins, memory)
        return self.lesson.torque(torque, memory.belief, reading) if self.lesson else torque, memory

    def _identified(self, reading: Reading, begins: Flags, belief: Belief | None) -> Belief:
        """Belief at this sample, which begins with the lesson's constants."""
        new = super()._identified(reading, begins, belief)
        if self.lesson is None:
            return new
        if len(begins) != len(self.lesson.moves):
            raise ValueError(f"the lesson is about {len(self.lesson.moves)} arms, got observations of {len(begins)}")
        return self.lesson.recalled(new, begins & self.lesson.knows(reading))

    def learned(self, notes: Notes) -> Lesson:
        """Lesson after a trial of this controller, with what was known before.

        Arms that did not finish the trial keep what they knew.

        Raises:
            ValueError: If the notes are not of one whole trial.
        """
        readings = notes.readings(self.params)
        begins = np.zeros((EPISODE_STEPS, len(readings[0].step)), np.bool_)
        begins[0] = True
        belief = None
        for reading, start in zip(readings, begins, strict=True):
            belief = self._identified(reading, start, belief)
        assert belief is not None
        moves = readings[0].move.copy()
        new = Lesson(moves, belief.constants, belief.covariance[:, 4:, 4:].copy(), None)
        if self.learn_torque:
            table = self._identifier.table(belief)
            law = self._law(table, self._states(new, readings), notes.torques(self.params), moves)
            new = Lesson(moves, new.constants, new.covariance, law)
        left = np.any([reading.step != k for k, reading in enumerate(readings)], axis=0)
        return (self.lesson or self._nothing(readings[0])).kept(left, new) if left.any() else new

    def _nothing(self, first: Reading) -> Lesson:
        """Lesson of arms of which nothing is known, from the first reading of a trial."""
        prior = self._identifier.update(None, first, np.ones(len(first.step), np.bool_))
        return Lesson(first.move.copy(), prior.constants, prior.covariance[:, 4:, 4:].copy(), None)

    def _states(self, lesson: Lesson, readings: list[Reading]) -> Floats:
        """States of the trial, shape (n, T, 4), estimated anew with the constants of the lesson.

        A motor that sticks rests in them: what it gives on its spring, no torque is learnt from.
        """
        everyone = np.ones(len(lesson.moves), np.bool_)
        belief = lesson.recalled(self._identifier.update(None, readings[0], everyone), everyone)
        states, slides = [belief.state], [~everyone]
        for reading in readings[1:]:
            belief = self._identifier.update(belief, reading, ~everyone)
            states.append(belief.state)
            slides.append(np.abs(belief.deflection) >= SLIPS)
        result = np.stack(states, axis=1)
        result[:, :, 1] *= np.stack(slides, axis=1)
        return result

    def _law(self, table: Floats, states: Floats, torques: Floats, moves: Floats) -> Law:
        """Law of the next trial, from constants (n, len(FIELDS)), and states (n, T, 4), torques (n, T) of the last."""
        before = np.column_stack([np.zeros(len(torques)), torques[:, :-1]])
        path = np.concatenate([states, before[:, :, None]], axis=2)
        law = Law(torques.copy(), np.empty(path.shape), path, np.empty(torques.shape, np.bool_))
        tasks = sampled_moves(moves)
        linearisation = Linearisation(self.params, EPISODE_STEPS)
        ideal = table.copy()  # the filter's model, whose torques act at once
        ideal[:, DRIVE_COLUMNS] = 0.0
        soft = self.learning.softness, self.learning.change_softness
        for i, change in enumerate(torques - before):
            trial = linearisation.about(states[i], torques[i], tasks[i, 1:, :2], ideal[i])
            weights = norm_weights(trial.errors, change, self.params.torque_limit, self.learning.effort, soft)
            added, law.gain[i] = optimal_change(trial, weights, torques[i])
            law.torque[i] += added
            law.holds[i] = np.abs(trial.by_torque[:, 1]) > _YIELDS
        return law
