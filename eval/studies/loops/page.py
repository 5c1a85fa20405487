"""What the page names, and its pictures, from the data alone."""

from __future__ import annotations

from itertools import product
from math import isfinite
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from baselines.models.linear import ANGLES
from beltarm_env.arrays import Floats
from beltarm_env.metrics import TORQUES
from eval.report.style import BLUE, VERMILION
from eval.studies._drawing import damping_lines, panels
from eval.studies._frame import Pictures, shown
from eval.studies.loops.costs import IDENTIFYING, SHOWN_METRICS, WORSE

Data = dict[str, Any]
_MARGINS = {"gain_up": "gain up", "gain_down": "gain down", "phase": "phase (°)", "delay": "delay (samples)"}
_MARGINS |= {"modulus": "modulus"}
"""Title of each margin."""
_DIGITS = {"phase": 0, "delay": 1, "modulus": 2}
_PANELS = (
    (("gain_up", "gain_down"), "gain (dB)", (-45.0, 45.0), (-30, 0, 30), (6.0, -6.0)),
    (("phase",), "phase (°)", (0.0, 115.0), (0, 50, 100), (30.0,)),
    (("delay",), "delay (samples)", (0.5, 200.0), (1, 10, 100), ()),
    (("modulus",), "modulus", (0.0, 1.05), (0, 0.5, 1), ()),
)
"""Margins, title, limits and marks of the axis, and levels beside those that are asked for."""


def tables(data: Data) -> Data:
    """Controllers as the template names them, texts of margins and ratios, and names for its sentences."""
    rows = data["controllers"]
    ranked = {name: row for name, row in rows.items() if name != data["oracle"]}
    searches = {name: entry["tuning"] for name, entry in data["gains"].items() if entry["tuning"]}
    return {
        "labelled": {f"*{name}* (not ranked)" if name == data["oracle"] else name: row for name, row in rows.items()},
        "ranked": ranked,
        "titles": _MARGINS,
        "margin": margin_text,
        "ratio": ratio_text,
        "shown": SHOWN_METRICS,
        "torques": TORQUES,
        "gap": _gap(data["optimum"], rows),
        "unpriced": [name for name in searches if not ranked[name]["price"]],
        "priced": {name: row["price"] for name, row in ranked.items() if row["price"]},
        "kept": [name for name, search in searches.items() if search["cost"] == search["cost_untuned"]],
        "identifying": IDENTIFYING,
        "worse": WORSE,
    }


def margin_text(name: str, value: float | None) -> str:
    """A margin as text; a dash where there is none."""
    if name in _DIGITS:
        return shown(value, _DIGITS[name])
    return f"×{value:.3g}" if value and isfinite(value) else "–"


def ratio_text(value: float, left: int = 0) -> str:
    """A ratio of costs, and how many arms left the workspace, if any."""
    return (f"{value:.2f}" if value < 9.95 else f"{value:.0f}") + (f" ({left} left)" if left else "")


def _gap(optimum: Data, rows: Data) -> Data:
    """Costs of the clairvoyant optimum, in the mean of each kind and one by one, and costs of controllers over them."""
    kinds = np.array([name.split(":")[0] for name in optimum["names"]])
    groups = {kind: kinds == kind for kind in dict.fromkeys(kinds.tolist())}

    def costs(each: list[float]) -> Floats:
        return np.array([*(np.array(each)[group].mean() for group in groups.values()), *each])

    least = costs(optimum["costs"])
    ratios = [costs(row["optimum"]) / least for row in rows.values()]
    return {"kinds": list(groups), "least": least, "ratios": ratios}


def pictures(data: Data) -> Pictures:
    """All pictures, by the name of their file; small letters are legible where a page is 800 pixels wide."""
    scans = {name: row["loop"] for name, row in data["controllers"].items() if "loop" in row}
    return {"margins.png": lambda: _margins(scans, data["asked"]), "poles.png": lambda: _poles(scans)}


def _margins(scans: Data, asked: dict[str, float]) -> Figure:
    """One row for each controller, one column for each margin, axes shared down the columns."""
    figure, axes = panels(len(scans) * len(_PANELS), len(_PANELS), (2.25, 0.95), sharex=True, sharey="col")
    for axis, ((name, scan), (margins, title, limits, marks, levels)) in zip(
        axes, product(scans.items(), _PANELS), strict=True
    ):
        for margin in margins:
            axis.plot(np.degrees(ANGLES), _drawn(margin, scan["over_arms"][margin]), color=VERMILION, lw=1.6)
            axis.plot(np.degrees(ANGLES), _drawn(margin, scan["design"][margin]), color=BLUE, lw=1.8)
        axis.hlines(levels or asked[margins[0]], 0, 90, color="0.55", lw=0.9, ls="--", zorder=1)
        axis.grid(color="0.92", lw=0.6)
        axis.tick_params(labelsize=9.5)
        axis.set(yscale="log" if "delay" in margins else "linear", xlim=(0, 90), xticks=(0, 30, 60, 90), ylim=limits)
        axis.set_yticks(marks, [f"{mark:g}" for mark in marks])
        if axis in axes[: len(_PANELS)]:
            axis.set_title(title, fontsize=11)
        if axis in axes[:: len(_PANELS)]:
            axis.set_ylabel(name, rotation=0, ha="right", va="center", labelpad=8, fontsize=11)
    figure.supxlabel("joint angle (°)", fontsize=11)
    return figure


def _drawn(margin: str, known: list[float | None]) -> Floats:
    """Margins as drawn: gains in dB, NaN, which is not drawn, where there is no margin."""
    values = np.array(known, dtype=np.float64)
    return 20 * np.log10(np.where(values > 0, values, np.nan)) if margin.startswith("gain") else values


def _poles(scans: Data) -> Figure:
    """Closed-loop poles in the upper half plane, coloured by the angle of the arm."""
    figure, axes = panels(len(scans), 4, (2.25, 2.3), sharex=True, sharey=True)
    shown_poles = None
    for axis, (name, scan) in zip(axes, scans.items(), strict=True):
        angles = np.repeat(np.degrees(ANGLES), [len(poles) for poles in scan["poles"]])
        real, imaginary = np.concatenate([np.reshape(poles, (-1, 2)) for poles in scan["poles"]]).T
        shown_poles = axis.scatter(real, imaginary, c=angles, vmin=0, vmax=90, cmap="viridis", s=7, zorder=3)
        damping_lines(axis, 0.1, 0.3)
        axis.set(xlim=(-62, 4), ylim=(-2, 72))
        axis.set_title(name, fontsize=11)
        axis.tick_params(labelsize=9.5)
        axis.grid(color="0.94", lw=0.6)
    figure.supxlabel("real part (1/s)", fontsize=11)
    figure.supylabel("imaginary part (1/s)", fontsize=11)
    if shown_poles is not None:
        figure.colorbar(shown_poles, ax=axes, label="joint angle (°)", shrink=0.6, ticks=(0, 30, 60, 90))
    return figure
