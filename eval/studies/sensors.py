"""What an accelerometer on the arm's end brings the best controllers and a student.

Each runs with and without it on the same scenarios of the development set.
"""

from dataclasses import dataclass
from typing import Any, Literal

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from agents.policy.bundle import ACCELEROMETER_POLICIES, POLICIES, load_controller, read_spec
from agents.residual.controller import ResidualMemory
from baselines.registry import CONTROLLERS, WITH_ACCELEROMETER
from baselines.tools.progress import progress_over
from beltarm_env.arrays import Floats
from beltarm_env.metrics import TORQUE_QUALITY
from beltarm_env.rollout import Controller, rollout
from eval.comparison.methods import chosen
from eval.comparison.rollouts import Recorder
from eval.comparison.sets import development_set
from eval.comparison.splits import Split, main_split
from eval.comparison.statistics import average, paired
from eval.report.style import BLUE, GREEN, ORANGE, below, name_rows
from eval.studies._frame import DevelopmentOptions as Options
from eval.studies._frame import Pictures

QUICK = {"episodes": 4, "splits": ("randomized",)}
Tier = Literal["encoder", "accelerometer"]
TIERS: tuple[Tier, Tier] = ("encoder", "accelerometer")
STUDENT = "student"
NAMES = (*WITH_ACCELEROMETER, STUDENT)
"""Controllers of the study."""
COMPARED = ("cost", "tip_rms_mm", "residual_pp_mm")
"""Metrics that are compared scenario by scenario."""
_COLOURS = dict(zip(NAMES, (BLUE, ORANGE, GREEN), strict=True))


@dataclass(frozen=True)
class Outcome:
    """Result of one controller with one set of sensors on one split."""

    metrics: dict[str, Floats]  # each of shape (episodes,), averaged over the moves
    left: int  # arms that left the workspace
    torsion: float  # RMS error of the estimated torsion, over all samples and arms [rad]


def measure(options: Options) -> dict[str, Any]:
    """Metrics of every controller on every split, with and without the accelerometer."""
    scenarios = development_set()
    splits = chosen("split", options.splits, scenarios.splits)
    rows, differences = [], []
    for name, split in progress_over("controllers and splits", [(name, split) for name in NAMES for split in splits]):
        pair = [outcome(name, tier, scenarios.splits[split], options.episodes) for tier in TIERS]
        for tier, result in zip(TIERS, pair, strict=True):
            levels = {metric: average(metric, values) for metric, values in result.metrics.items()}
            about = {"left": result.left, "torsion": result.torsion}
            rows.append({"controller": name, "split": split, "sensors": tier, **about, **levels})
        before, after = (result.metrics for result in pair)
        change = {metric: paired(after[metric][None], before[metric][None]).difference for metric in COMPARED}
        differences.append({"controller": name, "split": split, **change})
    specs = {tier: read_spec(student_folder(tier))[0] for tier in TIERS}
    return {
        "note": scenarios.label.note,
        "splits": splits,
        "episodes": options.episodes,
        "students": {
            tier: {"sensors": spec.sensors, "base": spec.base, "seed": spec.provenance["config"]["seed"]}
            for tier, spec in specs.items()
        },
        "rows": rows,
        "differences": differences,
    }


def student_folder(tier: Tier) -> Any:
    """Folder of the student's policy that has a set of sensors."""
    return (POLICIES if tier == "encoder" else ACCELEROMETER_POLICIES) / STUDENT / "seed0"


def controller(name: str, tier: Tier) -> Controller:
    """Make a classical controller with its tuned gains, the same for both sets of sensors, or the student of a set."""
    if name == STUDENT:
        return load_controller(student_folder(tier))
    return (CONTROLLERS if tier == "encoder" else WITH_ACCELEROMETER)[name]()


def outcome(name: str, tier: Tier, split: Split, episodes: int) -> Outcome:
    """Run one controller on the first scenarios of a split."""
    recorder = Recorder(controller(name, tier), _torsion)
    run = rollout(recorder, episodes, sensors=tier, **split.arguments(slice(episodes)))
    metrics = run.metrics()
    errors = np.array(recorder.notes[1:]) - run.in_turn(run.state[:, :, 2])[:-1]
    averages = {metric: run.over_moves(metrics[metric]) for metric in (*COMPARED, *TORQUE_QUALITY)}
    return Outcome(averages, int((~run.stayed).sum()), float(np.sqrt(np.mean(errors[:, run.stayed] ** 2))))


def _torsion(memory: Any) -> Floats:
    """Estimate of the torsion in a controller's memory [rad], shape (n,)."""
    base: Any = memory.informed if isinstance(memory, ResidualMemory) else memory
    return base.belief.state[:, 2] if hasattr(base, "belief") else base.rows[:, 2]


def tables(data: dict[str, Any]) -> dict[str, Any]:
    """Rows by controller, split and sensors, and names of controllers, sensors and metrics."""
    names = {"controllers": NAMES, "tiers": TIERS, "compared": COMPARED, "torques": TORQUE_QUALITY}
    return {"rows": _rows(data), "main": main_split(data["splits"]), **names}


def _rows(data: dict[str, Any]) -> dict[tuple[str, str, str], dict[str, Any]]:
    return {(row["controller"], row["split"], row["sensors"]): row for row in data["rows"]}


def pictures(data: dict[str, Any]) -> Pictures:
    """Cost on every split."""
    return {"cost.png": lambda: _draw(data)}


def _draw(data: dict[str, Any]) -> Figure:
    """Draw the cost on every split: without the accelerometer a ring, with it a disc."""
    splits, levels = data["splits"], _rows(data)
    figure, axis = plt.subplots(figsize=(8.5, 0.8 * len(splits) + 1.9), layout="constrained")
    for k, (name, colour) in enumerate(_COLOURS.items()):
        heights = np.arange(len(splits)) + 0.26 * (k - 1)
        before, after = ([levels[name, split, tier]["cost"] for split in splits] for tier in TIERS)
        axis.hlines(heights, before, after, color=colour, lw=2.2, alpha=0.45, zorder=1)
        axis.plot(before, heights, "o", mfc="white", mec=colour, ms=7, label=f"{name}, encoder")
        axis.plot(after, heights, "o", color=colour, ms=7, label=f"{name}, with the accelerometer")
        for place, height, cost in zip(np.minimum(before, after), heights, after, strict=True):
            beside = {"xytext": (-8, 0), "textcoords": "offset points", "ha": "right", "va": "center"}
            axis.annotate(f"{cost:.0f}", (place, height), **beside)
    name_rows(axis, splits)
    axis.set_xlim(left=0)
    axis.set_xlabel("cost, interquartile mean")
    below(figure, axis, len(NAMES), fontsize=9)
    return figure
