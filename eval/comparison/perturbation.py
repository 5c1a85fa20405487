"""Sensitivity of an episode: whether its cost changes when the first torque differs by a hair.

Whether a motor sticks is decided by a hair, and what follows is another motion. Where a controller and its arm amplify
such a difference, a single episode says little, and on a real arm the same move is not made twice.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltarm_env.arm import NOMINAL
from beltarm_env.arrays import Flags, Floats
from beltarm_env.rollout import Controller, nominal_params

PERTURBATION = 1e-9
"""Difference of the first torque in a perturbed episode [N m]."""
CHANGE = 0.01
"""Share of its cost by which an episode has to change to count as sensitive."""


class Perturbed:
    """Controller whose first torques differ by `PERTURBATION`.

    Args:
        controller: Whose torques they are.
    """

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self.params = nominal_params(controller)
        self._difference = PERTURBATION / (self.params or NOMINAL).torque_limit

    def predict(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any] | None = None,
        episode_start: Flags | None = None,
        deterministic: bool = True,
    ) -> tuple[Any, tuple[Any]]:
        """Torques over their limit, shape (n, 1); the first in double precision, which holds the difference."""
        own = None if state is None else state[0]
        action, following = self._controller.predict(observation, own, episode_start, deterministic)
        if state is None:
            first = np.clip(action.astype(np.float64), -1, 1)
            action = np.where(first > 0, first - self._difference, first + self._difference)  # within the limits
        return action, (following,)


def sensitive(cost: Floats, perturbed: Floats) -> Floats:
    """1.0 where the costs of an episode and of the perturbed one differ by more than `CHANGE`, else 0.0."""
    return (np.abs(perturbed - cost) > CHANGE * cost).astype(np.float64)
