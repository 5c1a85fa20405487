"""Budgets of all methods side by side: samples, search, time, and what their models simulate for each action.

All samples of a method are those of its own runs (one search for gains, or a training per seed), of a search for
settings that came before, of the search for its base's gains, and the model steps that a teacher makes in training.
"""

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
from eval.report.text import markdown_table, number


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
"""Trials and samples of a search for settings that came before the training, by method; docs/science/training.md."""
TEACHERS = {"student": 20, "rma": 20}
"""Model steps that a teacher makes for each sample of the training, by algorithm: differences by every state."""

BUDGETS_NOTE = (
    "Classical gains come from one search each: its samples are those of all trials and of the choice among the "
    "best; *refused* are proposals whose loop fell short of the margins, which cost no samples. Learned methods are "
    "trained with settings that were found before, on samples of their own (docs/science/training.md); runs "
    "are training seeds. *Model steps* are those of 1.5 ms that the controller's own model makes for each action: "
    "simulated with friction, drive and stiction, one after the other or for derivatives, + those of a linear plan, "
    "backward in time. A plan for the whole move has 1200, spread over the actions between two plans; one pass of an "
    "active set counts. Agents have the steps of their base and of the filter that tells them about the arm; in "
    "training, a student's teacher simulates 20 steps more for each sample. *All* is summed over the runs, with the "
    "search before, the teacher's steps, and the search for the base's gains. What was tried by hand is not counted."
)
"""What the table of budgets means."""


@dataclass(frozen=True)
class Budget:
    """What a method was given."""

    name: str
    kind: str  # "classical" or "learned"
    runs: int  # that its samples and seconds are the mean of: training seeds
    samples: float  # simulated by tuning or training, a run
    taught: float  # model steps of a teacher, a run
    of_base: float  # samples of the search for its base's gains
    trials: int  # of gains or settings, by the search
    refused: int  # proposals that fell short of the margins, on top of the trials
    searched: float  # samples of a search that came before
    seconds: float  # wall-clock of a run
    kept: bool  # whether the search found nothing better than the untuned gains
    steps: ModelSteps | None

    @property
    def total(self) -> float:
        """All samples and model steps that the method took, over all its runs."""
        return self.runs * (self.samples + self.taught) + self.searched + self.of_base


def budgets(names: Sequence[str]) -> list[Budget]:
    """Budgets of some classical controllers, and of the shipped policies.

    Raises:
        ValueError: If a file of gains or a policy is damaged.
    """
    learned = learned_methods(shipped_policies())
    return [*map(_classical, names), *map(_learned, learned)]


def budget_of(method: Method) -> Budget | None:
    """Budget of a method of a comparison; None for what was neither tuned nor trained here."""
    if method.kind == "learned" and method.training:
        return _learned(method)
    return _classical(method.name) if method.name in CONTROLLERS else None


def budgets_table(found: Sequence[Budget]) -> str:
    """What each method was given, in Markdown."""
    titles = ["method", "runs", "samples of one (million)", "trials in them", "refused", "searched before (million)"]
    titles += ["teacher's steps, of one (million)", "base (million)", "all (million)", "minutes of one"]
    rows = []
    for of in found:
        effort = [_million(of.samples), str(of.trials) if of.kind == "classical" else "–"]
        effort += [str(of.refused) if of.kind == "classical" else "–"]
        effort += [f"{of.searched / 1e6:.0f} in {of.trials} trials" if of.searched else "–"]
        effort += [_million(of.taught), _million(of.of_base), _million(of.total)]
        steps = f"{of.steps.simulated} + {of.steps.planned}" if of.steps else "not stated"
        rows.append([of.name, str(of.runs), *effort, number(of.seconds / 60, 1) if of.seconds else "–", steps])
    return markdown_table([*titles, "model steps per action"], rows)


def _million(samples: float) -> str:
    return number(samples / 1e6, 1) if samples else "–"


def _classical(name: str) -> Budget:
    origin = read_file().get(name, {}).get("provenance", {})
    return Budget(
        name=name,
        kind="classical",
        runs=1,
        samples=origin.get("steps", 0),
        taught=0.0,
        of_base=0.0,
        trials=origin.get("trials", 0),
        refused=origin.get("refused", 0),
        searched=0,
        seconds=origin.get("seconds", 0.0),
        kept=bool(origin) and origin["cost"] == origin["cost_untuned"],
        steps=model_steps(CONTROLLERS[name]()),
    )


def _learned(method: Method) -> Budget:
    spec = read_spec(Path(method.sources[0]))[0]
    base = CONTROLLERS[method.base]() if method.base in CONTROLLERS else None
    steps = (model_steps(base) if base else None) or ModelSteps(0, 0)
    if spec.residual.knowledge == "belief" and not isinstance(base, IdentifyingController):
        steps = steps._replace(simulated=steps.simulated + _FILTER)
    trials, searched = SEARCHES.get(method.name, (0, 0.0))
    samples = float(np.mean(method.training["simulator_steps"]))
    return Budget(
        name=method.name,
        kind="learned",
        runs=len(method.sources),
        samples=samples,
        taught=TEACHERS.get(spec.algorithm, 0) * samples,
        of_base=_classical(method.base).samples if method.base else 0.0,
        trials=trials,
        refused=0,
        searched=searched,
        seconds=float(np.mean(method.training["wall_clock_s"])),
        kept=False,
        steps=steps,
    )
