"""What a controller gains by repeating the same move on the same arm.

Three ways of learning from one repetition to the next are compared: arm and torque
(`baselines.iterative.controller`), the arm alone, and the textbook's use of the motor's error
(`baselines.iterative.motor_learning`). Controllers that learn nothing stand beside them.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from baselines import PaperController, tuned_controller
from baselines.iterative.controller import IterativeController
from baselines.iterative.lesson import Notes
from baselines.iterative.motor_learning import MotorLearningController
from beltarm_env.arm import COLUMN
from beltarm_env.arrays import Floats
from beltarm_env.metrics import METRICS, heading
from beltarm_env.rollout import Recording, rollout
from beltarm_env.task.reference import sampled_moves
from beltarm_env.task.seeds import REPETITION
from eval.comparison.methods import chosen
from eval.comparison.rollouts import side_by_side
from eval.comparison.statistics import estimate, interquartile_mean, paired
from eval.report.style import BLUE, ORANGE, VERMILION, mark_one_two_five
from eval.studies._arms import privileged
from eval.studies._frame import Bounds, Pictures, StudyOptions

QUICK = {"arms": 4, "repetitions": 2, "kinds": ("randomized",), "jobs": 1}
TORQUE, ARM, MOTOR = "iterative", "arm alone", "motor"
LEARNERS: dict[str, Callable[..., Any]] = {
    TORQUE: IterativeController,
    ARM: partial(IterativeController, learn_torque=False),
    MOTOR: MotorLearningController,
}
"""By name: makes the controller of one trial from the lesson of the trials before, None at first."""
OTHERS = ("paper", "adaptive", "privileged")
"""Controllers that learn nothing from trial to trial."""
KINDS = {
    "nominal": ("off", "the nominal arm with an ideal drive, random moves"),
    "ideal": ("ideal", "arms from the training ranges, but with an ideal drive"),
    "randomized": ("train", "arms and drives from the training ranges"),
}
"""The environment's randomization, and what it is, by name."""
_MOTOR_RMS = "motor_rms_mrad"
_TITLES = {
    **{name: heading(name) for name in ("cost", "tip_rms_mm", "residual_pp_mm")},
    _MOTOR_RMS: "motor RMS (mrad at the joint)",
}
_DIGITS = {**{name: METRICS[name].digits + 1 for name in _TITLES if name in METRICS}, _MOTOR_RMS: 2}


@dataclass(frozen=True)
class Options(StudyOptions):
    """Options of the study."""

    bounds = Bounds(arms=(4, REPETITION.size), repetitions=(2, 100), jobs=(1, 256))

    kinds: tuple[str, ...] = ()
    """Kinds of arms: nominal, ideal, randomized. Default: all."""
    arms: int = 100
    """Arms of each kind, 4 to 1000."""
    repetitions: int = 10
    """Number of times that each arm makes its move, 2 to 100."""
    jobs: int | None = None
    """Number of processes. Default: one per core."""


def measure(options: Options) -> dict[str, Any]:
    """Metrics of every controller on every kind of arms, by repetition, and differences of their costs."""
    kinds = chosen("kind", options.kinds, KINDS)
    cases = [
        *((kind, name, options.arms, options.repetitions) for kind in kinds for name in LEARNERS),
        *((kind, name, options.arms, 1) for kind in kinds for name in OTHERS),
    ]
    results = side_by_side("controllers and kinds of arms", run, cases, options.jobs)
    trials = {(kind, name): result for (kind, name, *_), result in results.items()}
    rows, differences = [], []
    for kind in kinds:
        first = trials[kind, TORQUE][0]["cost"]
        for name in (*LEARNERS, *OTHERS):
            for k, metrics in enumerate(trials[kind, name], start=1):
                levels = {metric: estimate(values[None]) for metric, values in metrics.items()}
                cost = {"quartiles": np.percentile(metrics["cost"], [25, 75]), "relative": _relative(metrics, first)}
                repetition = k if name in LEARNERS else None
                rows.append({"kind": kind, "controller": name, "repetition": repetition, **levels, **cost})
        last = trials[kind, TORQUE][-1]["cost"]
        others = {
            f"first of `{TORQUE}`": first,
            f"last of `{ARM}`": trials[kind, ARM][-1]["cost"],
            "`privileged`": trials[kind, "privileged"][0]["cost"],
        }
        for name, cost in others.items():
            pair = paired(last[None], cost[None])
            change = {"difference": pair.difference, "wins": pair.win_rate.iqm}
            differences.append({"kind": kind, "against": name, **change})
    return {
        "arms": options.arms,
        "repetitions": options.repetitions,
        "first_seed": REPETITION.first,
        "kinds": {kind: KINDS[kind][1] for kind in kinds},
        "differences": differences,
        "rows": rows,
    }


def _relative(metrics: Mapping[str, Floats], first: Floats) -> list[float]:
    """Interquartile mean and quartiles of the cost over each arm's first [%]."""
    ratio = 100 * metrics["cost"] / first
    return [interquartile_mean(ratio), *np.percentile(ratio, [25, 75])]


def run(kind: str, name: str, arms: int, repetitions: int) -> list[dict[str, Floats]]:
    """Metrics of each repetition of one controller on one kind of arms."""
    scenarios = {"seed": REPETITION.first, "randomization": KINDS[kind][0]}
    if name in LEARNERS:
        return repeated(LEARNERS[name], arms, repetitions, **scenarios)
    if name == "privileged":
        return [metrics_of(rollout(privileged(arms, **scenarios), arms, sensors="full", **scenarios))]
    controller = PaperController() if name == "paper" else tuned_controller(name)
    return [metrics_of(rollout(controller, arms, **scenarios))]


def repeated(make: Callable[..., Any], arms: int, repetitions: int, **scenarios: Any) -> list[dict[str, Floats]]:
    """Metrics of each repetition, in order.

    Args:
        make: One of `LEARNERS`.
        arms: Number of arms, side by side.
        repetitions: Number of times that each arm makes its move.
        **scenarios: Seed and settings of `rollout`, the same every time.
    """
    lesson, trials = None, []
    for _ in range(repetitions):
        controller = make(lesson)
        notes = Notes(controller)
        trials.append(metrics_of(rollout(notes, arms, **scenarios)))
        lesson = controller.learned(notes)
    return trials


def metrics_of(run: Recording) -> dict[str, Floats]:
    """Reported metrics of a trial, each of shape (n,)."""
    tasks = sampled_moves(run.moves, len(run.state))
    joint = run.state[:, :, 0] / run.params[:, COLUMN.gear_ratio]
    metrics = run.metrics()
    motor = 1e3 * np.sqrt(np.mean((joint - tasks[:, 1:, 0].T) ** 2, axis=0))
    return {name: motor if name == _MOTOR_RMS else metrics[name] for name in _TITLES}


def tables(data: dict[str, Any]) -> dict[str, Any]:
    """Titles and digits of the metrics."""
    return {"titles": _TITLES, "digits": _DIGITS}


_COLOURS = {TORQUE: BLUE, ARM: ORANGE, MOTOR: VERMILION}
_LINES: dict[str, str] = dict(zip(OTHERS, (":", "--", "-."), strict=True))


def pictures(data: dict[str, Any]) -> Pictures:
    """Cost over the repetitions."""
    return {"cost.png": lambda: _draw(data)}


def _draw(data: dict[str, Any]) -> Figure:
    """Draw the cost over the repetitions, over each arm's first and as it is, for all kinds of arms."""
    kinds = data["kinds"]
    size = (5 * len(kinds), 7.4)
    figure, grid = plt.subplots(2, len(kinds), figsize=size, sharey="row", squeeze=False, layout="constrained")
    for (relative, whole), (kind, description) in zip(grid.T, kinds.items(), strict=True):
        relative.set_title(f"{kind}\n{description}", fontsize=10)
        _curves(relative, data, kind, (TORQUE, ARM, "adaptive", "privileged"), relative=True)
        whole.set_yscale("log")
        _curves(whole, data, kind, (TORQUE, MOTOR, "paper", "adaptive"), relative=False)
        mark_one_two_five(whole.yaxis)
        whole.set_xlabel("repetition")
    grid[0, 0].set_ylabel("cost of an episode (% of that arm's first)")
    grid[1, 0].set_ylabel("cost of an episode")
    figure.suptitle("Interquartile means over arms; bands: the middle half of the arms", fontsize=10)
    return figure


def _curves(axes: Axes, data: dict[str, Any], kind: str, names: tuple[str, ...], relative: bool) -> None:
    for name in names:
        rows = [row for row in data["rows"] if (row["kind"], row["controller"]) == (kind, name)]
        levels = [row["relative"] if relative else [row["cost"]["iqm"], *row["quartiles"]] for row in rows]
        means, low, high = zip(*levels, strict=True)
        if name in LEARNERS:
            numbers = range(1, len(rows) + 1)
            axes.fill_between(numbers, low, high, color=_COLOURS[name], alpha=0.15, linewidth=0)
            axes.plot(numbers, means, color=_COLOURS[name], marker="o", markersize=3, label=name)
        else:
            axes.axhline(means[0], color="0.3", linewidth=1, linestyle=_LINES[name], label=name)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.margins(x=0.02)
    axes.legend(fontsize=9, frameon=False)
