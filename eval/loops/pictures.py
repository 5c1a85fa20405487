"""Pictures: margins over the angle, poles, and the effect of each change."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from baselines.loops.condition import MarginCondition
from baselines.models.linear import ANGLES
from beltarm_env.arrays import Floats
from eval.loops.changes import CHANGES
from eval.loops.scan import Scan
from eval.loops.study import LoopStudy
from eval.loops.tables import ratio_text
from eval.report.style import BLUE, VERMILION, save_figures

_DEGREES = np.degrees(ANGLES)
_WIDTH = 9.0  # [in], so that the smallest letters are legible where a page is 800 pixels wide
_ASKED = MarginCondition()
_COLUMNS = (
    (("gain_up", "gain_down"), "gain (dB)", (-45.0, 45.0), (6.0, -6.0)),
    (("phase",), "phase (°)", (0.0, 115.0), (30.0,)),
    (("delay",), "delay (samples)", (0.5, 200.0), (_ASKED.delay,)),
    (("modulus",), "modulus", (0.0, 1.05), (_ASKED.modulus,)),
)
"""Margins, title, limits of the axis, and what is usually asked for, drawn as lines."""


def save_pictures(study: LoopStudy, folder: Path) -> list[Path]:
    """Draw all pictures into `folder`."""
    figures = {
        "margins.png": lambda: _margins(study.scans),
        "poles.png": lambda: _poles(study.scans),
        "breaks.png": lambda: _breaks(study),
    }
    return save_figures(figures, folder, dpi=110, pil_kwargs={"optimize": True})


def _margins(scans: dict[str, Scan]) -> Figure:
    """One row for each controller, one column for each margin, axes shared down the columns."""
    figure, axes = plt.subplots(
        len(scans), len(_COLUMNS), figsize=(_WIDTH, 0.95 * len(scans) + 0.9), sharex=True, sharey="col", squeeze=False
    )
    for row, (name, scan) in zip(axes, scans.items(), strict=True):
        for axis, (columns, _, _, asked) in zip(row, _COLUMNS, strict=True):
            for column in columns:
                axis.plot(_DEGREES, _shown(column, scan.over_arms(column)), color=VERMILION, lw=1.6)
                axis.plot(_DEGREES, _shown(column, getattr(scan.margins, column)[0]), color=BLUE, lw=1.8)
            _mark(axis, asked)
        row[0].set_ylabel(name, rotation=0, ha="right", va="center", labelpad=8, fontsize=11)
    for axis, (_, title, limits, _) in zip(axes[0], _COLUMNS, strict=True):
        axis.set_title(title, fontsize=11)
        axis.set(ylim=limits, xlim=(0, 90), xticks=(0, 30, 60, 90))
    for axis in axes[-1]:
        axis.set_xlabel("joint angle (°)", fontsize=10)
    axes[0, 0].set_yticks((-30, 0, 30))
    axes[0, 2].set_yscale("log")
    axes[0, 2].set_yticks((1, 10, 100))
    axes[0, 2].yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes[0, 3].set_yticks((0, 0.5, 1))
    figure.tight_layout(h_pad=0.3, w_pad=0.8)
    return figure


def _shown(column: str, values: Floats) -> Floats:
    """Margins as drawn: gains in dB, NaN, which is not drawn, where there is no margin."""
    if not column.startswith("gain"):
        return values
    finite = np.where(np.isfinite(values) & (values > 0), values, np.nan)
    return 20 * np.log10(finite)


def _mark(axis: Axes, asked: tuple[float, ...]) -> None:
    for least in asked:
        axis.axhline(least, color="0.55", lw=0.9, ls="--", zorder=1)
    axis.grid(color="0.92", lw=0.6)
    axis.tick_params(labelsize=9.5)


def _poles(scans: dict[str, Scan]) -> Figure:
    """Closed-loop poles in the upper half plane, coloured by the angle of the arm."""
    columns = 4
    rows = -(-len(scans) // columns)
    figure, axes = plt.subplots(
        rows, columns, figsize=(_WIDTH, 2.3 * rows), layout="constrained", sharex=True, sharey=True, squeeze=False
    )
    shown = None
    for axis, (name, scan) in zip(axes.flat, scans.items(), strict=False):
        for degrees, poles in zip(_DEGREES, scan.poles, strict=True):
            upper = poles[poles.imag > -1e-6]
            colour = np.full(len(upper), degrees)
            shown = axis.scatter(upper.real, upper.imag, c=colour, vmin=0, vmax=90, cmap="viridis", s=7, zorder=3)
        for ratio in (0.1, 0.3):
            axis.plot([0, -100 * ratio], [0, 100 * np.sqrt(1 - ratio**2)], color="0.75", lw=0.8, ls="--", zorder=1)
        axis.axvline(0, color="0.4", lw=0.9)
        axis.set(xlim=(-62, 4), ylim=(-2, 72))
        axis.set_title(name, fontsize=11)
        axis.tick_params(labelsize=9.5)
        axis.grid(color="0.94", lw=0.6)
    for axis in list(axes.flat)[len(scans) :]:
        axis.set_visible(False)
    figure.supxlabel("real part (1/s)", fontsize=11)
    figure.supylabel("imaginary part (1/s)", fontsize=11)
    if shown is not None:
        figure.colorbar(shown, ax=axes, label="joint angle (°)", shrink=0.6, ticks=(0, 30, 60, 90))
    return figure


def _breaks(study: LoopStudy) -> Figure:
    """Cost ratios as a map, a row for each change, numbers in the cells."""
    names = list(study.costs)
    ratios = np.array([[found.of_mean for found in study.costs[name].changes] for name in names]).T
    figure, axis = plt.subplots(figsize=(_WIDTH, 0.36 * len(CHANGES) + 1.4), layout="constrained")
    norm = TwoSlopeNorm(vmin=-1, vcenter=0, vmax=np.log2(10))
    axis.imshow(np.log2(ratios), norm=norm, cmap="RdBu_r", aspect="auto")
    for j, name in enumerate(names):
        for i, found in enumerate(study.costs[name].changes):
            dark = not -0.75 < np.log2(found.of_mean) < 2.2
            text = ratio_text(found.of_mean) + ("*" if found.failures else "")
            axis.text(j, i, text, ha="center", va="center", fontsize=9, color="white" if dark else "black")
    axis.set_yticks(range(len(CHANGES)), [change.title for change in CHANGES], fontsize=9.5)
    axis.set_xticks(range(len(names)), names, fontsize=9.5, rotation=40, ha="left", rotation_mode="anchor")
    axis.xaxis.tick_top()
    axis.tick_params(length=0)
    return figure
