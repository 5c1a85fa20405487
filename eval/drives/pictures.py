"""Pictures: a panel for each effect of the drive, with a curve for each controller over the effect's size."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from beltarm_env.metrics import heading
from eval.comparison.statistics import interquartile_mean
from eval.drives.effects import EFFECTS
from eval.drives.study import UPPER_END, DriveStudy
from eval.report.style import BLUE, GREEN, ORANGE, PINK, SKY, VERMILION, mark_one_two_five, save_figures

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
_BEYOND = "#F0F0F0"
_METRICS = {"cost": "cost", "tip_rms": "tip_rms_mm", "residual": "residual_pp_mm"}
"""Of each picture."""


def save_pictures(study: DriveStudy, folder: Path) -> list[Path]:
    """Draw all pictures into `folder`."""
    figures = {f"{stem}.png": lambda name=name: _draw(study, name) for stem, name in _METRICS.items()}
    return save_figures(figures, folder, dpi=100, pil_kwargs={"optimize": True})


def styles(names: list[str]) -> dict[str, tuple[str, str, str]]:
    """Colour, line and marker of each controller: those of one family have one colour."""
    found = {name: (colour, *line) for colour, family in _FAMILIES for name, line in zip(family, _LINES, strict=False)}
    others = zip(("0.2", "0.4", "0.55", "0.7"), _LINES, strict=True)
    return {name: found.get(name) or next(((grey, *line) for grey, line in others), ("0.8", "-", "")) for name in names}


def _draw(study: DriveStudy, metric: str) -> Figure:
    rows = -(-(len(EFFECTS) + 1) // _COLUMNS)
    figure, grid = plt.subplots(rows, _COLUMNS, figsize=(11, 3.05 * rows), sharey=True)
    looks = styles(study.names)
    for axis, (effect, of_effect) in zip(grid.flat, EFFECTS.items(), strict=False):
        axis.axvspan(UPPER_END, 1.03 * study.sizes[-1], color=_BEYOND, zorder=0, linewidth=0)
        for name, (colour, line, marker) in looks.items():
            levels = [interquartile_mean(values) for values in study.found[name, effect].metrics[metric]]
            axis.plot(study.sizes, levels, line, color=colour, marker=marker, markersize=4, lw=1.6)
        axis.set_title(of_effect.title, fontsize=11)
        ticks = np.linspace(0, study.sizes[-1], 5)
        axis.set_xticks(ticks, [of_effect.shown(effect, tick) for tick in ticks])
        axis.set_xlim(-0.03 * study.sizes[-1], 1.03 * study.sizes[-1])
        axis.set_xlabel(f"{of_effect.sign}{of_effect.unit}", labelpad=1)
        axis.grid(color="0.9", lw=0.6)
    grid[0, 0].set_yscale("log")
    mark_one_two_five(grid[0, 0].yaxis)
    for row in grid:
        row[0].set_ylabel(heading(metric))
    free = list(grid.flat)[len(EFFECTS) :]
    for axis in free:
        axis.set_visible(False)
    figure.tight_layout(h_pad=1.0, w_pad=0.6)
    _legend(figure, free, looks)
    return figure


def _legend(figure: Figure, free: list[Axes], looks: dict[str, tuple[str, str, str]]) -> None:
    """Write the legend where no panels are."""
    boxes = [axis.get_position() for axis in free]
    middle = 0.5 * (min(box.x0 for box in boxes) + max(box.x1 for box in boxes))
    handles = [
        Line2D([], [], color=colour, ls=line, marker=marker, markersize=5, lw=1.8)
        for colour, line, marker in looks.values()
    ]
    figure.legend(
        handles,
        list(looks),
        loc="center",
        bbox_to_anchor=(middle, 0.5 * (boxes[0].y0 + boxes[0].y1)),
        ncols=2 if len(looks) > 5 else 1,
        frameon=False,
        fontsize=11,
        handlelength=3.2,
    )
