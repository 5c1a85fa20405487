"""Wall-clock of controllers: per action of one arm and of a batch."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from beltarm_env import BeltArmVectorEnv
from beltarm_env.rollout import Controller

Sensors = Literal["encoder", "tip", "full"]
TIMED_ACTIONS = 300


def action_times(controller: Controller, sensors: Sensors = "encoder") -> tuple[float, float]:
    """Median and 99th percentile of the time per action for one arm [us]."""
    env = BeltArmVectorEnv(1, sensors=sensors)
    observation, _ = env.reset(seed=0)
    return time_actions(controller, env, observation)


def time_actions(controller: Controller, env: BeltArmVectorEnv, observation: Any) -> tuple[float, float]:
    """Median and 99th percentile of the time per action [us], from a given first observation on."""
    memory: Any = None
    start = np.array([True])
    times = []
    for _ in range(TIMED_ACTIONS):
        began = time.perf_counter()
        action, memory = controller.predict(observation, memory, start)
        times.append(time.perf_counter() - began)
        observation, *_ = env.step(action)
        start = np.array([False])
    median, slow = np.percentile(1e6 * np.array(times), [50, 99])
    return float(median), float(slow)


@dataclass(frozen=True)
class Times:
    """Wall-clock of a controller."""

    median: float  # per action of one arm [us]
    slow: float  # 99th percentile of the same [us]
    batched: float  # per action in a batch, median over an episode [us]
    episode: float  # a whole episode of the batch, environment included [s]


def measure_times(controller: Controller, batch: int, seed: int) -> Times:
    """Time a controller on one arm, and for an episode on a batch of the training ranges seeded from `seed` on."""
    median, slow = action_times(controller)
    env = BeltArmVectorEnv(batch, randomization="train")
    observation, _ = env.reset(seed=seed)
    memory: Any = None
    start, over, times = np.ones(batch, np.bool_), False, []
    began = time.perf_counter()
    while not over:
        called = time.perf_counter()
        action, memory = controller.predict(observation, memory, start)
        times.append(time.perf_counter() - called)
        observation, _, terminated, truncated, _ = env.step(action)
        start, over = terminated, bool(truncated.any())
    return Times(median, slow, float(1e6 * np.median(times) / batch), time.perf_counter() - began)
