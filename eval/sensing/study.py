"""Runs of the controllers that can use an accelerometer, with and without it, on the same scenarios."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from agents.policy.bundle import FELT_POLICIES, POLICIES, load_controller
from agents.residual.controller import ResidualMemory
from baselines.registry import CONTROLLERS, FELT
from beltarm_env.arrays import Floats
from beltarm_env.metrics import TORQUE_QUALITY
from beltarm_env.rollout import Controller, rollout
from eval.comparison.splits import Split
from eval.comparison.check import action_times

Tier = Literal["encoder", "accelerometer"]
TIERS: tuple[Tier, Tier] = ("encoder", "accelerometer")
STUDENT = "student"
NAMES = (*FELT, STUDENT)
"""Controllers of the study."""
COMPARED = ("cost", "tip_rms_mm", "residual_pp_mm")
"""Metrics that are compared scenario by scenario."""


@dataclass(frozen=True)
class Found:
    """What one controller came to with one set of sensors on one split."""

    metrics: dict[str, Floats]  # each of shape (episodes,)
    left: int  # arms that left the workspace
    torsion: float  # RMS error of the estimated torsion, over all samples and arms [rad]


Results = dict[tuple[str, str, Tier], Found]
"""By controller, split and sensors."""
Times = dict[tuple[str, Tier], float]
"""Median of the time per action for one arm [us], by controller and sensors."""


def controller(name: str, tier: Tier) -> Controller:
    """Make a classical controller with its tuned gains, the same for both sets of sensors, or the student of a set."""
    if name == STUDENT:
        return load_controller((POLICIES if tier == "encoder" else FELT_POLICIES) / STUDENT / "seed0")
    return (CONTROLLERS if tier == "encoder" else FELT)[name]()


def measure(name: str, tier: Tier, split: Split, episodes: int) -> Found:
    """Run one controller on the first scenarios of a split."""
    watched = _Watched(controller(name, tier))
    run = rollout(watched, episodes, sensors=tier, **split.arguments(slice(episodes)))
    found = run.metrics()
    errors = np.array(watched.torsions[1:]) - run.state[: len(watched.torsions) - 1, :, 2]
    metrics = {metric: found[metric] for metric in (*COMPARED, *TORQUE_QUALITY)}
    return Found(metrics, int((~run.finished).sum()), float(np.sqrt(np.mean(errors**2))))


def median_time(name: str, tier: Tier) -> float:
    """Median of the time per action for one arm [us]."""
    return action_times(controller(name, tier), tier)[0]


class _Watched:
    """Controller whose estimates of the belt's torsion are kept."""

    def __init__(self, of: Any) -> None:
        self.params = of.params
        self.torsions: list[Floats] = []  # [rad], of shape (n,) for each sample
        self._of = of

    def predict(self, *arguments: Any, **named: Any) -> Any:
        """Call the controller; see `Controller`."""
        action, memory = self._of.predict(*arguments, **named)
        told: Any = memory.informed if isinstance(memory, ResidualMemory) else memory
        estimate = told.belief if hasattr(told, "belief") else told.estimate
        self.torsions.append(estimate.state[:, 2])
        return action, memory
