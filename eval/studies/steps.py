"""What each step from the controller of 1991 to the best classical one brings on a working shift, and learning then.

Every controller of the chain has one thing more than the one before; all make the same moves with the same arms, drives
and parts of a shift. Beside them is the least attainable cost of the first arms.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from agents.policy.bundle import load_controller
from baselines import CONTROLLERS
from baselines.gains import tuned
from baselines.optimal.adaptive import AdaptiveController, AdaptiveGains
from baselines.tools.progress import progress_over
from baselines.yardsticks.clairvoyant import shift_optimum
from baselines.yardsticks.privileged import PrivilegedController
from beltarm_env.arrays import Floats
from beltarm_env.metrics import TORQUE_QUALITY, heading
from beltarm_env.recording import Recording
from beltarm_env.rollout import rollout
from beltarm_env.task.seeds import LOOPS
from eval.comparison.methods import PRIVILEGED, shipped_policies
from eval.comparison.rollouts import calls_side_by_side
from eval.comparison.splits import arms_of
from eval.comparison.statistics import average, worst_mean
from eval.report.style import BLUE, GREEN, VERMILION, name_rows
from eval.studies._arms import believing, identifying_nothing
from eval.studies._frame import Bounds, OptionsWithJobs, Pictures

SHOWN = ("tip_rms_mm", "residual_pp_mm", *TORQUE_QUALITY)
"""Metrics of the table."""
GUESSES = ("adaptive", PRIVILEGED)
"""Controllers of the chain with whose torques the search for the optimum begins."""
QUICK = {"arms": 4, "moves": 2, "optima": 1, "jobs": 1}

_TIMING = ("delay", "lag")
_TURNING = ("variation", "excess", "stiffening")
_RIPPLE = ("ripple",)
_GIVING = ("giving",)


@dataclass(frozen=True)
class Options(OptionsWithJobs):
    """Options of the study."""

    bounds = OptionsWithJobs.bounds | Bounds(arms=(4, 10_000), moves=(2, 100), optima=(1, 10_000))

    arms: int = 64
    """Number of arms, 4 to 10000."""
    moves: int = 8
    """Moves of each, 2 to 100."""
    optima: int = 10
    """How many of the arms, the first ones, get the clairvoyant optimum too, 1 to 10000."""


class Step(NamedTuple):
    """Controllers, of which the results are averaged, and what they have that the one before has not."""

    title: str
    controller: str
    make: Callable[[Recording | None], list[Any]]  # its controllers, of arms that another one has moved


def _tuned(title: str, name: str) -> Step:
    return Step(title, name, lambda _: [CONTROLLERS[name]()])


def _held(title: str, *held: str, remembers: bool = False) -> Step:
    return Step(title, "adaptive", lambda _: [believing(*held, remembers=remembers)])


def _privileged(moved: Recording | None, model: str = "lumped") -> list[Any]:
    """The oracle that knows the arms of all moves of a recording, and their equations of motion."""
    if moved is None or not moved.stayed.all():
        raise ValueError("an arm left its workspace in the first step: the arms of its later moves are not known")
    return [PrivilegedController(*arms_of(moved.params.reshape(moved.num_moves, moved.num_arms, -1)), model=model)]


CHAIN = (
    _tuned("1991: computed torque, PD, torsion feedback", "paper"),
    _tuned("+ gains tuned, links and friction in the feed-forward", "retuned"),
    _tuned("+ input shaping, integral action", "ei"),
    _tuned("+ optimal plan, observer, prediction (design model)", "preview"),
    _held("+ the arm's constants identified", *_TIMING, *_TURNING, *_RIPPLE, *_GIVING),
    _held("+ delay and current loop", *_TURNING, *_RIPPLE, *_GIVING),
    _held("+ friction over the turn, breakaway, stiffening", *_RIPPLE, *_GIVING),
    _held("+ torque ripple", *_GIVING),
    _held("+ how far the motor gives before it slips"),
    _held("+ what is known lasts from move to move", remembers=True),
    _tuned("+ plans for the task's own cost", "adaptive"),
    Step("arm, drive, part and state known (no controller)", PRIVILEGED, _privileged),
)
"""The chain."""
ASIDE = (
    Step("`adaptive` with nothing identified", "adaptive", lambda _: [identifying_nothing()]),
    Step(
        "a learned residual on `adaptive`, all seeds",
        "student",
        lambda _: [load_controller(folder) for folder in shipped_policies(method="student")],
    ),
)
"""Not of the chain: what identification is worth to the same law, and what learning adds to it."""
TWO_LINKS = (
    _tuned("equations of two masses, as above", "adaptive"),
    ASIDE[1],
    Step(
        "equations of two links in filter and plan",
        "adaptive",
        lambda _: [AdaptiveController(tuned("adaptive", AdaptiveGains), model="lagrangian")],
    ),
    Step("the same, and arm, drive, part and state known", PRIVILEGED, partial(_privileged, model="lagrangian")),
)
"""On arms of two links, the comparison's `structural`: what the right equations are worth."""


def measure(options: Options) -> dict[str, Any]:
    """Averages of every step's metrics, of those of arms of two links, and of the optimum's cost."""
    rows, made = _rows((*CHAIN, *ASIDE), options)
    two_links, _ = _rows(TWO_LINKS, options, model="lagrangian")
    first = range(min(options.optima, options.arms))
    calls = {str(k): partial(shift_optimum, *(made[name].arm(k) for name in GUESSES)) for k in first}
    shifts = calls_side_by_side("optima", calls, options.jobs).values()
    optimum = {"arms": len(first), **_averages(np.array([[best.cost for best in shift] for shift in shifts]))}
    about = {"arms": options.arms, "moves": options.moves, "first_seed": LOOPS.first}
    return about | {"rows": rows, "two_links": two_links, "optimum": optimum}


def _rows(
    steps: Sequence[Step], options: Options, **settings: Any
) -> tuple[list[dict[str, Any]], dict[str, Recording]]:
    """Averages of each step over the moves of the arms, and by controller the last run in the chain."""
    rows, moved, made = list[dict[str, Any]](), None, dict[str, Recording]()
    task = {"seed": LOOPS.first, "randomization": "train", "moves": options.moves, **settings}
    for step in progress_over("steps", steps):
        sensors = "full" if step.controller == PRIVILEGED else "encoder"
        runs = [rollout(controller, options.arms, sensors=sensors, **task) for controller in step.make(moved)]
        moved, cost = moved or runs[0], np.stack([run.cost for run in runs])
        if step in CHAIN:
            made[step.controller] = runs[0]
        metrics = [run.metrics() for run in runs]
        still = np.concatenate([row["still_s"] for row in metrics])
        rows.append(
            {
                "title": step.title,
                "controller": step.controller,
                "chain": step in CHAIN,
                "cost": average("cost", cost.ravel()),
                "first": average("cost", cost[:, : options.arms].ravel()),
                "later": average("cost", cost[:, options.arms :].ravel()) if options.moves > 1 else None,
                **{name: average(name, np.concatenate([row[name] for row in metrics])) for name in SHOWN},
                "still": {"median": np.median(still), "late": np.percentile(still, 95)},
                "mean": cost.mean(),
                "worst": worst_mean(cost),
                "first_arms": _averages(cost.reshape(-1, options.arms)[:, : options.optima]),
                "left": np.mean([np.sum(~run.stayed) for run in runs]),
            }
        )
    return rows, made


def _averages(cost: Floats) -> dict[str, float]:
    """Interquartile mean and mean of costs."""
    return {"cost": average("cost", cost.ravel()), "mean": cost.mean()}


def tables(data: dict[str, Any]) -> dict[str, Any]:
    """Metrics of the table, and by name the methods beside the optimum: each as its last step of the chain has it."""
    aside, chain = ({row["controller"]: row for row in data["rows"] if row["chain"] == of} for of in (False, True))
    return {"shown": SHOWN, "methods": aside | chain}


def pictures(data: dict[str, Any]) -> Pictures:
    """The waterfall of the cost."""
    return {"waterfall.png": lambda: _waterfall([row for row in data["rows"] if row["chain"]])}


def _waterfall(rows: list[dict[str, Any]]) -> Figure:
    """Draw what each step takes off the cost, or adds."""
    levels = [row["cost"] for row in rows]
    figure, axis = plt.subplots(figsize=(9, 4.6), layout="constrained")
    for k, level in enumerate(levels):
        before = levels[k - 1] if k else 0.0
        oracle = k == len(levels) - 1
        colour = "0.6" if oracle else BLUE if k == 0 else GREEN if level < before else VERMILION
        low, high = (0.0, level) if k == 0 or oracle else sorted((before, level))
        axis.barh(k, high - low, left=low, color=colour, height=0.62)
        axis.text(high + 15, k, f"{level:.0f}", va="center", fontsize=10)
        if k and not oracle:
            axis.plot([before, before], [k - 0.69, k - 0.31], color="0.5", lw=0.8)
    name_rows(axis, [row["title"] for row in rows])
    axis.set_xlim(0, 1.1 * max(levels))
    axis.set_xlabel(f"{heading('cost')}, interquartile mean")
    return figure
