"""Controllers with the guard between them and the motor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from baselines.guard.guard import ASKS, CHANGED, GUARD_SIZE, LEVEL, guard_arms
from baselines.guard.settings import GuardSettings
from baselines.optimal.adaptive import AdaptiveController
from baselines.reading import beginning, one_or_many, require_memory, require_shape
from baselines.registry import CONTROLLERS
from beltarm_env import observation as layout
from beltarm_env.arm import params_table
from beltarm_env.arrays import Flags, Floats, Singles
from beltarm_env.rollout import Controller, check_data_sheet, check_profile, nominal_params, nominal_profile

_ANGLE, _LAST = layout.index("motor_angle"), layout.index("last_command")
_ANGLE_SCALE = layout.scales()[_ANGLE]


@dataclass(frozen=True, slots=True)
class GuardedMemory:
    """Memory from sample to sample."""

    own: Any  # of the guarded controller
    servo: Any
    asked: Flags  # which arms asked for the servo, shape (n,)
    guard: Floats  # shape (n, GUARD_SIZE)

    @property
    def changed(self) -> Flags:
        """Where the command is not the controller's own, shape (n,)."""
        return self.guard[:, CHANGED] != 0

    @property
    def level(self) -> Floats:
        """Level of `baselines.guard.guard`, shape (n,)."""
        return self.guard[:, LEVEL].copy()


class GuardedController:
    """A controller with the guard behind it.

    Args:
        controller: A classical one; with a residual see `agents.residual.controller.behind_guard`.
        servo: What to fall back to, see `servo_for`; None where there is nothing better than the controller itself.
        settings: Of the guard.
        residual: Largest residual of a learned controller, over the torque limit; 0 for a classical one.

    Raises:
        ValueError: If the controller does not say which arm it is made for, or the servo is made for another arm, or
            for another shape of the reference.
    """

    def __init__(
        self,
        controller: Controller,
        servo: Controller | None = None,
        settings: GuardSettings | None = None,
        residual: float = 0.0,
    ) -> None:
        params = nominal_params(controller)
        if params is None:
            raise ValueError(f"{type(controller).__name__} has no `params`: the guard needs to know the torque limit")
        self.controller, self.servo, self.params = controller, servo, params
        self.profile = nominal_profile(controller) or nominal_profile(servo)
        if servo is not None:
            check_data_sheet(nominal_params(servo), params_table([params]), type(servo).__name__)
            check_profile(servo, self.profile)
        self.settings = settings or GuardSettings()
        self._design = self.settings.design(params, residual)

    def parts(self, action: Singles, memory: Any) -> tuple[Floats, Floats, Floats]:
        """Take a command of the controller apart, from its memory after it.

        Returns:
            Torque of the base over the limit, the residual that is to be added to it, likewise, and w of the observer,
            1 where there is none; each of shape (n,).
        """
        surprise = np.ones(len(action))
        if isinstance(self.controller, AdaptiveController):
            surprise = self.controller.belief(memory).tracks.surprise
        return action[:, 0].astype(np.float64), np.zeros(len(action)), surprise

    @one_or_many
    def predict(
        self,
        observation: Singles,
        state: GuardedMemory | None = None,
        episode_start: Flags | None = None,
        deterministic: bool = True,
    ) -> tuple[Singles, GuardedMemory]:
        """Torque over its limit, shape (n, 1), for observations of shape (n, size); see `Controller`.

        With a state and without `episode_start` an arm of a new episode is taken for one whose encoder has jumped.
        """
        require_memory(state, GuardedMemory)
        begins = beginning(state, episode_start, observation)
        anew = beginning(state, episode_start, observation, remembers=True)
        if state is None:
            state = GuardedMemory(None, None, np.zeros(len(begins), np.bool_), np.zeros((len(begins), GUARD_SIZE)))
        require_shape(state.guard, len(begins), GUARD_SIZE)
        action, own = self.controller.predict(observation, state.own, episode_start, deterministic)
        servo, fallback, asked = self._servo_torque(observation, state, begins)
        limit, (base, residual, surprise) = self.params.torque_limit, self.parts(action, own)
        angle, last = observation[:, _ANGLE] * _ANGLE_SCALE, limit * observation[:, _LAST].astype(np.float64)
        inputs = (limit * base, limit * residual, limit * servo, angle, surprise, last)
        guard, torques = state.guard.copy(), np.empty(len(begins))
        guard_arms(self._design, np.column_stack(inputs), begins, anew, guard, torques)
        memory = GuardedMemory(own, fallback, asked, guard)
        guarded = (torques / limit).astype(np.float32)[:, None]
        # Its own command to the last bit where the guard has nothing to change.
        return np.where(memory.changed[:, None], guarded, action), memory

    def _servo_torque(self, observation: Singles, state: GuardedMemory, begins: Flags) -> tuple[Floats, Any, Flags]:
        """Torque of the servo over its limit, not a number where it is not asked; its memory; and who asks."""
        asked = (state.guard[:, ASKS] != 0) & ~begins
        if self.servo is None or not asked.any():
            return np.full(len(begins), np.nan), state.servo, asked
        action, memory = self.servo.predict(observation, state.servo, asked & ~state.asked)
        return np.where(asked, action[:, 0].astype(np.float64), np.nan), memory, asked


def servo_for(controller: Controller) -> Controller | None:
    """Make the servo that a controller falls back to; None for one without `needs_servo`.

    It is `flat`: stiff, without an observer, and the one that faults of arm and drive impress least.

    Raises:
        ValueError: If `flat` takes no such arm.
    """
    needed = getattr(controller, "needs_servo", False)
    try:
        return CONTROLLERS["flat"](params=nominal_params(controller)) if needed else None
    except ValueError as error:
        raise ValueError(f"the guard falls back to a servo, flat, which takes no such arm: {error}") from error
