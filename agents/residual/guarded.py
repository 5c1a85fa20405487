"""A learned residual with the guard between it and the motor."""

from __future__ import annotations

from typing import Any

import numpy as np

from agents.residual.controller import ResidualController, ResidualMemory
from baselines.guard.controller import GuardedController, Torques
from baselines.guard.settings import GuardSettings
from beltarm_env.arrays import Singles
from beltarm_env.rollout import Controller


class GuardedResidualController(GuardedController):
    """Base and residual with the guard behind them.

    Args:
        controller: Base and residual.
        servo: What to fall back to where the base plans, see `baselines.guard.controller.servo_for`.
        settings: Of the guard.
    """

    def __init__(
        self, controller: ResidualController, servo: Controller | None = None, settings: GuardSettings | None = None
    ) -> None:
        self._limit = controller.settings.limit
        super().__init__(controller, servo, settings, self._limit)

    def parts(self, action: Singles, memory: Any) -> Torques:
        """Base, residual and what the observer makes of the arm."""
        assert isinstance(memory, ResidualMemory) and memory.informed is not None
        belief, base = memory.informed.belief, memory.informed.action[:, 0]
        surprise = np.ones(len(action)) if belief is None else belief.tracks.surprise
        residual = self._limit * memory.residual[:, 0].astype(np.float64)
        return Torques(base.astype(np.float64), residual, surprise)
