"""Pictures: margins over the angle, poles, and the effect of each change."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from baselines.models.linear import ANGLES
from eval.loops.costs import CHANGES, PRIVILEGED
from eval.loops.scan import Scan
from eval.loops.study import LoopStudy
from eval.style.colours import BLUE, VERMILION
from eval.style.figures import save_figures

_DEGREES = np.degrees(ANGLES)
_COLUMNS = (
    ("gain_up", "gain margins (dB)", (-45.0, 45.0), 6.0),
    ("phase", "phase margin (°)", (0.0, 115.0), 30.0),
    ("delay", "delay margin (samples)", (0.15, 200.0), 1.0),
    ("modulus", "modulus margin", (0.0, 1.05), 0.5),
)
"""Margin, title, limits of the axis, usual requirement, drawn as a line; for the delay one sample."""


def save_pictures(study: LoopStudy, folder: Path) -> list[Path]:
    """Draw all pictures into `folder`."""
    figures = {
        "margins.png": lambda: _margins(study.scans),
        "poles.png": lambda: _poles(study.scans),
        "breaks.png": lambda: _breaks(study),
    }
    return save_figures(figures, folder, dpi=110)


def _decibels(factors: np.ndarray) -> np.ndarray:
    """Gain margins [dB]; NaN, which is not drawn, where there is none."""
    finite = np.where(np.isfinite(factors) & (factors > 0), factors, np.nan)
    return 20 * np.log10(finite)


def _margins(scans: dict[str, Scan]) -> Figure:
    """One row for each controller, one column for each margin, axes shared down the columns."""
    figure, axes = plt.subplots(
        len(scans), len(_COLUMNS), figsize=(10.5, 1.15 * len(scans) + 0.8), sharex=True, sharey="col", squeeze=False
    )
    for row, (name, scan) in zip(axes, scans.items(), strict=True):
        for axis, (column, _, _, least) in zip(row, _COLUMNS, strict=True):
            _draw_margin(axis, scan, column, least)
        row[0].set_ylabel(name, rotation=0, ha="right", va="center", labelpad=8, fontsize=11)
    for axis, (_, title, limits, _) in zip(axes[0], _COLUMNS, strict=True):
        axis.set_title(title, fontsize=10.5)
        axis.set(ylim=limits, xlim=(0, 90), xticks=(0, 30, 60, 90))
    for axis in axes[-1]:
        axis.set_xlabel("joint angle (°)")
    for axis in axes[0]:
        axis.tick_params(labelsize=8.5)
    axes[0, 2].set_yscale("log")
    axes[0, 2].yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    figure.tight_layout(h_pad=0.4, w_pad=0.8)
    return figure


def _draw_margin(axis: Axes, scan: Scan, column: str, least: float) -> None:
    axis.axhline(least, color="0.6", lw=0.9, ls="--", zorder=1)
    axis.grid(color="0.92", lw=0.6)
    axis.tick_params(labelsize=8.5)
    if column == "gain_up":
        axis.axhline(-least, color="0.6", lw=0.9, ls="--", zorder=1)
        axis.plot(_DEGREES, _decibels(scan.margins.gain_up), color=BLUE, lw=1.8)
        axis.plot(_DEGREES, _decibels(scan.margins.gain_down), color=VERMILION, lw=1.8)
    else:
        axis.plot(_DEGREES, getattr(scan.margins, column), color=BLUE, lw=1.8)


def _poles(scans: dict[str, Scan]) -> Figure:
    """Closed-loop poles in the upper half plane, coloured by the angle of the arm."""
    columns = 4
    rows = -(-len(scans) // columns)
    figure, axes = plt.subplots(
        rows, columns, figsize=(10.5, 2.7 * rows), layout="constrained", sharex=True, sharey=True, squeeze=False
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
        axis.set_title(name, fontsize=10.5)
        axis.grid(color="0.94", lw=0.6)
    for axis in list(axes.flat)[len(scans) :]:
        axis.set_visible(False)
    figure.supxlabel("real part (1/s)", fontsize=10.5)
    figure.supylabel("imaginary part (1/s)", fontsize=10.5)
    if shown is not None:
        figure.colorbar(shown, ax=axes, label="joint angle (°)", shrink=0.6, ticks=(0, 30, 60, 90))
    return figure


def _breaks(study: LoopStudy) -> Figure:
    """Cost ratios as a map, numbers in the cells."""
    names = list(study.costs)
    ratios = np.array([[found.ratio for found in study.costs[name].breaks] for name in names])
    figure, axis = plt.subplots(figsize=(10.5, 0.42 * len(names) + 1.9), layout="constrained")
    norm = TwoSlopeNorm(vmin=-1, vcenter=0, vmax=np.log2(10))
    shown = axis.imshow(np.log2(ratios), norm=norm, cmap="RdBu_r", aspect="auto")
    for i, name in enumerate(names):
        for j, found in enumerate(study.costs[name].breaks):
            dark = np.log2(found.ratio) > 2.2 or np.log2(found.ratio) < -0.75
            text = f"{found.ratio:.2f}" if found.ratio < 9.95 else f"{found.ratio:.0f}"
            text += f"\nleft {found.failures}" if found.failures else ""
            axis.text(j, i, text, ha="center", va="center", fontsize=8, color="white" if dark else "black")
    # A number and its unit stay on one line.
    titles = [change.title.replace(" ", "\n", -1 if "×" in change.title else 1) for change in CHANGES]
    axis.set_xticks(range(len(CHANGES)), titles, fontsize=8.5)
    axis.set_yticks(range(len(names)), [f"{name}\n(not ranked)" if name == PRIVILEGED else name for name in names])
    axis.xaxis.tick_top()
    axis.tick_params(length=0)
    ticks = (0.5, 1, 2, 4, 10)
    bar = figure.colorbar(shown, ax=axis, ticks=np.log2(ticks), pad=0.01, extend="max")
    bar.ax.set_yticklabels([f"×{tick:g}" for tick in ticks])
    bar.set_label("cost over nominal")
    return figure
