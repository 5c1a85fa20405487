"""What a guard between controller and motor is worth while something breaks, and what it costs while nothing does.

Learned and classical controllers run with and without the guard, on arms with injected faults and on the development
set.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from agents.residual.controller import ResidualController, behind_guard
from baselines.guard.guard import LEARNED_LEVEL, PASSIVE_LEVEL
from baselines.guard.settings import GuardSettings
from beltarm_env.arrays import Flags, Floats
from beltarm_env.rollout import Controller, record, rollout
from beltarm_env.task.seeds import FAULTS as SEEDS
from eval.comparison.methods import chosen
from eval.comparison.rollouts import Recorder, shipped_controller, shipped_methods, side_by_side
from eval.comparison.sets import development_set
from eval.comparison.splits import EPISODES
from eval.report.style import BLUE, GREEN, VERMILION, below, mark_one_two_five, name_rows, panels
from eval.studies._frame import Bounds, OptionsWithJobs, Pictures
from eval.studies.guard.faults import EARLIEST, FAULTS, LATEST, BrokenPolicy, FaultyArms

QUICK = {
    "controllers": ("ppo",),
    "faults": ("stuck encoder", "NaN weights"),
    "splits": ("nominal",),
    "arms": 2,
    "episodes": 4,
    "jobs": 1,
}
CONTROLLERS = ("student", "ppo", "adaptive", "preview", "mpc")
"""Controllers of the study; of a learned one the policy of its first training seed."""
NAN = "NaN weights"
"""The fault that classical controllers cannot have."""


@dataclass(frozen=True)
class Options(OptionsWithJobs):
    """Options of the study."""

    bounds = OptionsWithJobs.bounds | Bounds(arms=(1, SEEDS.size), episodes=(4, EPISODES))

    controllers: tuple[str, ...] = ()
    """Controllers to run. Default: all of the study."""
    faults: tuple[str, ...] = ()
    """Faults to inject. Default: all."""
    splits: tuple[str, ...] = ()
    """Splits on which nothing breaks. Default: all."""
    arms: int = 60
    """Arms on which something breaks, 1 to 10000."""
    episodes: int = 40
    """Scenarios per split, 4 to 200."""


def measure(options: Options) -> dict[str, Any]:
    """Outcomes of every controller under every fault, and its costs on the splits."""
    scenarios = development_set()
    controllers = chosen("controller", options.controllers, CONTROLLERS)
    bases = {method.name: method.base or method.name for method in shipped_methods(controllers)}
    faults = chosen("fault", options.faults, FAULTS)
    splits = chosen("split", options.splits, scenarios.splits)
    pairs = [(name, fault) for name in controllers for fault in faults if fault != NAN or bases[name] != name]
    kinds = {
        (name, fault): {
            "base": (bases[name], fault, False, options.arms),
            "without": (name, fault, False, options.arms),
            "guarded": (name, fault, True, options.arms),
        }
        for name, fault in pairs
    }
    cases = list(dict.fromkeys(case for of_pair in kinds.values() for case in of_pair.values()))
    outcomes = side_by_side("faults", outcome, cases, options.jobs)
    places = [(name, split, options.episodes) for name in controllers for split in splits]
    healthy = side_by_side("splits where nothing breaks", health, places, options.jobs)
    return {
        "note": scenarios.label.note,
        "arms": options.arms,
        "episodes": options.episodes,
        "settings": GuardSettings(),
        "onset": (EARLIEST, LATEST),
        "faults": {fault: FAULTS[fault] for fault in faults},
        "bases": bases,
        "rows": [
            {"controller": name, "fault": fault, **{kind: outcomes[case] for kind, case in of_pair.items()}}
            for (name, fault), of_pair in kinds.items()
        ],
        "healthy": [{"controller": name, "split": split, **result} for (name, split, _), result in healthy.items()],
    }


def with_guard(controller: Controller) -> Recorder[tuple[Flags, Floats]]:
    """Put the guard behind a controller of the study, and note which commands it changed, and its levels."""
    return Recorder(behind_guard(controller), lambda memory: (memory.changed, memory.level))


def outcome(name: str, fault: str, guard: bool, arms: int) -> dict[str, float]:
    """Run a controller, with or without the guard, on the first arms of the study's seeds while something breaks.

    Returns:
        Means over the arms: `peak`, the largest distance of the tip from its reference [mm]; `left`, the share of arms
        that left the workspace [%]; `energy`, the integral of the squared torque [10^-3 N^2 m^2 s]; `passive`, the
        share of arms that the guard left without torque [%].
    """
    env, controller = FaultyArms(arms, fault, randomization="train"), shipped_controller(name)
    if fault == NAN and isinstance(controller, ResidualController):
        controller.policy = BrokenPolicy(controller.policy, env)
    recorder = with_guard(controller) if guard else None
    run = record(recorder or controller, env, seed=SEEDS.first)
    levels = np.array([level for _, level in recorder.notes]) if recorder else np.zeros((1, arms))
    return {
        "peak": float(np.mean(1000 * np.linalg.norm(run.tip_error, axis=2).max(axis=0))),
        "left": float(100 * np.mean(~run.finished)),
        "energy": float(1000 * np.mean(env.energies())),
        "passive": float(100 * np.mean((levels == PASSIVE_LEVEL).any(axis=0))),
    }


def health(name: str, split: str, episodes: int) -> dict[str, float]:
    """Run a controller with and without the guard on the first scenarios of a split.

    Returns:
        Mean costs `before` and `after` the guard is added; shares of commands that the guard `changed`, of `arms` with
        such a command, and of arms on which it has `fallen` back.
    """
    arguments = development_set().splits[split].arguments(slice(episodes))
    before = rollout(shipped_controller(name), episodes, **arguments)
    recorder = with_guard(shipped_controller(name))
    after = rollout(recorder, episodes, **arguments)
    changed, levels = map(np.array, zip(*recorder.notes, strict=True))
    return {
        "before": float(np.mean(before.cost)),
        "after": float(np.mean(after.cost)),
        "changed": float(np.mean(changed)),
        "arms": float(np.mean(changed.any(axis=0))),
        "fallen": float(np.mean((levels > LEARNED_LEVEL).any(axis=0))),
    }


MEASURES = {"peak": "peak tip error (mm)", "left": "left (%)", "energy": "torque energy (10⁻³ N²m²s)"}
"""Headings of an outcome's measures."""
MARGIN = 1.1
"""Largest ratio of the guarded controller to its base alone that counts as no worse."""
_DIGITS = {"peak": 1, "left": 0, "energy": 1}


def tables(data: dict[str, Any]) -> dict[str, Any]:
    """Measures, and the comparisons in which the base alone is better."""
    return {
        "worse": [(row, measure) for row in data["rows"] for measure in worse_measures(row)],
        "titles": MEASURES,
        "digits": _DIGITS,
        "margin": round(100 * (MARGIN - 1)),
        "learned": _learned(data),
    }


def worse_measures(row: dict[str, Any]) -> list[str]:
    """Measures by which the guarded controller is worse than its base alone, beyond the margin."""
    return [name for name in MEASURES if row["guarded"][name] > MARGIN * row["base"][name] + 1e-9]


def _learned(data: dict[str, Any]) -> list[str]:
    return [name for name, base in data["bases"].items() if name != base]


def pictures(data: dict[str, Any]) -> Pictures:
    """Peak tip error under every fault."""
    return {"peak.png": lambda: _draw(data)}


def _draw(data: dict[str, Any]) -> Figure:
    """Draw a panel for each learned method; for each controller if there is none."""
    names = _learned(data) or list(data["bases"])
    figure, axes = panels(len(names), len(names), (11 / len(names), 4.2), sharex=True, sharey=True)
    kinds = {
        "base": ("base alone", BLUE, "s"),
        "without": ("without the guard", VERMILION, "o"),
        "guarded": ("with the guard", GREEN, "D"),
    }
    for axis, name in zip(axes, names, strict=True):
        rows = [row for row in data["rows"] if row["controller"] == name]
        name_rows(axis, [row["fault"] for row in rows])
        for k, (kind, (label, colour, marker)) in enumerate(kinds.items()):
            heights = [place + 0.22 * (k - 1) for place in range(len(rows))]
            axis.plot([row[kind]["peak"] for row in rows], heights, marker, color=colour, ms=6, label=label)
        axis.set_title(f"{name} on {data['bases'][name]}", fontsize=10)
        axis.set_xscale("log")
        mark_one_two_five(axis.xaxis)
        axis.set_xlabel("peak tip error, mean (mm)")
    below(figure, axes[0], len(kinds))
    return figure
