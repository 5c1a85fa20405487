"""Wall-clock of controllers, and the loop that drives them sample by sample."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from beltarm_env import CONTROL_PERIOD, EPISODE_STEPS, BeltArmVectorEnv
from beltarm_env.observation import Sensors
from beltarm_env.rollout import Controller

TIMED_ACTIONS = 300
_REPETITIONS = 5
PERIOD_US = 1e6 * CONTROL_PERIOD


def drive(
    controller: Controller, num_arms: int, steps: int, seed: int, **settings: Any
) -> Iterator[tuple[NDArray[np.float32], NDArray[np.bool_], NDArray[np.float32]]]:
    """Drive some arms for at most an episode; an arm that leaves its workspace begins a new one, as in `rollout`.

    Args:
        controller: What to run.
        num_arms: Number of arms, run side by side.
        steps: Number of samples.
        seed: Arm i is seeded with `seed + i`.
        **settings: Arguments of `BeltArmVectorEnv`.

    Yields:
        In each sample, before the arms move: observations, which arms begin an episode, actions.
    """
    env = BeltArmVectorEnv(num_arms, autoreset_mode=AutoresetMode.DISABLED, **settings)
    observation, _ = env.reset(seed=seed)
    memory: Any = None
    start = np.ones(num_arms, np.bool_)
    for _ in range(steps):
        action, memory = controller.predict(observation, memory, start)
        yield observation, start, action
        observation, _, start, truncated, _ = env.step(action)
        if start.any() and not truncated.any():
            observation, _ = env.reset(options={"reset_mask": start})


class _Timed:
    """Controller whose calls are timed."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self.seconds: list[float] = []

    def predict(self, *arguments: Any, **named: Any) -> Any:
        """Call the controller; see `Controller`."""
        began = time.perf_counter()
        result = self._controller.predict(*arguments, **named)
        self.seconds.append(time.perf_counter() - began)
        return result


def action_times(controller: Controller, sensors: Sensors = "encoder", seed: int = 0) -> tuple[float, float]:
    """Median and 99th percentile of the time per action for one nominal arm [us]."""
    timed = _Timed(controller)
    for _ in drive(timed, 1, TIMED_ACTIONS, seed, sensors=sensors):
        pass
    median, slow = np.percentile(1e6 * np.array(timed.seconds), [50, 99])
    return float(median), float(slow)


@dataclass(frozen=True)
class Times:
    """Wall-clock of a controller."""

    first: float  # an episode's first action of one arm, with the plan for its move [us]
    median: float  # per later action of one arm [us]
    slow: float  # 99th percentile of the same [us]
    batched: float  # per action in a batch, median over an episode [us]
    episode: float  # a whole episode of the batch, environment included [s]


def measure_times(controller: Controller, batch: int, seed: int) -> Times:
    """Time a controller on one arm of the training ranges, and on a batch of them, seeded from `seed` on.

    Of one arm the same episode is run several times, and the shortest time of each action counts: what else the machine
    does is left out.
    """
    alone = np.min([_timed(controller, 1, seed)[0] for _ in range(_REPETITIONS)], axis=0)
    together, took = _timed(controller, batch, seed)
    median, slow = np.percentile(alone[1:], [50, 99])
    return Times(float(alone[0]), float(median), float(slow), float(np.median(together)) / batch, took)


def _timed(controller: Controller, arms: int, seed: int) -> tuple[NDArray[np.float64], float]:
    """Time of each action of an episode [us], shape (EPISODE_STEPS,), and of the episode [s]."""
    timed, began = _Timed(controller), time.perf_counter()
    for _ in drive(timed, arms, EPISODE_STEPS, seed, randomization="train"):
        pass
    return 1e6 * np.array(timed.seconds), time.perf_counter() - began
