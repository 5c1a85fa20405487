"""What each step from the paper's controller to the best classical one brings.

Every controller of the chain has one thing more than the one before; all make the same moves with the same arms of the
training ranges.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from baselines import CONTROLLERS
from baselines.tools.progress import progress_over
from beltarm_env.metrics import TORQUE_QUALITY, heading
from beltarm_env.rollout import rollout
from beltarm_env.task.seeds import LOOPS
from eval.comparison.methods import PRIVILEGED
from eval.comparison.statistics import average, worst_mean
from eval.report.style import BLUE, GREEN, VERMILION, name_rows
from eval.studies._arms import believing, identifying_nothing, privileged
from eval.studies._frame import Bounds, Pictures, StudyOptions

SHOWN = ("cost", "tip_rms_mm", "residual_pp_mm", *TORQUE_QUALITY)
"""Metrics of the table."""
QUICK = {"arms": 4}

_TIMING = ("delay", "lag")
_TURNING = ("variation", "excess", "stiffening")
_RIPPLE = ("ripple",)


@dataclass(frozen=True)
class Options(StudyOptions):
    """Options of the study."""

    bounds = Bounds(arms=(4, 10_000))

    arms: int = 256
    """Number of arms, 4 to 10000."""


class Step(NamedTuple):
    """A controller, and what it has that the one before has not."""

    title: str
    controller: str
    make: Callable[[int], Any]  # its controller, for a number of arms


def _tuned(title: str, name: str) -> Step:
    return Step(title, name, lambda _: CONTROLLERS[name]())


def _held(title: str, *held: str) -> Step:
    return Step(title, "adaptive", lambda _: believing(*held))


CHAIN = (
    _tuned("1991: computed torque, PD, torsion feedback", "paper"),
    _tuned("+ gains tuned, links and friction in the feed-forward", "retuned"),
    _tuned("+ input shaping, integral action", "ei"),
    _tuned("+ optimal plan, observer, prediction (design model)", "preview"),
    _held("+ the arm's constants identified", *_TIMING, *_TURNING, *_RIPPLE),
    _held("+ delay and current loop", *_TURNING, *_RIPPLE),
    _held("+ friction over the turn, breakaway, stiffening", *_RIPPLE),
    _held("+ torque ripple"),
    _tuned("+ first plan for the task's own cost", "adaptive"),
    Step("arm, drive and state known (no controller)", PRIVILEGED, lambda arms: privileged(arms, LOOPS.first)),
)
"""The chain."""
ASIDE = Step("`adaptive` with nothing identified", "adaptive", lambda _: identifying_nothing())
"""Not of the chain: what identification is worth to the same law."""


def measure(options: Options) -> dict[str, Any]:
    """Averages of every step's metrics over the arms."""
    rows = []
    for step in progress_over("steps", (*CHAIN, ASIDE)):
        sensors = "full" if step.controller == PRIVILEGED else "encoder"
        run = rollout(step.make(options.arms), options.arms, seed=LOOPS.first, randomization="train", sensors=sensors)
        metrics = run.metrics()
        rows.append(
            {
                "title": step.title,
                "controller": step.controller,
                "chain": step is not ASIDE,
                **{name: average(name, metrics[name]) for name in SHOWN},
                "mean": run.cost.mean(),
                "worst": worst_mean(run.cost),
                "left": np.sum(~run.finished),
            }
        )
    return {"arms": options.arms, "first_seed": LOOPS.first, "rows": rows}


def tables(data: dict[str, Any]) -> dict[str, Any]:
    """Metrics of the table, without the cost."""
    return {"shown": SHOWN[1:]}


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
