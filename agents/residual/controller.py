"""Residual torque: an agent's correction on top of a base controller.

    action = clip(base + limit * residual, -1, 1)

The base acts every sample; the residual is held for `hold` samples. What the agent observes is in
`agents.residual.knowledge`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.residual.knowledge import ENTRIES, InformedBase, InformedMemory, Knowledge, cut
from baselines.guard.controller import GuardedController, servo_for
from baselines.guard.settings import GuardSettings
from baselines.reading import beginning, chosen, one_or_many, require_memory, require_shape, warn_if_amid_a_move
from beltarm_env import EPISODE_STEPS
from beltarm_env.arrays import Flags, Floats, Singles
from beltarm_env.batch import whole
from beltarm_env.engine import compiled, inlined
from beltarm_env.rollout import Controller, require_controller


@dataclass(frozen=True, slots=True)
class ResidualSettings:
    """Settings of a residual: its limit and how long it is held.

    Raises:
        ValueError: If a value is out of range.
    """

    limit: float = 0.5  # largest residual, as a share of the torque limit
    hold: int = 4  # samples per residual: 6 ms
    knowledge: Knowledge = "belief"  # what the agent observes besides the observation

    def __post_init__(self) -> None:
        """Check the ranges."""
        number = isinstance(self.limit, int | float) and not isinstance(self.limit, bool)
        if not (number and 0 < self.limit <= 2):
            raise ValueError(f"residual limit must lie in (0, 2] of the torque limit, got {self.limit!r}")
        object.__setattr__(self, "hold", whole("residual hold [samples]", self.hold, 1, 100))
        if self.knowledge not in ENTRIES:
            raise ValueError(f"knowledge must be one of {', '.join(ENTRIES)}, got {self.knowledge!r}")

    def check_moves(self, moves: int) -> None:
        """Check that holds end where moves do: as a controller, an agent decides anew at the start of each.

        Raises:
            ValueError: If a hold would last into the next move.
        """
        if moves > 1 and EPISODE_STEPS % self.hold:
            raise ValueError(
                f"residual hold must divide {EPISODE_STEPS}, the samples of a move, where an episode has several, "
                f"got {self.hold}: choose one such as 4, 8 or 12"
            )


@inlined
def combined(base_action: float, residual: float, limit: float) -> float:
    """Add a residual to the base's action, in single precision, and cut; a zero residual gives the base's."""
    return cut(float(np.float32(base_action) + np.float32(limit) * np.float32(residual)), 1.0)


def combine(base_action: Singles, residual: Singles, limit: float) -> Singles:
    """Add residuals to the base's actions, see `combined`; arrays of one shape (n, 1)."""
    actions = np.empty_like(base_action)
    _combine_all(base_action, residual, limit, actions)
    return actions


@compiled
def _combine_all(base_actions: Singles, residuals: Singles, limit: float, actions: Singles) -> None:
    for i in range(len(actions)):
        actions[i, 0] = combined(base_actions[i, 0], residuals[i, 0], limit)


def checked_residual(residual: object, count: int) -> Singles:
    """Check residuals, and return them in shape (count, 1), cut to [-1, 1].

    Raises:
        ValueError: If they have another shape or are not finite numbers.
    """
    array = np.asarray(residual)
    if array.shape != (count, 1) or array.dtype.kind not in "fiu":
        raise ValueError(f"residuals must be numbers of shape ({count}, 1), got {array.dtype} of shape {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"residuals must be finite, got {array[~np.isfinite(array)][0]}")
    return np.clip(array, -1.0, 1.0).astype(np.float32, copy=False)


@dataclass(frozen=True, slots=True)
class ResidualMemory:
    """Memory of a `ResidualController`."""

    informed: InformedMemory | None
    policy: Any
    residual: Singles  # held, (n, 1)
    age: NDArray[np.int64]  # samples since the memory's beginning, (n,)


class ResidualController:
    """A base controller with a learned residual, as one controller on the environment's own observation.

    Args:
        base: The base controller.
        policy: From what an agent observes (`agents.residual.knowledge`) to residuals, called as a controller is.
        settings: How the residual acts.

    Raises:
        TypeError: If one of the two has no `predict`.
        ValueError: If the policy learned on observations that a `VecNormalize` had changed.

    Attributes:
        params: Arm that it is made for, see `Controller`.
        profile: Shape of the reference that its base rebuilds.
    """

    remembers = True
    """The policy's memory lasts from move to move; base and belief begin anew with each if the base's does not last."""

    def __init__(self, base: Controller, policy: Controller, settings: ResidualSettings) -> None:
        require_controller(policy)
        self.informed = InformedBase(base, settings.knowledge)
        self.policy = policy
        self.settings = settings
        self.params, self.profile = self.informed.params, self.informed.profile

    @one_or_many
    def predict(
        self,
        observation: Singles,
        state: ResidualMemory | None = None,
        episode_start: Flags | None = None,
        deterministic: bool = True,
    ) -> tuple[Singles, ResidualMemory]:
        """Torque over its limit, shape (n, 1), for observations of shape (n, size); see `Controller`.

        Raises:
            TypeError: If the policy's memory cannot be told apart by arms where only some of them are due.
            ValueError: If observations, state, `episode_start` or the policy's residuals have another shape, or an
                observation is not finite. Of a residual that is no number the action is none either.
        """
        require_memory(state, ResidualMemory)
        count = len(observation)
        if state is None:
            if episode_start is None:
                warn_if_amid_a_move(observation)
            state = ResidualMemory(None, None, np.zeros((count, 1), np.float32), np.zeros(count, np.int64))
        anew = beginning(state.informed, episode_start, observation, self.remembers)
        begins = beginning(state.informed, anew, observation, self.informed.remembers)
        informed = self.informed.advance(observation, state.informed, begins)
        require_shape(state.residual, count, 1)
        age = np.where(begins, 0, state.age)
        residual, policy = state.residual, state.policy
        due = age % self.settings.hold == 0
        if due.any():
            seen = self.informed.seen(observation, informed)
            fresh, following = self.policy.predict(seen, policy, anew, deterministic)
            fresh = np.clip(np.asarray(fresh, np.float32), -1.0, 1.0)  # what is no number stays none, for the guard
            if fresh.shape != (count, 1):
                name = type(self.policy).__name__
                raise ValueError(f"{name} must return residuals of shape ({count}, 1), got {fresh.shape}")
            residual = np.where(due[:, None], fresh, residual)
            policy = _where(due, following, policy)
        action = combine(informed.action, residual, self.settings.limit)
        return action, ResidualMemory(informed, policy, residual, age + 1)


def _where(due: Flags, following: Any, before: Any) -> Any:
    """Memory of a policy: the new one of arms for which it decided, the old one of all others.

    Of the project's policies it is an array with the arms first, of one with an LSTM by sb3-contrib a tuple of arrays,
    each with the layers before the arms. Of one that remembers nothing yet, and where all decided, it is the new one.

    Raises:
        TypeError: If it is anything else, of which the arms cannot be told apart.
    """
    if isinstance(before, tuple):
        return tuple(np.where(due[:, None], new, old) for new, old in zip(following, before, strict=True))
    if isinstance(before, np.ndarray):
        return chosen(due, following, before)
    if before is None or due.all():
        return following
    raise TypeError(
        f"{due.sum()} of {len(due)} arms are due, and of a policy's memory of type {type(before).__name__} the arms "
        "cannot be told apart: make it an array with the arms first, or a tuple of arrays, layers before arms"
    )


class GuardedResidualController(GuardedController):
    """Base and residual with the guard behind them; the servo is that of the base, see `servo_for`."""

    def __init__(
        self, controller: ResidualController, servo: Controller | None = None, settings: GuardSettings | None = None
    ) -> None:
        self._limit = controller.settings.limit
        super().__init__(controller, servo, settings, self._limit)

    def parts(self, action: Singles, memory: Any) -> tuple[Floats, Floats, Floats]:
        """Base, residual and what the observer makes of the arm, see `GuardedController.parts`."""
        assert isinstance(memory, ResidualMemory) and memory.informed is not None
        belief, base = memory.informed.belief, memory.informed.action[:, 0]
        surprise = np.ones(len(action)) if belief is None else belief.tracks.surprise
        residual = self._limit * memory.residual[:, 0].astype(np.float64)
        return base.astype(np.float64), residual, surprise


def behind_guard(controller: Controller, settings: GuardSettings | None = None) -> GuardedController:
    """Put the guard, with the servo that fits, behind a classical controller or one with a residual.

    Raises:
        ValueError: If the controller does not say which arm it is made for, or the servo does not fit it.
    """
    if isinstance(controller, ResidualController):
        return GuardedResidualController(controller, servo_for(controller.informed.base), settings)
    return GuardedController(controller, servo_for(controller), settings)
