"""The same moves on the same arms again and again, with what each repetition learns passed to the next."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines import PaperController, tuned_controller
from baselines.iterative.controller import IterativeController
from baselines.iterative.lesson import Notes
from baselines.iterative.motor_learning import MotorLearningController
from baselines.yardsticks.privileged import PrivilegedController
from beltarm_env import BeltArmVectorEnv
from beltarm_env.arm import COLUMN
from beltarm_env.rollout import Controller, Recording, rollout
from beltarm_env.task.reference import sampled_moves
from eval.comparison.statistics import Estimate, estimate

Floats = NDArray[np.float64]

TORQUE, ARM, MOTOR = "iterative", "arm alone", "motor"
LEARNERS: dict[str, Callable[..., Any]] = {
    TORQUE: IterativeController,
    ARM: partial(IterativeController, learn_torque=False),
    MOTOR: MotorLearningController,
}
"""By name: makes the controller of one trial from what was learnt before, None at first."""


@dataclass(frozen=True, slots=True)
class Kind:
    """Arms that the moves are repeated on."""

    randomization: str
    description: str


KINDS = {
    "nominal": Kind("off", "the nominal arm behind an ideal drive"),
    "ideal": Kind("ideal", "arms of the training ranges behind an ideal drive"),
    "randomized": Kind("train", "arms and drives of the training ranges"),
}


@dataclass(frozen=True)
class RepetitionResult:
    """One controller on one kind of arms: metrics of each repetition, each of shape (n,)."""

    kind: str
    name: str
    repetitions: list[dict[str, Floats]]

    @cached_property
    def estimates(self) -> list[dict[str, Estimate]]:
        """Interquartile means over the arms, with intervals."""
        return [{name: estimate(values[None]) for name, values in run.items()} for run in self.repetitions]


def metrics(run: Recording) -> dict[str, Floats]:
    """Reported metrics of a trial, each of shape (n,)."""
    tasks = sampled_moves(run.moves, len(run.state))
    joint = run.state[:, :, 0] / run.params[:, COLUMN.gear_ratio]
    of_tip = run.metrics()
    wanted = {name: of_tip[name] for name in ("cost", "tip_rms_mm", "residual_pp_mm")}
    return {**wanted, "motor_rms_mrad": 1e3 * np.sqrt(np.mean((joint - tasks[:, 1:, 0].T) ** 2, axis=0))}


def repeated(make: Callable[..., Any], arms: int, repetitions: int, **scenarios: Any) -> list[dict[str, Floats]]:
    """Metrics of each repetition, in order.

    Args:
        make: One of `LEARNERS`.
        arms: Number of arms, side by side.
        repetitions: Number of times that each arm makes its move.
        **scenarios: Seed and settings of `rollout`, the same every time.
    """
    lesson, found = None, []
    for _ in range(repetitions):
        controller = make(lesson)
        notes = Notes(controller)
        found.append(metrics(rollout(notes, arms, **scenarios)))
        lesson = controller.learned(notes)
    return found


def _privileged(arms: int, seed: int, randomization: str) -> Controller:
    """The plan of `adaptive`, with its gains, for arms whose constants and state are known."""
    env = BeltArmVectorEnv(arms, randomization=randomization)  # pyright: ignore[reportArgumentType]
    env.reset(seed=seed)
    return PrivilegedController(env.params)


def run_study(arms: int, repetitions: int, seed: int) -> list[RepetitionResult]:
    """Repeat the moves with every learner, and make them once with every yardstick, on all kinds of arms."""
    results = []
    for kind, of_kind in KINDS.items():
        scenarios = {"seed": seed, "randomization": of_kind.randomization}
        yardsticks = {
            "paper": (PaperController(), {}),
            "adaptive": (tuned_controller("adaptive"), {}),
            "privileged": (_privileged(arms, **scenarios), {"sensors": "full"}),
        }
        for name, make in LEARNERS.items():
            results.append(RepetitionResult(kind, name, repeated(make, arms, repetitions, **scenarios)))
        for name, (controller, settings) in yardsticks.items():
            results.append(RepetitionResult(kind, name, [metrics(rollout(controller, arms, **scenarios, **settings))]))
    return results
