"""Tables and pictures of the page, from the data alone: one function for each."""

from __future__ import annotations

from math import isfinite, nan
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from baselines.models.linear import ANGLES
from beltarm_env.arrays import Floats
from beltarm_env.metrics import TORQUES, heading
from eval.comparison.statistics import Estimate
from eval.report.style import BLUE, VERMILION
from eval.report.text import cell, markdown_table, number, numbers
from eval.studies._frame import Pictures
from eval.studies.loops.costs import IDENTIFYING, SHOWN_METRICS, WORSE

Data = dict[str, Any]
MEANING = {
    "angle": ("K_p", "1/s²"),
    "speed": ("K_v", "1/s"),
    "integral": ("K_i", "1/s"),
    "torsion_speed": ("K_4", "N m s/rad"),
    "friction": ("c", "share of friction"),
    "rest_width": ("width", "N m"),
    "shortest_ramp": ("t", "s"),
    "frequency": ("of the mode", "of the nominal"),
    "vibration": ("V", "–"),
    "ramp": ("t", "periods of the mode"),
    "observer": ("g, ω_o", "rad/s"),
    "bandwidth": ("ω_c", "rad/s"),
    "reaction": ("g_r", "rad/s"),
    "reaction_gain": ("K_r", "–"),
    "first_spread": ("of the first corner", "periods of the mode"),
    "spread": ("of later corners", "periods of the mode"),
    "velocity_weight": ("w_v", "–"),
    "torque_weight": ("ρ", "1/(N m)²"),
    "change_weight": ("R", "1/(N m)²"),
    "torque_noise": ("σ_τ", "N m"),
    "acceleration_noise": ("σ_α", "rad/s²"),
    "disturbance_noise": ("σ_d", "N m/√s"),
    "angle_noise": ("σ_0", "rad/√s"),
    "unexplained_torque": ("σ_d", "N m"),
    "friction_share": ("c", "share of friction"),
    "friction_speed": ("ω_0", "rad/s"),
    "swing_doubt": ("σ of ln S", "–"),
    "stiffness_doubt": ("σ of ln K_s", "–"),
    "friction_doubt": ("σ of ln V_a1, ln τ_c", "–"),
}
"""Symbol in the module's docstring and unit of every gain, by its name."""
_MARGINS = {"gain_up": "gain up", "gain_down": "gain down", "phase": "phase (°)", "delay": "delay (samples)"}
_MARGINS |= {"modulus": "modulus"}
"""Title of each margin."""
_DIGITS = {"phase": 0, "delay": 1, "modulus": 2}
_PANELS = (
    (("gain_up", "gain_down"), "gain (dB)", (-45.0, 45.0)),
    (("phase",), "phase (°)", (0.0, 115.0)),
    (("delay",), "delay (samples)", (0.5, 200.0)),
    (("modulus",), "modulus", (0.0, 1.05)),
)
"""Margins, title and limits of the axis."""


def tables(data: Data) -> Data:
    """Tables by the names that the template has for them, and names of controllers for its sentences."""
    rows = data["controllers"]
    labelled = {f"*{name}* (not ranked)" if name == data["oracle"] else name: row for name, row in rows.items()}
    ranked = {name: row for name, row in rows.items() if name != data["oracle"]}
    searches = {name: entry["tuning"] for name, entry in data["gains"].items() if entry["tuning"]}
    return {
        "glance": _glance(data["limits"], labelled),
        "margins": _least_on_the_design(ranked),
        "corners": _corners(ranked),
        "by_arm": _by_arm(data["corners"], ranked),
        "costs": _costs(labelled),
        "changes": _changes(data["changes"], labelled),
        "prices": _prices(ranked),
        "gap": _gap(data["optimum"], labelled),
        "sections": {name: _gains(entry) for name, entry in data["gains"].items()},
        "ranked": ranked,
        "unpriced": [name for name in searches if not ranked[name]["price"]],
        "kept": [name for name, search in searches.items() if search["cost"] == search["cost_untuned"]],
        "identifying": IDENTIFYING,
        "worse": WORSE,
    }


def margin_text(name: str, value: float | None) -> str:
    """A margin as text; a dash where there is none."""
    if name in _DIGITS:
        return number(nan if value is None else value, _DIGITS[name])
    return f"×{value:.3g}" if value and isfinite(value) else "–"


def ratio_text(value: float, left: int = 0) -> str:
    """A ratio of costs, and how many arms left the workspace, if any."""
    return (f"{value:.2f}" if value < 9.95 else f"{value:.0f}") + (f" ({left} left)" if left else "")


def _glance(limits: list[str], labelled: Data) -> str:
    """A row for each controller: what it costs, how robust it is, what it asks of motor and computer."""
    titles = ["controller", "cost", "worst 5 %", *limits]
    titles += ["least modulus", "least delay (samples)", heading("torque_reversals_hz"), "p99 (µs)"]
    rows = []
    for label, row in labelled.items():
        iqm, least = row["metrics"]["cost"]["iqm"], ["–", "–"]
        if "loop" in row:
            worst = [margin_text(name, row["loop"]["worst"][name]["value"]) for name in ("modulus", "delay")]
            least = worst if row["loop"]["stable"] else ["unstable", "–"]
        cells = [f"{iqm:.0f}", f"×{ratio_text(row['worst'] / iqm)}"]
        cells += [f"×{ratio_text(effect['iqm'], effect['left'])}" for effect in row["limits"]]
        cells += [*least, number(row["metrics"]["torque_reversals_hz"]["iqm"], 1)]
        rows.append([label, *cells, number(row["times"]["slow"], 0) if "times" in row else "–"])
    return markdown_table(titles, rows)


def _least_on_the_design(ranked: Data) -> str:
    """On the design model each margin's worst over the angles, with the angle."""
    rows = []
    for name, row in ranked.items():
        loop, cells = row["loop"], []
        for margin, worst in loop["worst_design"].items():
            text = margin_text(margin, worst["value"]) if loop["stable_design"] else "–"
            cells.append(text if text == "–" else f"{text} at {worst['degrees']:.0f}°")
        slowest = number(loop["slowest"], 1 if loop["slowest"] < -1 else 2)
        rows.append([name, "yes" if loop["stable_design"] else "no", *cells, slowest])
    return markdown_table(["controller", "stable", *_MARGINS.values(), "slowest pole (1/s)"], rows)


def _corners(ranked: Data) -> str:
    """Least modulus and delay margin over arms and angles, with where."""
    rows = []
    for name, row in ranked.items():
        cells = ["yes" if row["loop"]["stable"] else "no"]
        for margin in ("modulus", "delay"):
            worst = row["loop"]["worst"][margin]
            cells += [margin_text(margin, worst["value"]), f"{worst['arm']}, {worst['degrees']:.0f}°"]
        rows.append([name, *cells])
    return markdown_table(["controller", "stable", "modulus", "where", "delay (samples)", "where"], rows, "llrlrl")


def _by_arm(arms: list[str], ranked: Data) -> str:
    """Least modulus margin over the angles on each arm."""
    loops = [row["loop"] for row in ranked.values()]
    rows = [[arm, *(number(loop["modulus_by_arm"][k], 2) for loop in loops)] for k, arm in enumerate(arms)]
    return markdown_table(["arm", *ranked], rows)


def _costs(labelled: Data) -> str:
    """Metrics on arms as they are built, and cost on the design model."""
    head = ["controller", "cost, design model", *(heading(name) for name in SHOWN_METRICS)]
    titles = [*head, "mean cost", "worst 5 %", "left", *(heading(name) for name in TORQUES)]
    rows = []
    for label, row in labelled.items():
        metrics = {name: Estimate(**value) for name, value in row["metrics"].items()}
        cells = [f"{row['design']:.0f}", *(cell(name, metrics[name]) for name in SHOWN_METRICS)]
        cells += [f"{row['mean']:.0f}", f"{row['worst']:.0f}", str(row["left"])]
        rows.append([label, *cells, *(numbers(name, metrics[name])[0] for name in TORQUES)])
    return markdown_table(titles, rows)


def _changes(changes: list[str], labelled: Data) -> str:
    """A row for each change of the design model, a column for each controller."""
    effects = zip(*(row["changes"] for row in labelled.values()), strict=True)
    texts = [[ratio_text(effect["mean"], effect["left"]) for effect in row] for row in effects]
    return markdown_table(["change", *labelled], [[title, *row] for title, row in zip(changes, texts, strict=True)])


def _prices(ranked: Data) -> str:
    """Cost with and without margins, and what margins are left without; empty if nothing is comparable."""
    rows = []
    for name, row in ranked.items():
        if price := row["price"]:
            margins = ", ".join(margin_text(margin, price[margin]) for margin in ("modulus", "delay"))
            costs = [f"{price[key]:.0f}" for key in ("with", "without", "mean_with", "mean_without")]
            ratio = f"×{ratio_text(price['with'] / price['without'])}"
            left = ["unstable" if price["unstable"] else margins, price["where"]]
            rows.append([name, *costs[:2], ratio, *costs[2:], *left])
    titles = ["controller", "cost with", "without", "price", "mean with", "without", "modulus, delay without", "where"]
    return markdown_table(titles, rows, "lrrrrrrl") if rows else ""


def _gap(optimum: Data, labelled: Data) -> str:
    """Costs over those of the clairvoyant optimum, scenario by scenario and in the mean of each kind."""
    names, least = optimum["names"], np.array(optimum["costs"])
    kinds = np.array([name.split(":")[0] for name in names])
    groups = {kind: kinds == kind for kind in dict.fromkeys(kinds.tolist())}
    means = [least[group].mean() for group in groups.values()]
    rows = [["*optimum's cost*", *(number(value, 1) for value in (*means, *least))]]
    for label, row in labelled.items():
        costs = np.array(row["optimum"])
        means = [costs[group].sum() / least[group].sum() for group in groups.values()]
        rows.append([label, *(ratio_text(value) for value in (*means, *costs / least))])
    return markdown_table(["controller", *(f"{kind}, all" for kind in groups), *names], rows)


def _gains(entry: Data) -> str:
    """Gains of one controller: symbol, value, unit and the range that is searched."""
    rows = []
    for gain in entry["values"]:
        (symbol, unit), limits = MEANING.get(gain["name"], ("", "")), gain["searched"]
        searched = (
            f"{limits['low']:g} to {limits['high']:g}{', log' if limits['log'] else ''}" if limits else "not tuned"
        )
        rows.append([f"`{gain['name']}`", symbol, f"{gain['value']:.4g}", unit, searched])
    return markdown_table(["gain", "symbol", "value", "unit", "searched"], rows, "llrll")


def pictures(data: Data) -> Pictures:
    """All pictures, by the name of their file; small letters are legible where a page is 800 pixels wide."""
    scans = {name: row["loop"] for name, row in data["controllers"].items() if "loop" in row}
    return {"margins.png": lambda: _margins(scans, data["asked"]), "poles.png": lambda: _poles(scans)}


def _margins(scans: Data, asked: dict[str, float]) -> Figure:
    """One row for each controller, one column for each margin, axes shared down the columns."""
    levels = ((6.0, -6.0), (30.0,), (asked["delay"],), (asked["modulus"],))
    size, grid = (9.0, 0.95 * len(scans) + 0.9), (len(scans), len(_PANELS))
    figure, axes = plt.subplots(*grid, figsize=size, sharex=True, sharey="col", squeeze=False)
    for row, (name, scan) in zip(axes, scans.items(), strict=True):
        for axis, (margins, _, limits), least in zip(row, _PANELS, levels, strict=True):
            for margin in margins:
                axis.plot(np.degrees(ANGLES), _drawn(margin, scan["over_arms"][margin]), color=VERMILION, lw=1.6)
                axis.plot(np.degrees(ANGLES), _drawn(margin, scan["design"][margin]), color=BLUE, lw=1.8)
            axis.hlines(least, 0, 90, color="0.55", lw=0.9, ls="--", zorder=1)
            axis.grid(color="0.92", lw=0.6)
            axis.tick_params(labelsize=9.5)
            axis.set(ylim=limits, xlim=(0, 90), xticks=(0, 30, 60, 90))
        row[0].set_ylabel(name, rotation=0, ha="right", va="center", labelpad=8, fontsize=11)
    for axis, bottom, (_, title, _) in zip(axes[0], axes[-1], _PANELS, strict=True):
        axis.set_title(title, fontsize=11)
        bottom.set_xlabel("joint angle (°)", fontsize=10)
    axes[0, 0].set_yticks((-30, 0, 30))
    axes[0, 2].set_yscale("log")
    axes[0, 2].set_yticks((1, 10, 100))
    axes[0, 2].yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes[0, 3].set_yticks((0, 0.5, 1))
    figure.tight_layout(h_pad=0.3, w_pad=0.8)
    return figure


def _drawn(margin: str, known: list[float | None]) -> Floats:
    """Margins as drawn: gains in dB, NaN, which is not drawn, where there is no margin."""
    values = np.array(known, dtype=np.float64)
    return 20 * np.log10(np.where(values > 0, values, np.nan)) if margin.startswith("gain") else values


def _poles(scans: Data) -> Figure:
    """Closed-loop poles in the upper half plane, coloured by the angle of the arm."""
    rows, columns, shown = -(-len(scans) // 4), 4, None
    size = (9.0, 2.3 * rows)
    figure, axes = plt.subplots(
        rows, columns, figsize=size, layout="constrained", sharex=True, sharey=True, squeeze=False
    )
    for axis, (name, scan) in zip(axes.flat, scans.items(), strict=False):
        for degrees, poles in zip(np.degrees(ANGLES), scan["poles"], strict=True):
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
