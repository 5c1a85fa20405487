"""Budgets of all methods side by side: samples, search, time, and what their models simulate for each action."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from agents.policy.bundle import read_spec
from baselines import CONTROLLERS
from baselines.estimation.believed_arm import DIFFERENCED
from baselines.estimation.identification import IdentifyingController
from baselines.gains import read_file
from baselines.models.actuator import dead_time
from baselines.optimal.adaptive import AdaptiveController
from baselines.optimal.horizon import STEPS
from baselines.optimal.lqg import LqgController
from baselines.optimal.mpc import MpcController
from baselines.optimal.preview import PreviewController
from baselines.servo.adrc import AdrcController
from baselines.servo.disturbance import DisturbanceController
from baselines.servo.paper import PaperController
from baselines.servo.pid import PidServo
from baselines.servo.retuned import RetunedController
from beltarm_env import CONTROL_PERIOD, EPISODE_STEPS, ArmParams
from eval.comparison.methods import Method, learned_methods, shipped_policies


class ModelSteps(NamedTuple):
    """Steps of 1.5 ms of a controller's own model, for each action."""

    simulated: int  # of the arm with its friction, one after the other or side by side
    planned: int  # of a linear model, backward in time; those of plans made rarely are spread over the actions between


def _ahead(params: ArmParams) -> int:
    """Steps over the drive's dead time."""
    return ceil(dead_time(params) / CONTROL_PERIOD)


_FILTER = 1 + DIFFERENCED
"""Of the identification: the arm believed in, and one for each derivative."""
_ONE_PLAN = EPISODE_STEPS
_PLANS_APART = 20  # samples, of a controller that makes plans as it learns about its arm

MODEL_STEPS: dict[type, Callable[[Any], ModelSteps]] = {
    PaperController: lambda _: ModelSteps(1, 0),
    RetunedController: lambda _: ModelSteps(1, 0),
    PidServo: lambda _: ModelSteps(0, 0),
    DisturbanceController: lambda _: ModelSteps(0, 0),
    AdrcController: lambda _: ModelSteps(0, 0),
    LqgController: lambda c: ModelSteps(1 + _ahead(c.params), 0),
    PreviewController: lambda c: ModelSteps(1 + _ahead(c.params), _ONE_PLAN // EPISODE_STEPS),
    MpcController: lambda c: ModelSteps(1 + _ahead(c.params), len(STEPS)),
    AdaptiveController: lambda c: ModelSteps(_FILTER + _ahead(c.params), _ONE_PLAN // _PLANS_APART),
}
"""By the type of controller; those of an active set and of plans are for one pass."""


def model_steps(controller: Any) -> ModelSteps | None:
    """Model steps of a classical controller; None if they are not stated for its type."""
    return next((steps(controller) for kind, steps in MODEL_STEPS.items() if isinstance(controller, kind)), None)


SEARCHES = {"ppo": (24, 200e6)}
"""Trials and samples of a search for settings that came before the training, by method; docs/training.md has it."""


@dataclass(frozen=True)
class Budget:
    """What a method was given."""

    name: str
    kind: str  # "classical" or "learned"
    runs: int  # that its samples and seconds are the mean of: training seeds
    samples: float  # simulated by tuning or training, a run
    trials: int  # of gains or settings, by the search
    refused: int  # proposals that fell short of the margins, on top of the trials
    searched: float  # samples of a search that came before
    seconds: float  # wall-clock of a run
    kept: bool  # whether the search found nothing better than the untuned gains
    steps: ModelSteps | None


def budgets(names: Sequence[str]) -> list[Budget]:
    """Budgets of some classical controllers, and of the shipped policies.

    Raises:
        ValueError: If a file of gains or a policy is damaged.
    """
    learned = learned_methods(shipped_policies())
    return [*(_classical(name) for name in names), *(_learned(method) for method in learned)]


def _classical(name: str) -> Budget:
    origin = read_file().get(name, {}).get("provenance", {})
    return Budget(
        name=name,
        kind="classical",
        runs=1,
        samples=origin.get("steps", 0),
        trials=origin.get("trials", 0),
        refused=origin.get("refused", 0),
        searched=0,
        seconds=origin.get("seconds", 0.0),
        kept=bool(origin) and origin["cost"] == origin["cost_untuned"],
        steps=model_steps(CONTROLLERS[name]()),
    )


def _learned(method: Method) -> Budget:
    knowledge = read_spec(Path(method.sources[0]))[0].residual.knowledge
    base = CONTROLLERS[method.base]() if method.base in CONTROLLERS else None
    steps = (model_steps(base) if base else None) or ModelSteps(0, 0)
    if knowledge == "belief" and not isinstance(base, IdentifyingController):
        steps = steps._replace(simulated=steps.simulated + _FILTER)
    trials, searched = SEARCHES.get(method.name, (0, 0.0))
    return Budget(
        name=method.name,
        kind="learned",
        runs=len(method.sources),
        samples=float(np.mean(method.training["simulator_steps"])),
        trials=trials,
        refused=0,
        searched=searched,
        seconds=float(np.mean(method.training["wall_clock_s"])),
        kept=False,
        steps=steps,
    )
