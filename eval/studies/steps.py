"""What each step from the paper's controller to the best classical one brings.

Every controller of the chain has one thing more than the one before; all make the same moves with the same arms of the
training ranges.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from baselines import CONTROLLERS
from baselines.gains import tuned
from baselines.optimal.adaptive import AdaptiveController, AdaptiveGains
from baselines.tools.progress import progress_over
from baselines.yardsticks.privileged import PrivilegedController
from beltarm_env import BeltArmVectorEnv
from beltarm_env.metrics import TORQUE_QUALITY, heading
from beltarm_env.rollout import Recording, rollout
from beltarm_env.task.seeds import LOOPS
from eval.comparison.statistics import average, worst_mean
from eval.report.style import BLUE, GREEN, VERMILION
from eval.report.text import markdown_table, rounded
from eval.studies._frame import Pictures, StudyOptions

SHOWN = ("cost", "tip_rms_mm", "residual_pp_mm", *TORQUE_QUALITY)
"""Metrics of the table."""
QUICK = {"arms": 4}

_ARM = ("swing", "stiffness", "motor_inertia", "friction", "inertia", "torque_constant")
_TIMING = ("delay", "lag")
_TURNING = ("variation", "excess", "stiffening")
_RIPPLE = ("ripple",)
_DRIFTS = ("drift", "friction_drift")
_UNEXPLAINED = 5e-3  # [N m], of a filter that identifies nothing: what one torque has to stand for then


@dataclass(frozen=True)
class Options(StudyOptions):
    """Options of the study."""

    bounds: ClassVar[Mapping[str, tuple[int, int | None]]] = {"arms": (4, 10_000)}

    arms: int = 256
    """Number of arms, 4 to 10000."""


@dataclass(frozen=True)
class Step:
    """A controller, and what it has that the one before has not."""

    title: str
    controller: str
    make: Callable[[], Any] | None  # None: the oracle, which is made for its arms


def _identifying(*held: str) -> Callable[[], Any]:
    """`adaptive`, which plans with squares, and believes some of its `Uncertainty` to be what the design model says."""

    def make() -> Any:
        gains = tuned("adaptive", AdaptiveGains)
        known: dict[str, float] = dict.fromkeys(held, 0.0)
        if set(_ARM) <= set(held):
            known |= {**dict.fromkeys(_DRIFTS, 0.0), "disturbance": max(_UNEXPLAINED, gains.unexplained_torque)}
        return AdaptiveController(gains, uncertainty=replace(gains.uncertainty(), **known), improvements=0)

    return make


CHAIN = (
    Step("1991: computed torque, PD, torsion feedback", "paper", CONTROLLERS["paper"]),
    Step("+ gains tuned, links and friction in the feed-forward", "retuned", CONTROLLERS["retuned"]),
    Step("+ input shaping, integral action", "ei", CONTROLLERS["ei"]),
    Step("+ optimal plan, observer, prediction (design model)", "preview", CONTROLLERS["preview"]),
    Step("+ the arm's constants identified", "adaptive", _identifying(*_TIMING, *_TURNING, *_RIPPLE)),
    Step("+ delay and current loop", "adaptive", _identifying(*_TURNING, *_RIPPLE)),
    Step("+ friction over the turn, breakaway, stiffening", "adaptive", _identifying(*_RIPPLE)),
    Step("+ torque ripple", "adaptive", _identifying()),
    Step("+ first plan for the task's own cost", "adaptive", CONTROLLERS["adaptive"]),
    Step("arm, drive and state known (no controller)", "privileged", None),
)
"""The chain."""
ASIDE = Step("`adaptive` with nothing identified", "adaptive", _identifying(*_ARM, *_TIMING, *_TURNING, *_RIPPLE))
"""Not of the chain: what identification is worth to the same law."""


def measure(options: Options) -> dict[str, Any]:
    """Averages of every step's metrics over the arms."""
    rows = []
    for step in progress_over("steps", (*CHAIN, ASIDE)):
        run = rollout_of(step, options.arms)
        metrics = run.metrics()
        cost = metrics["cost"]
        rows.append(
            {
                "title": step.title,
                "controller": step.controller,
                "chain": step is not ASIDE,
                **{name: average(name, metrics[name]) for name in SHOWN},
                "mean": np.mean(cost),
                "worst": worst_mean(cost),
                "left": np.sum(~run.finished),
            }
        )
    return {"arms": options.arms, "first_seed": LOOPS.first, "rows": rows}


def rollout_of(step: Step, arms: int) -> Recording:
    """Run the controller of a step on arms of the training ranges; the same ones, with the same moves, for all."""
    if step.make is not None:
        return rollout(step.make(), arms, seed=LOOPS.first, randomization="train")
    env = BeltArmVectorEnv(arms, randomization="train", sensors="full")
    env.reset(seed=LOOPS.first)
    oracle = PrivilegedController(list(env.params))
    return rollout(oracle, arms, seed=LOOPS.first, randomization="train", sensors="full")


def tables(data: dict[str, Any]) -> dict[str, Any]:
    """The table, a row for each step."""
    rows = []
    for row in data["rows"]:
        cost, *others = (rounded(name, row[name]) for name in SHOWN)
        tail = [f"{row['mean']:.0f}", f"{row['worst']:.0f}", str(row["left"])]
        rows.append([row["title"], f"`{row['controller']}`", cost, *tail, *others])
    head = ["step", "controller", "cost", "mean", "worst 5 %", "left", *map(heading, SHOWN[1:])]
    return {"table": markdown_table(head, rows, "ll" + "r" * (len(head) - 2))}


def pictures(data: dict[str, Any]) -> Pictures:
    """The waterfall of the cost."""
    return {"waterfall.png": lambda: _waterfall([row for row in data["rows"] if row["chain"]])}


def _waterfall(rows: list[dict[str, Any]]) -> Figure:
    """Draw what each step takes off the cost, or adds."""
    levels = [row["cost"] for row in rows]
    figure, axis = plt.subplots(figsize=(9, 4.6))
    for k, level in enumerate(levels):
        before = levels[k - 1] if k else 0.0
        oracle = k == len(levels) - 1
        colour = "0.6" if oracle else BLUE if k == 0 else GREEN if level < before else VERMILION
        low, high = (0.0, level) if k == 0 or oracle else sorted((before, level))
        axis.barh(k, high - low, left=low, color=colour, height=0.62)
        axis.text(high + 15, k, f"{level:.0f}", va="center", fontsize=10)
        if k and not oracle:
            axis.plot([before, before], [k - 0.69, k - 0.31], color="0.5", lw=0.8)
    axis.set_yticks(range(len(levels)), [row["title"] for row in rows], fontsize=9.5)
    axis.invert_yaxis()
    axis.set_xlim(0, 1.1 * max(levels))
    axis.set_xlabel("cost, interquartile mean")
    axis.grid(axis="x", color="0.9", lw=0.6)
    axis.set_axisbelow(True)
    axis.spines[["top", "right", "left"]].set_visible(False)
    figure.tight_layout()
    return figure
