"""Results of the ablations as Markdown, as data and as a picture."""

from __future__ import annotations

import json
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from baselines.tools.provenance import command_line, commit
from beltarm_env import __version__
from beltarm_env.task.seeds import ABLATIONS
from eval.learning.ablation_runs import described
from eval.learning.curves import BEST_CLASSICAL
from eval.learning.variants import DEFAULT, FACTORS, Variant
from eval.report.style import COLOURS, mark_one_two_five, save_figure
from eval.report.text import markdown_table

Floats = NDArray[np.float64]

COLUMNS = {
    "cost_mean": ("cost, mean", 0),
    "cost_median": ("cost, median", 0),
    "tip_rms_mm_mean": ("tip RMS (mm)", 2),
    "residual_pp_mm_mean": ("residual p-p (mm)", 2),
    "torque_reversals_hz_mean": ("reversals (1/s)", 1),
    "left_percent": ("left (%)", 1),
}
"""Title and decimals of the scores that are shown."""
_ACROSS = 4  # panels side by side
_TOP = 5  # of the picture, over the base's cost; what is above has lost arms
_DASHES = ("--", ":")


@dataclass(frozen=True)
class VariantResult:
    """Results of a variant's runs, a dictionary per training seed; see `AblationRun.finish`."""

    variant: Variant
    runs: list[dict[str, Any]]

    @property
    def base(self) -> str:
        """Base controller."""
        return self.runs[0]["base"]

    def score(self, name: str) -> Floats:
        """Score of each run."""
        return np.array([run["scores"][name] for run in self.runs])

    @property
    def minutes(self) -> float:
        """Mean wall-clock of a run [min]."""
        return float(np.mean([run["minutes"] for run in self.runs]))


@dataclass(frozen=True)
class AblationStudy:
    """Everything that is reported; the default run is the first result."""

    results: list[VariantResult]
    references: dict[str, dict[str, float]]  # scores of bases and of the best classical controller
    samples: int
    arms: int
    classical_validated: float  # cost of the best classical controller on the validation arms

    def factors(self) -> dict[str, list[VariantResult]]:
        """Results by factor; the first of each is the run that its variants are compared with."""
        by_name = {result.variant.name: result for result in self.results}
        grouped = {factor: [r for r in self.results if r.variant.factor == factor] for factor in FACTORS}
        return {factor: [by_name[FACTORS[factor].against], *group] for factor, group in grouped.items() if group}


def _label(result: VariantResult, factor: str) -> str:
    if result.variant.name == FACTORS[factor].against:
        return f"{FACTORS[factor].default} (default)"
    return result.variant.label


def as_json(study: AblationStudy) -> str:
    """Content of `ablations.json`."""
    content = {
        "provenance": {
            "command": command_line(),
            "commit": commit(),
            "version": __version__,
            "samples": study.samples,
            "scored_on": {"arms": study.arms, "first_seed": ABLATIONS.first, "randomization": "train"},
        },
        "references": study.references,
        "variants": [{**described(result.variant), "runs": result.runs} for result in study.results],
    }
    return json.dumps(content, indent=1) + "\n"


def markdown(study: AblationStudy, seconds: float) -> str:
    """Content of `ablations.md`."""
    seeds, default = len(study.results[0].runs), study.results[0].base
    best = "" if default == BEST_CLASSICAL else f"; dotted: `{BEST_CLASSICAL}`, the best controller that does not learn"
    common = study.results[0].runs[0]["command"].rsplit(" --seed ", 1)[0]
    parts = [
        "# What makes learning work: ablations",
        "Each row is the default run of `train/student.py`, or of `train/ppo.py`, with one thing changed, at a "
        f"shortened budget: {study.samples:,} simulated samples, {seeds} training seed{'s' if seeds > 1 else ''} "
        "(from 0), the learning "
        "rate falling to zero over them. (A row without ranges is one run, of seed 0. A base that leaves more to "
        "correct gets the whole torque limit for it.) "
        f"Scores are those of the *last* policy on {study.arms} arms of the training ranges with seeds from "
        f"{ABLATIONS.first}, which nothing else uses. Of several seeds the mean, with the lowest and the highest; "
        "differences within that range show nothing. *left* is the share of arms that left the workspace, which costs "
        "as much as a hundred good episodes: where it is not 0, look at the median. *vs default* is the ratio of mean "
        "costs. *Minutes* are the wall-clock of one run. What a student's teacher simulates to see what torques do, 20 "
        "steps for each sample, and what base and filter simulate while they act, is not counted.",
        "What it means is in [../learning.md](../learning.md). The common part of the commands is "
        f"`{common}`; every command in full, scores and curves are in [ablations.json](ablations.json).",
        "![curves](curves.png)",
        f"Cost on validation arms while learning: every run a thin line, a variant's geometric mean a thick one. "
        f"Dashed: the default's base, `{study.results[0].base}`{best}.",
    ]
    for factor, results in study.factors().items():
        parts += [f"## {FACTORS[factor].question}", _table(factor, results)]
    parts += ["## On the same arms, without learning", _references(study)]
    took = sum(result.minutes * len(result.runs) for result in study.results)
    parts += [f"`{command_line()}`, beltarm {__version__} ({commit()}), {seconds:.0f} s; the runs took {took:.0f} min."]
    return "\n\n".join(parts) + "\n"


def _table(factor: str, results: list[VariantResult]) -> str:
    default = float(results[0].score("cost_mean").mean())
    titles = ["", "changed", *(title for title, _ in COLUMNS.values()), "vs default", "minutes"]
    rows = []
    for result in results:
        cells = [_cell(result.score(name), decimals) for name, (_, decimals) in COLUMNS.items()]
        ratio = f"{float(result.score('cost_mean').mean()) / default:.2f}"
        rows.append([_label(result, factor), _changed(result.variant), *cells, ratio, f"{result.minutes:.1f}"])
    return markdown_table(titles, rows, "ll" + "r" * (len(titles) - 2))


def _changed(variant: Variant) -> str:
    words = [] if variant.script == DEFAULT.script else [f"train/{variant.script}.py"]
    return f"`{shlex.join([*words, *variant.options])}`" if words or variant.options else "–"


def _cell(values: Floats, decimals: int) -> str:
    shown = f"{values.mean():.{decimals}f}"
    return shown if len(values) == 1 else f"{shown} [{values.min():.{decimals}f}, {values.max():.{decimals}f}]"


def _references(study: AblationStudy) -> str:
    rows = []
    for name, scores in study.references.items():
        cells = [f"{scores[key]:.{decimals}f}" for key, (_, decimals) in COLUMNS.items()]
        rows.append([name if name != "none" else "no torque", *cells])
    return markdown_table(["controller", *(title for title, _ in COLUMNS.values())], rows)


def draw(study: AblationStudy, path: Path) -> None:
    """Draw the curves of every factor, on common axes, into a file."""
    factors = study.factors() or {"": [study.results[0]]}
    across = min(_ACROSS, len(factors))
    down = -(-len(factors) // across)
    size = (3.4 * across + 0.8, 3.1 * down + 0.5)
    figure, grid = plt.subplots(down, across, figsize=size, layout="constrained", sharey=True, squeeze=False)
    panels = list(grid.flat)
    for axis, (factor, results) in zip(panels, factors.items(), strict=False):
        _panel(axis, study, factor, results)
    for axis in panels[len(factors) :]:
        axis.set_visible(False)
    _scale(panels, study)
    figure.supxlabel("simulated samples (millions)", fontsize=10)
    figure.supylabel("mean episode cost, validation arms", fontsize=10)
    save_figure(figure, path)


def _panel(axis: Axes, study: AblationStudy, factor: str, results: list[VariantResult]) -> None:
    default = study.results[0]
    levels = {default.base: default.runs[0]["validation_of_base"], BEST_CLASSICAL: study.classical_validated}
    sides = ("center",) if len(levels) == 1 else ("bottom", "top")
    for (name, level), dashes, side in zip(levels.items(), _DASHES, sides, strict=False):
        axis.axhline(level, color="0.45", lw=1, ls=dashes, zorder=1)
        end = axis.get_yaxis_transform()
        axis.text(1.01, level, name, transform=end, color="0.35", va=side, ha="left", fontsize=7)
    for result, colour in zip(results, ("0.2", *COLOURS), strict=False):
        curves = [np.array(run["curve"]) for run in result.runs]
        for curve in curves:
            axis.plot(curve[:, 0] / 1e6, curve[:, 2], color=colour, lw=0.6, alpha=0.6)
        shortest = min(len(curve) for curve in curves)
        middle = np.exp(np.mean([np.log(curve[:shortest, 2]) for curve in curves], axis=0))
        name = _label(result, factor) if factor else result.variant.label
        axis.plot(curves[0][:shortest, 0] / 1e6, middle, color=colour, lw=1.8, label=name)
    axis.set_title(FACTORS[factor].question if factor else "", fontsize=9, loc="left")
    below = {"loc": "upper left", "bbox_to_anchor": (0, -0.08), "ncols": 2}
    axis.legend(fontsize=7, frameon=False, borderpad=0.3, handlelength=1.2, **below)
    axis.grid(alpha=0.3, which="both")
    axis.tick_params(labelsize=8)


def _scale(panels: list[Axes], study: AblationStudy) -> None:
    """Set common axes: from below the best to above the base."""
    lowest = min(point[2] for result in study.results for run in result.runs for point in run["curve"])
    base = study.results[0].runs[0]["validation_of_base"]
    for axis in panels:
        axis.set(yscale="log", xlim=(0, None), ylim=(0.7 * min(lowest, study.classical_validated), _TOP * base))
        mark_one_two_five(axis.yaxis)
