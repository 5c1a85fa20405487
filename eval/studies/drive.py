"""How every controller does as each effect of the drive grows.

Each effect is varied alone, then all together, from none to twice the upper end of its training range, on the same
arms with the same moves.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from beltarm_env.arm import params_columns
from beltarm_env.metrics import TORQUE_QUALITY
from beltarm_env.metrics import heading as metric_heading
from beltarm_env.rollout import rollout
from beltarm_env.task.moves import MOVE_FIELDS
from beltarm_env.task.seeds import DRIVE_SIZES
from eval.comparison.methods import chosen
from eval.comparison.rollouts import shipped_controller, shipped_methods, side_by_side
from eval.comparison.statistics import average, estimates
from eval.report.style import BLUE, GREEN, ORANGE, PINK, SKY, VERMILION, below, mark_one_two_five, panels
from eval.studies._arms import ALL, EFFECTS, IDEAL, drawn, heading, with_effect
from eval.studies._frame import Bounds, OptionsWithJobs, Pictures

QUICK = {"arms": 4, "controllers": ("paper", "student"), "effects": ("command_latency",), "jobs": 1}
SIZES = (0.25, 0.5, 1.0, 1.5, 2.0)
"""Sizes of an effect over the upper end of its training range, beside the ideal drive."""
_UPPER_END = 1.0
_SHOWN = ("tip_rms_mm", "residual_pp_mm", *TORQUE_QUALITY)  # beside the cost


@dataclass(frozen=True)
class Options(OptionsWithJobs):
    """Options of the study."""

    bounds = OptionsWithJobs.bounds | Bounds(arms=(4, 1000))

    controllers: tuple[str, ...] = ()
    """Controllers to measure. Default: all shipped ones."""
    effects: tuple[str, ...] = ()
    """Effects to vary beside all together, by the names of `ArmParams`. Default: each."""
    arms: int = 64
    """Number of arms, 4 to 1000."""


def measure(options: Options) -> dict[str, Any]:
    """Cost, vibration and torques of every controller, by effect and size."""
    methods = shipped_methods(options.controllers)
    effects = dict.fromkeys((*chosen("effect", options.effects, EFFECTS), ALL))
    cases = [(method.name, effect, options.arms) for effect in (IDEAL, *effects) for method in methods]
    results = side_by_side("controllers and effects", metrics_of, cases, options.jobs)
    rows = []
    for method in methods:
        ideal = results[method.name, IDEAL, options.arms]
        for effect in effects:
            real = results[method.name, effect, options.arms]
            joined = {name: np.concatenate([ideal[name], real[name]]) for name in ideal}
            rows.append({"controller": method.name, "effect": effect, **_summary(joined)})
    return {
        "arms": options.arms,
        "first_seed": DRIVE_SIZES.first,
        "sizes": (0.0, *SIZES),
        "effects": {
            name: {
                "heading": heading(name),
                "title": EFFECTS[name].title,
                "unit": f"{EFFECTS[name].sign}{EFFECTS[name].unit}",
                "end": float(EFFECTS[name].shown(name, _UPPER_END)),
            }
            for name in effects
        },
        "rows": rows,
    }


def metrics_of(name: str, effect: str, arms: int) -> dict[str, np.ndarray]:
    """Metrics of a controller on the same arms with all sizes of an effect, each of shape (sizes, arms)."""
    env = drawn(arms, DRIVE_SIZES.first)
    sizes = (0.0,) if effect == IDEAL else SIZES
    table = np.concatenate([with_effect(env.params_table, effect, size) for size in sizes])
    move = dict(zip(MOVE_FIELDS, np.tile(env.moves, (len(sizes), 1)).T, strict=True))
    options = {"params": params_columns(table), "move": move}
    run = rollout(shipped_controller(name), len(table), seed=DRIVE_SIZES.first, options=options)
    metrics = run.metrics()
    values = {shown: metrics[shown] for shown in ("cost", *_SHOWN)} | {"left": ~run.finished}
    return {shown: value.reshape(len(sizes), arms) for shown, value in values.items()}


def _summary(metrics: Mapping[str, np.ndarray]) -> dict[str, list[Any]]:
    """Estimates by size: of the cost with its interval and plain mean."""
    costs = estimates(metrics["cost"][:, None])
    return {
        "left": metrics["left"].sum(axis=1).tolist(),
        "cost": [cost.iqm for cost in costs],
        "low": [cost.low for cost in costs],
        "high": [cost.high for cost in costs],
        "mean": metrics["cost"].mean(axis=1).tolist(),
        **{name: [average(name, values) for values in metrics[name]] for name in _SHOWN},
    }


class _Levels:
    """Levels by controller and effect, with the effect at the upper end of its training range, or on an ideal drive."""

    def __init__(self, data: Mapping[str, Any]) -> None:
        self.rows = {(row["controller"], row["effect"]): row for row in data["rows"]}
        self.effects: dict[str, Any] = data["effects"]
        self.controllers = list(dict.fromkeys(row["controller"] for row in data["rows"]))
        self._upper_end = data["sizes"].index(_UPPER_END)

    def __call__(self, controller: str, effect: str, name: str = "cost") -> float:
        """A number of the data."""
        if effect == IDEAL:
            return self.rows[controller, next(iter(self.effects))][name][0]
        return self.rows[controller, effect][name][self._upper_end]

    def heading(self, effect: str) -> str:
        """Title of an effect at the upper end of its training range."""
        return effect if effect == IDEAL else self.effects[effect]["heading"]


def tables(data: dict[str, Any]) -> dict[str, Any]:
    """Levels at the upper ends of the training ranges, and what the sentences name."""
    levels = _Levels(data)
    names, columns = levels.controllers, (IDEAL, *levels.effects)
    lost = {
        name: levels(name, IDEAL, "left") + sum(sum(levels.rows[name, effect]["left"][1:]) for effect in levels.effects)
        for name in names
    }
    return {
        "levels": levels,
        "columns": columns,
        "cheapest": [min(names, key=lambda name: levels(name, effect)) for effect in columns],
        "torques": [(metric, effect) for metric in TORQUE_QUALITY for effect in (IDEAL, ALL)],
        "lost": {name: count for name, count in lost.items() if count},
        "runs": data["arms"] * (1 + len(levels.effects) * (len(data["sizes"]) - 1)),
    }


_FAMILIES: tuple[tuple[str, tuple[str, ...]], ...] = (
    (PINK, ("paper", "rigid", "retuned")),
    (SKY, ("zv", "zvd", "ei")),
    (GREEN, ("smooth", "disturbance", "flat", "adrc")),
    (BLUE, ("lqg", "robust", "preview", "mpc")),
    (VERMILION, ("adaptive",)),
    (ORANGE, ("ppo", "student")),
)
_LINES = (("-", "o"), ("--", "s"), (":", "^"), ("-.", "D"))  # within a family
_COLUMNS = 3


def pictures(data: dict[str, Any]) -> Pictures:
    """A picture for each metric, with a panel for each effect."""
    metrics = {"cost.png": "cost", "tip_rms.png": "tip_rms_mm", "residual.png": "residual_pp_mm"}
    return {file: lambda metric=metric: _draw(data, metric) for file, metric in metrics.items()}


def _draw(data: dict[str, Any], metric: str) -> Figure:
    """Draw a metric over the size of each effect; controllers of one family have one colour."""
    levels, sizes = _Levels(data), data["sizes"]
    known = {name: (colour, *line) for colour, family in _FAMILIES for name, line in zip(family, _LINES, strict=False)}
    figure, axes = panels(len(levels.effects), _COLUMNS, (3.7, 3.05), sharey=True)
    for axis, (name, effect) in zip(axes, levels.effects.items(), strict=True):
        axis.axvspan(_UPPER_END, 1.03 * sizes[-1], color="#F0F0F0", zorder=0, linewidth=0)
        for controller in levels.controllers:
            colour, line, marker = known.get(controller, ("0.5", "-", "o"))
            values = levels.rows[controller, name][metric]
            axis.plot(sizes, values, line, color=colour, marker=marker, markersize=4, lw=1.6, label=controller)
        axis.set_title(effect["title"], fontsize=11)
        ticks = np.linspace(0, sizes[-1], 5)
        axis.set_xticks(ticks, [f"{tick * effect['end']:.4g}" for tick in ticks])
        axis.set_xlim(-0.03 * sizes[-1], 1.03 * sizes[-1])
        axis.set_xlabel(effect["unit"], labelpad=1)
        axis.grid(color="0.9", lw=0.6)
    axes[0].set_yscale("log")
    mark_one_two_five(axes[0].yaxis)
    figure.supylabel(metric_heading(metric), fontsize=11)
    below(figure, axes[0], 6)
    return figure
