"""Wall-clock of controllers, and the loop that drives them sample by sample.

Where computing time counts, a command acts later than the drive's own latency by the 99th percentile of the method's
time per action for one arm, in every scenario. A run that goes on from kept results must not measure that again: its
arms would be others. So the times are kept beside the results in `computing_time.json`, under a key of everything that
the method depends on, and measured anew only for `--fresh`, or for another method or other code.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from baselines.tools.files import read_text, write_text
from baselines.tools.schema import loads
from beltarm_env import CONTROL_PERIOD, EPISODE_STEPS, ArmParams, BeltArmVectorEnv
from beltarm_env.observation import Sensors
from beltarm_env.rollout import Controller
from eval.comparison.failures import Failure, run_controller
from eval.comparison.methods import Method
from eval.comparison.pairs import key_of

TIMED_ACTIONS = 300
_REPETITIONS = 5
PERIOD_US = 1e6 * CONTROL_PERIOD
FILE = "computing_time.json"
_LONGEST = 1e9  # time that is believed [us]
ActionTimes = tuple[float, float]
"""Median and 99th percentile of the time per action for one arm [us]."""


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


def action_times(controller: Controller, sensors: Sensors = "encoder", seed: int = 0) -> ActionTimes:
    """Time the actions of a controller for one nominal arm."""
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


def measured_times(methods: Sequence[Method]) -> dict[str, ActionTimes | Failure]:
    """Times of some methods, by name, measured now; a failure where a controller fails on one arm."""
    return {method.name: run_controller(method, "", partial(_time, method), "one arm") for method in methods}


def _time(method: Method) -> ActionTimes:
    return action_times(method.controller(0, [ArmParams()]), method.sensors)


def measured_once(methods: Sequence[Method], folder: Path, *, fresh: bool = False) -> dict[str, ActionTimes | Failure]:
    """Times of some methods, by name: those that the folder has, the others measured and kept in it.

    Args:
        methods: What to time; one of unknown identity is always measured.
        folder: Of the comparison.
        fresh: Whether to measure all of them anew.

    Raises:
        OSError: If the times cannot be written.
    """
    kept, found = _read(folder / FILE), {}
    for method in methods:
        key = None if method.identity is None else key_of(method)
        entry = kept.get(method.name, {})
        if not fresh and key is not None and entry.get("key") == key:
            found[method.name] = entry["p50"], entry["p99"]
            continue
        found |= measured_times([method])
        if key is not None and not isinstance(times := found[method.name], Failure):
            kept[method.name] = {"key": key, "p50": times[0], "p99": times[1]}
            write_text(folder / FILE, json.dumps(kept, indent=1) + "\n")
    return found


def _read(path: Path) -> dict[str, dict[str, Any]]:
    """Times that are kept, by method; those of a damaged file, or damaged in it, are measured anew."""
    try:
        content = loads(read_text(path))
        return {name: entry for name, entry in content.items() if _LONGEST >= entry["p99"] >= entry["p50"] > 0}
    except (OSError, ValueError, AttributeError, KeyError, TypeError):
        return {}
