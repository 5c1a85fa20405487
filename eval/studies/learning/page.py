"""Scores and pictures of the ablations, from the data alone."""

from __future__ import annotations

import shlex
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eval.report.curves import Curve, curves_figure
from eval.report.style import COLOURS, mark_one_two_five
from eval.studies._drawing import panels
from eval.studies._frame import Pictures
from eval.studies.learning.runs import DEFAULT, FACTORS

Data = dict[str, Any]

COLUMNS = {
    "cost_mean": ("cost, mean", 0),
    "cost_median": ("cost, median", 0),
    "tip_rms_mm_mean": ("tip RMS (mm)", 2),
    "residual_pp_mm_mean": ("residual p-p (mm)", 2),
    "torque_reversals_hz_mean": ("reversals (1/s)", 1),
    "left_percent": ("left (%)", 1),
}
"""Title and decimals of the scores that are shown."""
_TOP = 5  # of the picture, over the base's cost; what is above has lost arms


def tables(data: Data) -> Data:
    """Variants by factor, columns of the scores, and what the sentences need."""
    runs = [run for variant in data["variants"] for run in variant["runs"]]
    first = data["variants"][0]["runs"]
    return {
        "factors": {FACTORS[name].question: (name, variants) for name, variants in by_factor(data).items()},
        "columns": COLUMNS,
        "scores": _scores,
        "label": _label,
        "words": _words,
        "seeds": len(first),
        "base": first[0]["base"],
        "common": first[0]["command"].rsplit(" --seed ", 1)[0],
        "minutes": sum(run["minutes"] for run in runs),
        "commits": sorted({run["commit"] for run in runs}),
        "unknown_code": sum(run["digest"] is None for run in runs),
    }


def by_factor(data: Data) -> dict[str, list[Data]]:
    """Variants by factor; the first of each is the run that its variants are compared with."""
    by_name = {variant["name"]: variant for variant in data["variants"]}
    grouped = {factor: [v for v in data["variants"] if v["factor"] == factor] for factor in FACTORS}
    return {factor: [by_name[FACTORS[factor].against], *group] for factor, group in grouped.items() if group}


def _label(variant: Data, factor: str) -> str:
    default = factor and variant["name"] == FACTORS[factor].against
    return f"{FACTORS[factor].default} (default)" if default else variant["label"]


def _scores(variant: Data, name: str) -> Data:
    """Mean of the runs' score, and the least and the largest of several runs."""
    values = np.array([run["scores"][name] for run in variant["runs"]])
    return {"mean": values.mean(), "ends": [values.min(), values.max()] if len(values) > 1 else []}


def _words(variant: Data) -> str:
    """What the command of a variant has that the default's has not."""
    script = [] if variant["script"] == DEFAULT.script else [f"train/{variant['script']}.py"]
    return shlex.join([*script, *variant["options"]])


def pictures(data: Data) -> Pictures:
    """Curves of the ablations and of the shipped policies."""

    def shipped() -> Figure:
        arrays = ("steps", "minutes", "cost")
        curves = [Curve(**(row | {name: np.array(row[name]) for name in arrays})) for row in data["shipped"]]
        return curves_figure(curves, data["shipped_levels"])

    return {"ablations.png": lambda: _ablations(data), "shipped.png": shipped}


def _ablations(data: Data) -> Figure:
    """Draw the curves of every factor, on common axes."""
    factors = by_factor(data) or {"": data["variants"][:1]}
    figure, axes = panels(len(factors), 4, (3.6, 3.3), sharey=True)
    best, default = data["best_classical"], data["variants"][0]["runs"][0]
    levels = {default["base"]: default["validation_of_base"], best["name"]: best["validated"]}
    lowest = min(point[2] for variant in data["variants"] for run in variant["runs"] for point in run["curve"])
    for axis, (factor, variants) in zip(axes, factors.items(), strict=True):
        _panel(axis, levels, factor, variants)
        bottom, top = 0.7 * min(lowest, best["validated"]), _TOP * default["validation_of_base"]
        axis.set(yscale="log", xlim=(0, None), ylim=(bottom, top))
        mark_one_two_five(axis.yaxis)
    figure.supxlabel("simulated samples (millions)", fontsize=10)
    figure.supylabel("mean episode cost, validation arms", fontsize=10)
    return figure


def _panel(axis: Axes, levels: dict[str, float], factor: str, variants: list[Data]) -> None:
    sides = ("center",) if len(levels) == 1 else ("bottom", "top")
    for (name, level), dashes, side in zip(levels.items(), ("--", ":"), sides, strict=False):
        axis.axhline(level, color="0.45", lw=1, ls=dashes, zorder=1)
        end = axis.get_yaxis_transform()
        axis.text(1.01, level, name, transform=end, color="0.35", va=side, ha="left", fontsize=7)
    for variant, colour in zip(variants, ("0.2", *COLOURS), strict=False):
        curves = [np.array(run["curve"]) for run in variant["runs"]]
        for curve in curves:
            axis.plot(curve[:, 0] / 1e6, curve[:, 2], color=colour, lw=0.6, alpha=0.6)
        shortest = min(len(curve) for curve in curves)
        middle = np.exp(np.mean([np.log(curve[:shortest, 2]) for curve in curves], axis=0))
        axis.plot(curves[0][:shortest, 0] / 1e6, middle, color=colour, lw=1.8, label=_label(variant, factor))
    axis.set_title(FACTORS[factor].question if factor else "", fontsize=9, loc="left")
    axis.legend(fontsize=7, frameon=False, handlelength=1.2, loc="upper left", bbox_to_anchor=(0, -0.08), ncols=2)
    axis.grid(alpha=0.3, which="both")
    axis.tick_params(labelsize=8)
