"""Whether presliding changes the order of controllers, and whether two models of it agree.

A motor that sticks may not move at all, or give before it slips: by the plant's own element, a spring that slips at a
deflection (`presliding_deflection`), or by LuGre friction, whose bristles slip little by little. Steady friction and
breakaway torque are the same.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations, product
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from matplotlib.figure import Figure

from baselines.yardsticks.clairvoyant import Replay
from beltarm_env import BeltArmVectorEnv
from beltarm_env.arm import COLUMN
from beltarm_env.arrays import Floats
from beltarm_env.metrics import METRICS
from beltarm_env.rollout import Controller, Recording, record
from beltarm_env.task.seeds import PRESLIDING
from eval.comparison.methods import PRIMARY, chosen
from eval.comparison.rollouts import shipped_controller, side_by_side
from eval.comparison.statistics import LEAST_SCENARIOS, estimate, interquartile_mean, paired
from eval.reference.lugre import STEPS, LuGreArms
from eval.report.style import COLOURS, mark_one_two_five, panels
from eval.studies._frame import Bounds, OptionsWithJobs, Pictures

QUICK = {"controllers": ("paper", "student"), "deflections": (3.0,), "arms": 4, "jobs": 1}
QUICK |= {"check_deflections": (3.0,), "checked": 1}
CONTROLLERS = ("paper", "ei", "preview", "adaptive", "ppo", "student")
"""Shipped controllers; of a learned one the policy of its first training seed."""
CHECKED = ("paper", "ei")
"""Controllers of the check that a motor which gives little behaves like one that does not: they amplify no rounding."""
JUDGED = ("cost", "residual_pp_mm")
MOTOR = "motor_pp_mrad"
"""Motion of the motor in the last 0.3 s of an episode, peak to peak [mrad]: what a limit cycle shows in."""
_LAST = 200  # samples of it
PERTURBATION = 1e-5
"""Change of the initial torsion, about half an encoder count at the joint, which shows the effect of chance [rad]."""
CLEAN, PERTURBED = "clean stick", "clean stick, perturbed"
"""A motor that does not move while it sticks, without and with the perturbation."""
ELEMENT, LUGRE = "element", "LuGre"
"""Models of a motor that gives: the plant's slip element, and bristles."""
_SHOWN = ("better", "worse")  # verdicts


@dataclass(frozen=True)
class Options(OptionsWithJobs):
    """Options of the study."""

    bounds = OptionsWithJobs.bounds | Bounds(arms=(4, PRESLIDING.size), checked=(1, PRESLIDING.size))

    controllers: tuple[str, ...] = ()
    """Controllers to run. Default: all of the study."""
    deflections: tuple[float, ...] = (1.0, 3.0, 10.0, 20.0)
    """Breakaway deflections at the motor [mrad]; over the gear ratio at the joint."""
    arms: int = 144
    """Arms of the training ranges, 4 to 1000."""
    check_deflections: tuple[float, ...] = (3.0, 1.0, 0.3, 0.1, 0.03)
    """Deflections of the check that a motor which gives little behaves like one that does not [mrad]."""
    checked: int = 8
    """Arms of the check, 1 to 1000."""


def measure(options: Options) -> dict[str, Any]:
    """Estimates for every controller and friction, pairs of controllers that change, and the check of both models.

    Raises:
        ValueError: If a deflection is not positive.
    """
    wrong = [value for value in (*options.deflections, *options.check_deflections) if not value > 0]
    if wrong:
        raise ValueError(f"--deflections and --check-deflections must be positive, got {wrong[0]:g}")
    names = chosen("controller", options.controllers, CONTROLLERS)
    frictions: dict[str, tuple[str, float]] = {CLEAN: (CLEAN, 0.0), PERTURBED: (CLEAN, 0.0)}
    models = [(model, value) for model in (ELEMENT, LUGRE) for value in options.deflections]
    frictions |= {friction_name(*each): each for each in models}
    checks = [(model, value, options.checked) for model in (ELEMENT, LUGRE) for value in options.check_deflections]
    stiff = side_by_side("checks", check, checks, options.jobs)
    cases = {
        (name, friction): (name, model, deflection, PERTURBATION if friction == PERTURBED else 0.0, options.arms)
        for name in names
        for friction, (model, deflection) in frictions.items()
    }
    runs = side_by_side("controllers and frictions", metrics_of, list(cases.values()), options.jobs)
    results = {pair: runs[case] for pair, case in cases.items()}
    rows = []
    for (name, friction), metrics in results.items():
        clean = results[name, CLEAN]
        row = {"controller": name, "friction": friction, "left": int(metrics["left"].sum())}
        row[MOTOR] = interquartile_mean(metrics[MOTOR])
        for metric in JUDGED:
            change = paired(metrics[metric][None], clean[metric][None]).difference
            unit = 0.01 * interquartile_mean(clean[metric])
            row[metric] = asdict(estimate(metrics[metric][None])) | {"mean": metrics[metric].mean()}
            row[f"{metric}_change"] = {key: value / unit for key, value in asdict(change).items()}
        rows.append(row)
    pairs = []
    for metric in JUDGED:
        values = {key: metrics[metric][None] for key, metrics in results.items()}
        found = {friction: verdicts(values, names, friction) for friction in frictions}
        compared = [(CLEAN, friction) for friction in list(frictions)[1:]]
        compared += [(friction_name(LUGRE, value), friction_name(ELEMENT, value)) for value in options.deflections]
        for other, friction in compared:
            before, after = found[other], found[friction]
            changed = [pair for pair in after if after[pair] != before[pair]]
            turned = [pair for pair in changed if after[pair] in _SHOWN and before[pair] in _SHOWN]
            one_sided = [pair for pair in changed if pair not in turned]
            both = {"metric": metric, "against": other, "friction": friction}
            pairs.append(both | {"reversed": turned, "one_sided": one_sided})
    asked = [each for each in product(JUDGED, frictions) if {*PRIMARY} <= {*names}]
    answers = [paired(*(results[name, friction][metric][None] for name in PRIMARY)) for metric, friction in asked]
    return {
        "primary": [
            {"metric": metric, "friction": friction, "verdict": answer.verdict, **asdict(answer.difference)}
            for (metric, friction), answer in zip(asked, answers, strict=True)
        ],
        "arms": options.arms,
        "checked": options.checked,
        "first_seed": PRESLIDING.first,
        "steps": STEPS,
        "perturbation": PERTURBATION,
        "controllers": names,
        "frictions": list(frictions),
        "rows": rows,
        "pairs": pairs,
        "checks": [{"friction": friction_name(model, value), **each} for (model, value, _), each in stiff.items()],
    }


def friction_name(model: str, deflection: float) -> str:
    """Name of the friction of a motor that gives by a deflection before it slips [mrad]."""
    return f"{model}, {deflection:g} mrad"


def verdicts(
    values: Mapping[tuple[str, str], Floats], names: Sequence[str], friction: str
) -> dict[tuple[str, str], str]:
    """Verdict by pair of controllers whether the first has less than the second, arm by arm (`Paired.verdict`)."""
    return {
        (first, second): paired(values[first, friction], values[second, friction]).verdict
        for first, second in combinations(names, 2)
    }


def run(
    controller: Controller, arms: int, model: str = CLEAN, deflection: float = 0.0, perturbation: float = 0.0
) -> Recording:
    """Run a controller on arms of the training ranges, whose friction has one of the models.

    `deflection` is that at which the motor breaks away, with its mean friction at the start [mrad]; `perturbation` is
    added to the torsion at the beginning [rad].
    """
    env = BeltArmVectorEnv(arms, randomization="train", autoreset_mode=AutoresetMode.DISABLED)
    if model == LUGRE:
        env._batch.engine = LuGreArms(env._batch, 1e-3 * deflection)
    options: dict[str, Any] = {}
    env.reset(seed=PRESLIDING.first)
    if model == ELEMENT:  # whose field is the deflection at tau_c, not at breakaway
        breakaway = 1 + env.params_table[:, COLUMN.static_friction_excess]
        options["params"] = {"presliding_deflection": 1e-3 * deflection / breakaway}
    if perturbation:
        options["state"] = env.state + np.array([0.0, 0.0, perturbation, 0.0])
    return record(controller, env, seed=PRESLIDING.first, options=options or None)


def metrics_of(name: str, model: str, deflection: float, perturbation: float, arms: int) -> dict[str, Floats]:
    """Judged metrics of a controller, MOTOR, and whether an arm `left` the workspace, each of shape (arms,)."""
    recording = run(shipped_controller(name), arms, model, deflection, perturbation)
    metrics, motor = recording.metrics(), np.ptp(recording.state[-_LAST:, :, 0], axis=0)
    left = np.where(recording.finished, 0.0, 1.0)
    return {metric: metrics[metric] for metric in JUDGED} | {MOTOR: 1e3 * motor, "left": left}


def check(model: str, deflection: float, arms: int) -> dict[str, Any]:
    """Compare a motor that gives with one that does not.

    `tip` is the largest distance of the tips under the same torques, of the median arm [m]; `costs` by controller the
    mean absolute difference of the costs in closed loop, over the mean cost.
    """
    costs, tip = {}, 0.0
    for name in CHECKED:
        clean, gives = run(shipped_controller(name), arms), run(shipped_controller(name), arms, model, deflection)
        costs[name] = float(np.mean(np.abs(gives.cost - clean.cost)) / np.mean(clean.cost))
        replay = Replay((clean.torque / clean.params[:, COLUMN.torque_limit]).T.astype(np.float32))
        apart = run(replay, arms, model, deflection).tip_error - clean.tip_error
        tip = max(tip, float(np.median(np.linalg.norm(apart, axis=2).max(axis=0))))
    return {"tip": tip, "costs": costs}


def _rows(data: dict[str, Any]) -> dict[tuple[str, str], dict[str, Any]]:
    return {(row["controller"], row["friction"]): row for row in data["rows"]}


def tables(data: dict[str, Any]) -> dict[str, Any]:
    """Rows by controller and friction, order of the controllers, and the facts of the answer."""
    names, frictions, rows = data["controllers"], data["frictions"], _rows(data)
    giving = frictions[2:]
    steady = [name for name in names if not any(rows[name, friction]["left"] for friction in frictions)]

    def ranking(metric: str, friction: str) -> list[str]:
        return sorted(names, key=lambda name: rows[name, friction][metric]["iqm"])

    judged = [pair for pair in data["pairs"] if pair["friction"] in giving and pair["against"] == CLEAN]
    both = [pair for pair in data["pairs"] if pair["against"] != CLEAN]
    per_pair = len(names) * (len(names) - 1) // 2
    return {
        "perturbed": PERTURBED,
        "decides": data["arms"] >= LEAST_SCENARIOS,
        "steady": steady,
        "comparisons": len(judged) * per_pair,
        "agreement": {
            "comparisons": len(both) * per_pair,
            "reversed": sum(len(pair["reversed"]) for pair in both),
            "one_sided": sum(len(pair["one_sided"]) for pair in both),
        },
        "motor": MOTOR,
        "reversals": sum(len(pair["reversed"]) for pair in judged),
        "where": list(dict.fromkeys(pair["friction"] for pair in judged if pair["reversed"])),
        "largest": max(
            (rows[name, each]["cost_change"]["iqm"] for each in giving for name in steady), key=abs, default=0
        ),
        "titles": {metric: METRICS[metric].title for metric in JUDGED},
        "rows": rows,
        "ranking": ranking,
    }


def pictures(data: dict[str, Any]) -> Pictures:
    """Cost over the deflection."""
    return {"cost.png": lambda: _draw(data)}


def _draw(data: dict[str, Any]) -> Figure:
    """Draw the cost over the deflection for both models, the motor that does not give at the left end."""
    titles, rows = {ELEMENT: "the plant's slip element", LUGRE: "LuGre friction"}, _rows(data)
    figure, axes = panels(len(titles), 2, (4.5, 4.2), sharey=True)
    for axis, (model, title) in zip(axes, titles.items(), strict=True):
        shown = [CLEAN, *(friction for friction in data["frictions"] if friction.startswith(model))]
        places = range(len(shown))
        for name, colour in zip(data["controllers"], COLOURS, strict=False):
            costs = [rows[name, friction]["cost"] for friction in shown]
            low, high = ([cost[key] for cost in costs] for key in ("low", "high"))
            axis.fill_between(places, low, high, color=colour, alpha=0.12, linewidth=0)
            axis.plot(places, [cost["iqm"] for cost in costs], "o-", color=colour, ms=4, label=name)
        axis.set_xticks(places, ["0", *(friction.split(", ")[1].removesuffix(" mrad") for friction in shown[1:])])
        axis.set_title(title, fontsize=10)
        axis.set_xlabel("deflection of the motor before it slips (mrad)")
        axis.grid(alpha=0.3, which="both")
    axes[0].set_yscale("log")
    mark_one_two_five(axes[0].yaxis)
    axes[0].set_ylabel("cost, interquartile mean")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right upper", frameon=False)
    return figure
