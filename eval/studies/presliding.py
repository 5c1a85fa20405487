"""Whether presliding changes the order of controllers.

In the plant, a stuck motor does not move at all, and breaks away at once. With LuGre friction it has bristles with the
same steady friction, which give way by a deflection before the motor breaks away. Everything else is the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from gymnasium.vector import AutoresetMode
from matplotlib.figure import Figure

from baselines.yardsticks.oracle import Replay
from beltarm_env import BeltArmVectorEnv
from beltarm_env.arm import COLUMN
from beltarm_env.arrays import Floats
from beltarm_env.metrics import METRICS
from beltarm_env.rollout import Controller, Recording, record
from beltarm_env.task.seeds import PRESLIDING
from eval.comparison.methods import chosen
from eval.comparison.rollouts import shipped_controller, side_by_side
from eval.comparison.statistics import LEAST_SCENARIOS, estimate, interquartile_mean, paired
from eval.reference.lugre import STEPS, LuGreArms
from eval.report.style import COLOURS, mark_one_two_five
from eval.studies._frame import Bounds, Pictures, StudyOptions

QUICK = {"controllers": ("paper", "student"), "deflections": (1.0,), "arms": 4, "jobs": 1}
QUICK |= {"check_deflections": (3.0,), "checked": 1}
CONTROLLERS = ("paper", "ei", "preview", "adaptive", "ppo", "student")
"""Shipped controllers; of a learned one the policy of its first training seed."""
CHECKED = ("paper", "ei")
"""Controllers of the check that the located friction is the limit of a stiff bristle: they do not amplify rounding."""
JUDGED = ("cost", "residual_pp_mm")
PERTURBATION = 1e-5
"""Change of the initial torsion, about half an encoder count at the joint, which shows the effect of chance [rad]."""
LOCATED, PERTURBED = "located", "located, perturbed"
"""Friction that the plant locates as events, without and with the perturbation."""
_SHOWN = ("better", "worse")  # verdicts


@dataclass(frozen=True)
class Options(StudyOptions):
    """Options of the study."""

    bounds = Bounds(arms=(4, PRESLIDING.size), checked=(1, PRESLIDING.size), jobs=(1, 256))

    controllers: tuple[str, ...] = ()
    """Controllers to run. Default: all of the study."""
    deflections: tuple[float, ...] = (0.3, 1.0, 3.0, 10.0)
    """Breakaway deflections at the motor [mrad]; over the gear ratio at the joint."""
    arms: int = 48
    """Arms of the training ranges, 4 to 1000."""
    check_deflections: tuple[float, ...] = (3.0, 1.0, 0.3, 0.1, 0.03)
    """Deflections of the check that a stiff bristle behaves like the plant's own friction [mrad]."""
    checked: int = 8
    """Arms of the check, 1 to 1000."""
    jobs: int | None = None
    """Number of processes. Default: one per core."""


def measure(options: Options) -> dict[str, Any]:
    """Estimates for every controller and friction, pairs of controllers that change, and the check of the bristles.

    Raises:
        ValueError: If a deflection is not positive.
    """
    wrong = [value for value in (*options.deflections, *options.check_deflections) if not value > 0]
    if wrong:
        raise ValueError(f"--deflections and --check-deflections must be positive, got {wrong[0]:g}")
    names = chosen("controller", options.controllers, CONTROLLERS)
    frictions: dict[str, float | None] = {LOCATED: None, PERTURBED: None}
    frictions |= {friction_name(value): value for value in options.deflections}
    checks = [(value, options.checked) for value in options.check_deflections]
    stiff = side_by_side("checks", check, checks, options.jobs)
    cases = {
        (name, friction): (name, deflection, PERTURBATION if friction == PERTURBED else 0.0, options.arms)
        for name in names
        for friction, deflection in frictions.items()
    }
    runs = side_by_side("controllers and frictions", metrics_of, list(cases.values()), options.jobs)
    results = {pair: runs[case] for pair, case in cases.items()}
    rows = []
    for (name, friction), metrics in results.items():
        located = results[name, LOCATED]
        row = {"controller": name, "friction": friction, "left": int(metrics["left"].sum())}
        for metric in JUDGED:
            change = paired(metrics[metric][None], located[metric][None]).difference
            unit = 0.01 * interquartile_mean(located[metric])
            row[metric] = asdict(estimate(metrics[metric][None])) | {"mean": metrics[metric].mean()}
            row[f"{metric}_change"] = {key: value / unit for key, value in asdict(change).items()}
        rows.append(row)
    pairs = []
    for metric in JUDGED:
        values = {key: metrics[metric][None] for key, metrics in results.items()}
        before = verdicts(values, names, LOCATED)
        for friction in list(frictions)[1:]:
            after = verdicts(values, names, friction)
            changed = [pair for pair in after if after[pair] != before[pair]]
            turned = [pair for pair in changed if after[pair] in _SHOWN and before[pair] in _SHOWN]
            one_sided = [pair for pair in changed if pair not in turned]
            pairs.append({"metric": metric, "friction": friction, "reversed": turned, "one_sided": one_sided})
    return {
        "arms": options.arms,
        "checked": options.checked,
        "first_seed": PRESLIDING.first,
        "steps": STEPS,
        "perturbation": PERTURBATION,
        "controllers": names,
        "frictions": list(frictions),
        "rows": rows,
        "pairs": pairs,
        "checks": [{"friction": friction_name(value), **result} for (value, _), result in stiff.items()],
    }


def friction_name(deflection: float) -> str:
    """Name of LuGre friction with a breakaway deflection at the motor [mrad]."""
    return f"{deflection:g} mrad"


def verdicts(
    values: Mapping[tuple[str, str], Floats], names: Sequence[str], friction: str
) -> dict[tuple[str, str], str]:
    """Verdict by pair of controllers whether the first has less than the second, arm by arm (`Paired.verdict`)."""
    return {
        (first, second): paired(values[first, friction], values[second, friction]).verdict
        for first, second in combinations(names, 2)
    }


def run(controller: Controller, arms: int, deflection: float | None, perturbation: float = 0.0) -> Recording:
    """Run a controller on arms of the training ranges.

    Args:
        controller: What to run.
        arms: Number of arms.
        deflection: Deflection at which the motor breaks away [mrad]; None for the friction of the kernels.
        perturbation: Added to the torsion at the beginning [rad].
    """
    env = BeltArmVectorEnv(arms, randomization="train", autoreset_mode=AutoresetMode.DISABLED)
    if deflection is not None:
        env._batch.engine = LuGreArms(env._batch, 1e-3 * deflection)
    options = None
    if perturbation:
        env.reset(seed=PRESLIDING.first)
        options = {"state": env.state + np.array([0.0, 0.0, perturbation, 0.0])}
    return record(controller, env, seed=PRESLIDING.first, options=options)


def metrics_of(name: str, deflection: float | None, perturbation: float, arms: int) -> dict[str, Floats]:
    """Judged metrics of a controller, and whether an arm `left` the workspace, each of shape (arms,)."""
    recording = run(shipped_controller(name), arms, deflection, perturbation)
    metrics = recording.metrics()
    return {metric: metrics[metric] for metric in JUDGED} | {"left": np.where(recording.finished, 0.0, 1.0)}


def check(deflection: float, arms: int) -> dict[str, Any]:
    """Compare LuGre friction with the located one.

    Returns:
        `tip`: Largest distance of the tips under the same torques, of the median arm [m].
        `costs`: By controller, the mean absolute difference of the costs in closed loop, over the mean cost.
    """
    costs, tip = {}, 0.0
    for name in CHECKED:
        located, bristles = (run(shipped_controller(name), arms, value) for value in (None, deflection))
        costs[name] = float(np.mean(np.abs(bristles.cost - located.cost)) / np.mean(located.cost))
        replay = Replay((located.torque / located.params[:, COLUMN.torque_limit]).T.astype(np.float32))
        apart = run(replay, arms, deflection).tip_error - run(replay, arms, None).tip_error
        tip = max(tip, float(np.median(np.linalg.norm(apart, axis=2).max(axis=0))))
    return {"tip": tip, "costs": costs}


def _rows(data: dict[str, Any]) -> dict[tuple[str, str], dict[str, Any]]:
    return {(row["controller"], row["friction"]): row for row in data["rows"]}


def tables(data: dict[str, Any]) -> dict[str, Any]:
    """Rows by controller and friction, order of the controllers, and the facts of the answer."""
    names, frictions, rows = data["controllers"], data["frictions"], _rows(data)
    bristles = frictions[2:]
    steady = [name for name in names if not any(rows[name, friction]["left"] for friction in frictions)]
    others = [name for name in names if name not in steady]

    def changes(group: Sequence[str], friction: str, metric: str = "cost") -> list[tuple[str, float]]:
        """Controllers with their changes, the largest first."""
        found = [(name, rows[name, friction][f"{metric}_change"]["iqm"]) for name in group]
        return sorted(found, key=lambda entry: -abs(entry[1]))

    def largest(friction: str, metric: str) -> list[tuple[str, float]]:
        return [*changes(steady, friction, metric)[:1], *changes(others, friction, metric)[:1]]

    def ranking(metric: str, friction: str) -> list[str]:
        return sorted(names, key=lambda name: rows[name, friction][metric]["iqm"])

    judged = [pair for pair in data["pairs"] if pair["friction"] in bristles]
    return {
        "perturbed": PERTURBED,
        "decides": data["arms"] >= LEAST_SCENARIOS,
        "steady": steady,
        "comparisons": len(judged) * len(names) * (len(names) - 1) // 2,
        "reversals": sum(len(pair["reversed"]) for pair in judged),
        "where": list(dict.fromkeys(pair["friction"] for pair in judged if pair["reversed"])),
        "largest": max((change for each in bristles for _, change in changes(steady, each)), key=abs, default=0.0),
        "pairs": [pair | {"largest": largest(pair["friction"], pair["metric"])} for pair in data["pairs"]],
        "titles": {metric: METRICS[metric].title for metric in JUDGED},
        "rows": rows,
        "ranking": ranking,
    }


def pictures(data: dict[str, Any]) -> Pictures:
    """Cost over the deflection."""
    return {"cost.png": lambda: _draw(data)}


def _draw(data: dict[str, Any]) -> Figure:
    """Draw the cost over the deflection, the located friction at its left end."""
    figure, axes = plt.subplots(figsize=(7, 4.2), layout="constrained")
    shown = [friction for friction in data["frictions"] if friction != PERTURBED]
    places, rows = range(len(shown)), _rows(data)
    for name, colour in zip(data["controllers"], COLOURS, strict=False):
        costs = [rows[name, friction]["cost"] for friction in shown]
        low, high = ([cost[key] for cost in costs] for key in ("low", "high"))
        axes.fill_between(places, low, high, color=colour, alpha=0.12, linewidth=0)
        axes.plot(places, [cost["iqm"] for cost in costs], "o-", color=colour, ms=4, label=name)
    axes.set_xticks(places, shown)
    axes.set_yscale("log")
    mark_one_two_five(axes.yaxis)
    axes.set_xlabel("friction: located, or breakaway deflection of LuGre friction at the motor")
    axes.set_ylabel("cost, interquartile mean")
    axes.grid(alpha=0.3, which="both")
    figure.legend(loc="outside right upper", frameon=False)
    return figure
