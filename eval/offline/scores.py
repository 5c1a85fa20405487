"""Reference scores of a dataset: mean returns of random torques and of an expert, on arms of their own."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from agents.policy.bundle import POLICIES, load_controller
from beltarm_env.arrays import Flags, Singles
from beltarm_env.rollout import Controller, rollout
from beltarm_env.task.seeds import DATASET_SCORES

EXPERT = POLICIES / "student" / "seed0"
"""Folder of the policy whose score is 1."""
EPISODES = 100
"""Arms that both means are over."""


class Scores(NamedTuple):
    """Mean returns, sums of rewards that are not discounted."""

    random: float  # of actions that are uniform and independent
    expert: float
    episodes: int  # that each is over


class _Random:
    """Actions that are uniform and independent."""

    def __init__(self) -> None:
        self._random = np.random.default_rng(DATASET_SCORES.first)

    def predict(
        self, observation: Singles, state: Any = None, episode_start: Flags | None = None, deterministic: bool = True
    ) -> tuple[Singles, None]:
        return self._random.uniform(-1, 1, (len(observation), 1)).astype(np.float32), None


def reference_scores(**settings: Any) -> Scores:
    """Measure both; the settings are arguments of `BeltArmVectorEnv`."""

    def mean_return(controller: Controller) -> float:
        return -float(np.mean(rollout(controller, EPISODES, seed=DATASET_SCORES.first, **settings).cost))

    return Scores(mean_return(_Random()), mean_return(load_controller(EXPERT)), EPISODES)
