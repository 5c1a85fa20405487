"""Pictures of the page, from the data alone: margins over the angle, poles, and the effect of each change."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from baselines.models.linear import ANGLES
from beltarm_env.arrays import Floats
from eval.report.style import BLUE, VERMILION
from eval.studies._frame import Pictures
from eval.studies.loops.tables import ratio_text

_DEGREES = np.degrees(ANGLES)
_WIDTH = 9.0  # [in], so that the smallest letters are legible where a page is 800 pixels wide
_COLUMNS = (
    (("gain_up", "gain_down"), "gain (dB)", (-45.0, 45.0)),
    (("phase",), "phase (°)", (0.0, 115.0)),
    (("delay",), "delay (samples)", (0.5, 200.0)),
    (("modulus",), "modulus", (0.0, 1.05)),
)
"""Margins, title and limits of the axis."""


def pictures(data: dict[str, Any]) -> Pictures:
    """All pictures, by the name of their file."""
    scans = {name: row["loop"] for name, row in data["controllers"].items() if "loop" in row}
    return {
        "margins.png": lambda: _margins(scans, data["asked"]),
        "poles.png": lambda: _poles(scans),
        "breaks.png": lambda: _breaks(data),
    }


def _margins(scans: dict[str, Any], asked: dict[str, float]) -> Figure:
    """One row for each controller, one column for each margin, axes shared down the columns."""
    lines = ((6.0, -6.0), (30.0,), (asked["delay"],), (asked["modulus"],))
    figure, axes = plt.subplots(
        len(scans), len(_COLUMNS), figsize=(_WIDTH, 0.95 * len(scans) + 0.9), sharex=True, sharey="col", squeeze=False
    )
    for row, (name, scan) in zip(axes, scans.items(), strict=True):
        for axis, (columns, _, _), levels in zip(row, _COLUMNS, lines, strict=True):
            for column in columns:
                axis.plot(_DEGREES, _shown(column, scan["over_arms"][column]), color=VERMILION, lw=1.6)
                axis.plot(_DEGREES, _shown(column, scan["design"][column]), color=BLUE, lw=1.8)
            _mark(axis, levels)
        row[0].set_ylabel(name, rotation=0, ha="right", va="center", labelpad=8, fontsize=11)
    for axis, (_, title, limits) in zip(axes[0], _COLUMNS, strict=True):
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


def _shown(column: str, known: list[float | None]) -> Floats:
    """Margins as drawn: gains in dB, NaN, which is not drawn, where there is no margin."""
    values = np.array(known, dtype=np.float64)
    if not column.startswith("gain"):
        return values
    finite = np.where(np.isfinite(values) & (values > 0), values, np.nan)
    return 20 * np.log10(finite)


def _mark(axis: Axes, levels: tuple[float, ...]) -> None:
    for least in levels:
        axis.axhline(least, color="0.55", lw=0.9, ls="--", zorder=1)
    axis.grid(color="0.92", lw=0.6)
    axis.tick_params(labelsize=9.5)


def _poles(scans: dict[str, Any]) -> Figure:
    """Closed-loop poles in the upper half plane, coloured by the angle of the arm."""
    columns = 4
    rows = -(-len(scans) // columns)
    figure, axes = plt.subplots(
        rows, columns, figsize=(_WIDTH, 2.3 * rows), layout="constrained", sharex=True, sharey=True, squeeze=False
    )
    shown = None
    for axis, (name, scan) in zip(axes.flat, scans.items(), strict=False):
        for degrees, poles in zip(_DEGREES, scan["poles"], strict=True):
            real, imaginary = np.array(poles).reshape(-1, 2).T
            colour = np.full(len(real), degrees)
            shown = axis.scatter(real, imaginary, c=colour, vmin=0, vmax=90, cmap="viridis", s=7, zorder=3)
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


def _breaks(data: dict[str, Any]) -> Figure:
    """Cost ratios as a map, a row for each change, numbers in the cells."""
    names, titles = list(data["controllers"]), data["changes"]
    effects = [row["changes"] for row in data["controllers"].values()]
    ratios = np.array([[effect["mean"] for effect in row] for row in effects]).T
    figure, axis = plt.subplots(figsize=(_WIDTH, 0.36 * len(titles) + 1.4), layout="constrained")
    norm = TwoSlopeNorm(vmin=-1, vcenter=0, vmax=np.log2(10))
    axis.imshow(np.log2(ratios), norm=norm, cmap="RdBu_r", aspect="auto")
    for j, row in enumerate(effects):
        for i, effect in enumerate(row):
            dark = not -0.75 < np.log2(effect["mean"]) < 2.2
            text = ratio_text(effect["mean"]) + ("*" if effect["left"] else "")
            axis.text(j, i, text, ha="center", va="center", fontsize=9, color="white" if dark else "black")
    axis.set_yticks(range(len(titles)), titles, fontsize=9.5)
    axis.set_xticks(range(len(names)), names, fontsize=9.5, rotation=40, ha="left", rotation_mode="anchor")
    axis.xaxis.tick_top()
    axis.tick_params(length=0)
    return figure
