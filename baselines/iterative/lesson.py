"""Lesson of an iterative controller about n arms, and the record of a trial that it is learnt from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from baselines.estimation.identification import Belief
from baselines.reading import Reading, chosen, read
from beltarm_env import EPISODE_STEPS, ArmParams
from beltarm_env.arrays import Flags, Floats, Singles
from beltarm_env.rollout import Controller


class Law(NamedTuple):
    """tau = torque - gain (z - path) of n arms over T samples, with z = [x; last torque]."""

    torque: Floats  # tau_j + c_j [N m], shape (n, T)
    gain: Floats  # K_j, shape (n, T, 5)
    path: Floats  # x_j and the torque before, shape (n, T, 5)
    holds: Flags  # where the law holds, and not the plan, shape (n, T)


@dataclass(frozen=True)
class Lesson:
    """Constants and torques learnt for n arms, each with its move."""

    moves: Floats  # start, goal [rad], duration, ramp time [s]; shape (n, 4)
    constants: Floats  # as `Belief.constants`, shape (n, SIZE - 4)
    covariance: Floats  # of these, shape (n, SIZE - 4, SIZE - 4)
    law: Law | None  # None: only the arm was learnt

    def recalled(self, belief: Belief, which: Flags) -> Belief:
        """Belief with the learnt constants of some arms; `which` has shape (n,)."""
        return belief.with_constants(which, self.constants, self.covariance)

    def torque(self, planned: Floats, belief: Belief, reading: Reading) -> Floats:
        """Torque [N m], shape (n,): that of the law where it holds, the planned one elsewhere."""
        if self.law is None:
            return planned
        arms, k = np.arange(len(planned)), np.minimum(reading.step, EPISODE_STEPS - 1)
        z = np.column_stack([belief.state, reading.last_command]) - self.law.path[arms, k]
        torque = self.law.torque[arms, k]
        for feedback in (self.law.gain[arms, k] * z).T:
            torque = torque - feedback
        return np.where(self.law.holds[arms, k] & self.knows(reading), torque, planned)

    def kept(self, which: Flags, new: Lesson) -> Lesson:
        """A new lesson about these arms, in which some arms keep what this one has; `which` has shape (n,)."""
        law = new.law
        if law:
            idle = law._replace(holds=np.zeros_like(law.holds))
            law = Law(*(chosen(which, old, now) for old, now in zip(self.law or idle, law, strict=True)))
        constants = chosen(which, self.constants, new.constants)
        return Lesson(new.moves, constants, chosen(which, self.covariance, new.covariance), law)

    def knows(self, reading: Reading) -> Flags:
        """Whether each arm makes the move of its lesson, shape (n,)."""
        return (reading.move == self.moves).all(axis=1)


class Notes:
    """Wrapper of a controller that records its observations and actions during one trial."""

    def __init__(self, controller: Controller) -> None:
        self.controller = controller
        self._observations: list[Singles] = []
        self._actions: list[Singles] = []

    def predict(
        self, observation: Singles, state: Any = None, episode_start: Flags | None = None, deterministic: bool = True
    ) -> tuple[Singles, Any]:
        """Call the controller and record."""
        action, state = self.controller.predict(observation, state, episode_start, deterministic)
        self._observations.append(observation.copy())
        self._actions.append(action.copy())
        return action, state

    def readings(self, params: ArmParams) -> list[Reading]:
        """Recorded observations, decoded, sample by sample.

        Raises:
            ValueError: If it is not one whole trial.
        """
        if len(self._observations) != EPISODE_STEPS:
            raise ValueError(
                f"a trial must have {EPISODE_STEPS} samples, got {len(self._observations)}: note one trial"
            )
        return [read(observation, params) for observation in self._observations]

    def torques(self, params: ArmParams) -> Floats:
        """Recorded torques [N m], shape (n, T)."""
        actions = np.stack([action[:, 0] for action in self._actions], axis=1)
        return np.clip(actions.astype(np.float64), -1, 1) * params.torque_limit
