"""What practice brings: the same move on the same arm, again and again.

`adaptive` remembers the arm (`baselines.yardsticks.remembering`); the textbook learns a feed-forward
(`baselines.yardsticks.iterative`). Controllers that learn nothing from trial to trial stand beside them.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from baselines import CONTROLLERS
from baselines.yardsticks.iterative import IterativeController
from baselines.yardsticks.remembering import RememberingController
from beltarm_env.arm import COLUMN
from beltarm_env.arrays import Floats
from beltarm_env.metrics import METRICS, heading
from beltarm_env.rollout import Recording, rollout
from beltarm_env.task.ranges import PRESLIDING, TRAIN_RANGES
from beltarm_env.task.reference import sampled_moves
from beltarm_env.task.seeds import REPETITION
from eval.comparison.methods import PRIVILEGED, chosen
from eval.comparison.rollouts import side_by_side
from eval.comparison.statistics import estimate, paired
from eval.report.style import BLUE, GREEN, VERMILION, below, mark_one_two_five, panels
from eval.studies._arms import privileged
from eval.studies._frame import Bounds, OptionsWithJobs, Pictures

QUICK = {"arms": 4, "repetitions": 2, "jobs": 1}
MEMORY, WHOLE_MEMORY, LEARNER = "remembering", "remembering g too", "iterative"
PRACTISING: dict[str, Callable[[], RememberingController | IterativeController]] = {
    MEMORY: RememberingController,
    WHOLE_MEMORY: partial(RememberingController, keeps_giving=True),
    LEARNER: IterativeController,
}
"""What makes the first trial and the controllers of all that follow, by name."""
OTHERS = ("paper", "adaptive", PRIVILEGED)
"""Controllers that learn nothing from trial to trial."""
PAIRS = (
    *((MEMORY, 1, "adaptive"), (MEMORY, -1, "adaptive"), (MEMORY, -1, PRIVILEGED)),
    *((WHOLE_MEMORY, -1, "adaptive"), (LEARNER, -1, "paper"), (LEARNER, -1, "adaptive")),
)
"""Differences of costs that are shown: of a controller in its second trial or the last, from another controller."""
KINDS = {
    "nominal": ("off", "the nominal arm with an ideal drive, random moves"),
    "randomized": ("train", "arms and drives from the training ranges"),
    "giving": ({**TRAIN_RANGES, **PRESLIDING}, "the same, with motors that give by 0.3 to 5 mrad"),
}
"""The environment's randomization, and what it is, by name."""
_MOTOR_RMS = "motor_rms_mrad"
_HEADED = ("cost", "tip_rms_mm", "residual_pp_mm")
_TITLES = {**{name: heading(name) for name in _HEADED}, _MOTOR_RMS: "motor RMS (mrad at the joint)"}
_DIGITS = {**{name: METRICS[name].digits + 1 for name in _HEADED}, _MOTOR_RMS: 2}


@dataclass(frozen=True)
class Options(OptionsWithJobs):
    """Options of the study."""

    bounds = OptionsWithJobs.bounds | Bounds(arms=(4, REPETITION.size), repetitions=(2, 100))

    kinds: tuple[str, ...] = ()
    """Kinds of arms: nominal, randomized, giving. Default: all."""
    arms: int = 100
    """Arms of each kind, 4 to 1000."""
    repetitions: int = 20
    """Number of times that each arm makes its move, 2 to 100."""


def measure(options: Options) -> dict[str, Any]:
    """Metrics of every controller on every kind of arms, by repetition, and differences of their costs."""
    kinds = chosen("kind", options.kinds, KINDS)
    cases = [(*case, options.arms, options.repetitions) for case in product(kinds, (*PRACTISING, *OTHERS))]
    results = side_by_side("controllers and kinds of arms", run, cases, options.jobs)
    rows, trials = [], {(kind, name): result for (kind, name, *_), result in results.items()}
    for (kind, name), each in trials.items():
        for k, metrics in enumerate(each, start=1):
            levels = {metric: estimate(values[None]) for metric, values in metrics.items()}
            of = {"kind": kind, "controller": name, "repetition": k if name in PRACTISING else None}
            rows.append({**of, "quartiles": np.percentile(metrics["cost"], [25, 75]), **levels})
    differences = []
    pairs = dict.fromkeys((name, trial % options.repetitions, other) for name, trial, other in PAIRS)
    for kind, (name, trial, other) in product(kinds, pairs):
        pair = paired(trials[kind, name][trial]["cost"][None], trials[kind, other][0]["cost"][None])
        of = {"kind": kind, "controller": name, "repetition": trial + 1, "against": other}
        differences.append({**of, "difference": pair.difference, "wins": pair.win_rate.iqm})
    return {
        "arms": options.arms,
        "repetitions": options.repetitions,
        "first_seed": REPETITION.first,
        "kinds": {kind: KINDS[kind][1] for kind in kinds},
        "differences": differences,
        "rows": rows,
    }


def run(kind: str, name: str, arms: int, repetitions: int) -> list[dict[str, Floats]]:
    """Metrics of each repetition of one controller on one kind of arms."""
    scenarios = {"seed": REPETITION.first, "randomization": KINDS[kind][0]}
    if name in PRACTISING:
        controller, trials = PRACTISING[name](), list[dict[str, Floats]]()
        for _ in range(repetitions):
            trials.append(metrics_of(rollout(controller, arms, **scenarios)))
            controller = controller.following()
        return trials
    if name == PRIVILEGED:
        return [metrics_of(rollout(privileged(arms, **scenarios), arms, sensors="full", **scenarios))]
    return [metrics_of(rollout(CONTROLLERS[name](), arms, **scenarios))]


def metrics_of(run: Recording) -> dict[str, Floats]:
    """Reported metrics of a trial, each of shape (n,)."""
    tasks = sampled_moves(run.moves, len(run.state))
    joint = run.state[:, :, 0] / run.params[:, COLUMN.gear_ratio]
    metrics = run.metrics()
    motor = 1e3 * np.sqrt(np.mean((joint - tasks[:, 1:, 0].T) ** 2, axis=0))
    return {name: motor if name == _MOTOR_RMS else metrics[name] for name in _TITLES}


def tables(data: dict[str, Any]) -> dict[str, Any]:
    """Titles and digits of the metrics, and the repetitions that the page shows."""
    return {"titles": _TITLES, "digits": _DIGITS, "shown": sorted({1, 2, data["repetitions"]})}


def pictures(data: dict[str, Any]) -> Pictures:
    """Cost over the repetitions."""
    return {"cost.png": lambda: _draw(data)}


def _draw(data: dict[str, Any]) -> Figure:
    """Draw the cost over the repetitions, for all kinds of arms."""
    kinds = data["kinds"]
    figure, axes = panels(len(kinds), len(kinds), (4.2, 4), sharey=True)
    for axis, (kind, description) in zip(axes, kinds.items(), strict=True):
        axis.set_title(f"{kind}\n{description}", fontsize=9)
        _curves(axis, [row for row in data["rows"] if row["kind"] == kind])
    axes[0].set_ylabel("cost of an episode")
    figure.suptitle("Interquartile means over arms; band: the middle half of the arms", fontsize=10)
    below(figure, axes[0], len(PRACTISING) + len(OTHERS))
    return figure


def _curves(axis: Axes, rows: list[dict[str, Any]]) -> None:
    for name, colour in zip(PRACTISING, (BLUE, GREEN, VERMILION), strict=True):
        practised = [row for row in rows if row["controller"] == name]
        numbers = range(1, len(practised) + 1)
        low, high = zip(*(row["quartiles"] for row in practised), strict=True)
        axis.fill_between(numbers, low, high, color=colour, alpha=0.15, linewidth=0)
        axis.plot(numbers, [row["cost"]["iqm"] for row in practised], "o-", color=colour, markersize=3, label=name)
    for name, line in zip(OTHERS, (":", "--", "-."), strict=True):
        (row,) = (row for row in rows if row["controller"] == name)
        axis.axhline(row["cost"]["iqm"], color="0.3", linewidth=1, linestyle=line, label=name)
    axis.set(xlabel="repetition", yscale="log")
    mark_one_two_five(axis.yaxis)
    axis.xaxis.set_major_locator(MaxNLocator(5, integer=True))
