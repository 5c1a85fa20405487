"""Residual torque: an agent's correction on top of a base controller.

    action = clip(base + limit * residual, -1, 1)

The base acts every sample; the residual is held for `hold` samples. The agent observes what the base observes, and what
the base knows: the torque it is about to apply and its estimate of the belt's torsion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from beltarm_env import observation as layout
from beltarm_env.rollout import Controller

Singles = NDArray[np.float32]
Flags = NDArray[np.bool_]

_TORSION_SCALE = np.array([0.05, 1.0])  # [rad, rad/s]
_TORSION_BOUND = 40.0
EXTRA_ENTRIES = ("base_torque", "estimated_torsion", "estimated_torsion_speed")


class BaseController(Controller, Protocol):
    """A controller that residuals can be learned on."""

    def torsion_estimate(self, memory: Any) -> NDArray[np.float64]:
        """Estimated torsion [rad] and its rate [rad/s] for a memory returned by `predict`, shape (n, 2)."""
        ...


@dataclass(frozen=True, slots=True)
class ResidualSettings:
    """How a residual acts.

    Raises:
        ValueError: If a value is out of range.
    """

    limit: float = 0.5  # largest residual, as a share of the torque limit
    hold: int = 4  # samples per residual: 6 ms

    def __post_init__(self) -> None:
        """Check the ranges."""
        number = isinstance(self.limit, int | float) and not isinstance(self.limit, bool)
        if not (number and 0 < self.limit <= 2):
            raise ValueError(f"residual limit must lie in (0, 2] of the torque limit, got {self.limit!r}")
        whole = isinstance(self.hold, int) and not isinstance(self.hold, bool)
        if not (whole and 1 <= self.hold <= 100):
            raise ValueError(f"residual hold must be a whole number of samples from 1 to 100, got {self.hold!r}")


def residual_observation_space(sensors: str = "encoder") -> spaces.Box:
    """What a residual agent observes."""
    bounds = np.concatenate([layout.bounds(sensors), [1.0, _TORSION_BOUND, _TORSION_BOUND]]).astype(np.float32)
    return spaces.Box(-bounds, bounds, dtype=np.float32)


def augment(observation: Singles, base_action: Singles, torsion: NDArray[np.float64]) -> Singles:
    """Append what the base knows: shape (n, size) becomes (n, size + 3)."""
    scaled = np.clip(torsion / _TORSION_SCALE, -_TORSION_BOUND, _TORSION_BOUND)
    return np.concatenate([observation, base_action, scaled.astype(np.float32)], axis=1)


def combine(base_action: Singles, residual: Singles, limit: float) -> Singles:
    """The action applied; a zero residual gives the base's, bit for bit."""
    return (base_action + np.float32(limit) * residual).clip(-1, 1)


def checked_residual(residual: object, count: int) -> Singles:
    """Residuals of shape (count, 1).

    Raises:
        ValueError: If they have another shape or are not finite numbers.
    """
    array = np.asarray(residual)
    if array.shape != (count, 1) or array.dtype.kind not in "fiu":
        raise ValueError(f"residuals must be numbers of shape ({count}, 1), got {array.dtype} of shape {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"residuals must be finite, got {array[~np.isfinite(array)][0]}")
    return array.astype(np.float32, copy=False)


class Policy(Protocol):
    """The part of a Stable-Baselines3 policy that is used here."""

    def predict(
        self, observation: Singles, state: Any = None, episode_start: Flags | None = None, deterministic: bool = True
    ) -> tuple[Singles, Any]:
        """Residuals of shape (n, 1) for observations of shape (n, size + 3)."""
        ...


@dataclass(frozen=True, slots=True)
class ResidualMemory:
    """Memory of a `ResidualController`."""

    base: Any
    policy: Any
    residual: Singles  # held, (n, 1)
    age: NDArray[np.int64]  # samples since the episode's start, (n,)


class ResidualController:
    """A base controller with a learned residual, as one controller on the environment's own observation."""

    def __init__(self, base: BaseController, policy: Policy, settings: ResidualSettings) -> None:
        self.base = base
        self.policy = policy
        self.settings = settings

    def predict(
        self,
        observation: Singles,
        state: ResidualMemory | None = None,
        episode_start: Flags | None = None,
        deterministic: bool = True,
    ) -> tuple[Singles, ResidualMemory]:
        """Torque over its limit, shape (n, 1), for observations of shape (n, size); see `Controller`."""
        count = len(observation)
        if state is None:
            state = ResidualMemory(None, None, np.zeros((count, 1), np.float32), np.zeros(count, np.int64))
            episode_start = np.ones(count, np.bool_)
        base_action, base = self.base.predict(observation, state.base, episode_start, deterministic)
        age = state.age if episode_start is None else np.where(episode_start, 0, state.age)
        residual, policy = state.residual, state.policy
        due = age % self.settings.hold == 0
        if due.any():
            seen = augment(observation, base_action, self.base.torsion_estimate(base))
            fresh, policy = self.policy.predict(seen, policy, episode_start, deterministic)
            residual = np.where(due[:, None], fresh, residual)
        return combine(base_action, residual, self.settings.limit), ResidualMemory(base, policy, residual, age + 1)
