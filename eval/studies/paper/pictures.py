"""Pictures of the study: time responses as in Figs. 4(b) and 8(b), alternatives, other moves, drives."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from beltarm_env.arrays import Floats
from eval.comparison.effects import ALL, IDEAL, heading
from eval.report.style import BLUE, GREEN, ORANGE, PINK, mark_one_two_five
from eval.report.text import degrees
from eval.studies._frame import Pictures
from eval.studies.paper.linear import ServoGains
from eval.studies.paper.locus import damping_picture, locus_picture
from eval.studies.paper.responses import SIGNALS
from eval.studies.paper.ringing import PHASES
from eval.studies.paper.runs import AS_ANALYSED, FRICTION, STANDARD, TO_0

Data = dict[str, Any]
WITHOUT, SUPPRESSED = ORANGE, BLUE
"""Colours of K4 = 0 and of the gain given."""
_PHASE_SHADE = "#F0F0F0"
_STYLES: dict[str, dict[str, Any]] = {AS_ANALYSED: {"lw": 4.5, "alpha": 0.35}, FRICTION: {"lw": 1.5}}
"""Lines as analysed and with friction: both can be seen where they coincide."""
_MARKS = {AS_ANALYSED: (GREEN, "o", -0.17), FRICTION: (PINK, "D", 0.17)}
"""Colour, marker and shift of marks, by conditions."""
_LABELS = {
    "motor_speed": "motor speed (rad/s)",
    "radial_speed": "tip velocity ṙ (m/s)",
    "radial_acceleration": "tip acceleration r̈ (m/s²)",
    "lateral_speed": "lateral velocity ẏ (m/s)",
    "lateral_acceleration": "lateral acc. ÿ (m/s²)",
}
_DRIVES = {IDEAL: "ideal drive", ALL: "all effects of the drive"}


def pictures(data: Data) -> Pictures:
    """All pictures, by the name of their file; those of the linear loop follow from the gains."""
    gains = ServoGains(**data["gains"])
    return {
        "responses_standard.png": lambda: _responses(data, STANDARD, FRICTION),
        "responses_standard_as_analysed.png": lambda: _responses(data, STANDARD, AS_ANALYSED),
        "responses_to_0.png": lambda: _responses(data, TO_0, FRICTION),
        "root_locus_90.png": lambda: locus_picture(gains, 90.0),
        "root_locus_0.png": lambda: locus_picture(gains, 0.0),
        "damping_map.png": lambda: damping_picture(gains),
        "assumptions.png": lambda: _assumptions(data),
        "moves.png": lambda: _moves(data),
        "drive.png": lambda: _swings(data),
        "drive_ratios.png": lambda: _drive_ratios(data),
    }


def _array(values: list[float | None]) -> Floats:
    return np.array(values, dtype=np.float64)


def _responses(data: Data, place: str, view: str) -> Figure:
    """Motor and tip over time, Figs. 4(b) and 8(b) side by side."""
    (scene,) = [scene for scene in data["scenes"] if (scene["place"], scene["view"]) == (place, view)]
    signals, names = data["signals"][f"{place}, {view}"], SIGNALS[place, view]
    figure, axes = plt.subplots(
        len(names), 2, figsize=(9, 1.0 + 1.8 * len(names)), layout="constrained", sharex=True, sharey="row"
    )
    columns = (
        ("without", WITHOUT, "K4 = 0", "as Fig. 4b"),
        ("suppressed", SUPPRESSED, f"K4 = {data['gains']['k4']:g}", "as Fig. 8b"),
    )
    for column, (key, colour, title, figure_of_paper) in enumerate(columns):
        axes[0][column].set_title(f"{title} ({figure_of_paper})", fontsize=11)
        for row, name in enumerate(names):
            axis, first = axes[row][column], row == 0
            axis.axvspan(0, scene["move"]["duration"], color=_PHASE_SHADE, zorder=0)
            reference = signals.get(f"{name}_reference", [0.0] * len(signals["time"]))
            label = "rigid arm on the reference" if first and column else None
            axis.plot(signals["time"], reference, color="0.35", lw=1.2, ls="--", label=label)
            axis.plot(signals["time"], _array(signals[key][name]), color=colour, lw=1.4, label=title if first else None)
            axis.set_xlim(0, signals["time"][-1])
            axis.grid(alpha=0.3)
            if column == 0:
                axis.set_ylabel(_LABELS[name])
        axes[-1][column].set_xlabel("time (s)")
    start, goal = scene["move"]["start"], scene["move"]["goal"]
    figure.suptitle(f"{degrees(start)} to {degrees(goal)}, {view} (grey: the move)", fontsize=12)
    figure.align_ylabels()
    figure.legend(loc="outside lower center", ncols=3, frameon=False)
    return figure


def _ratio_axis(axis: Axes, data: Data, phase: str) -> None:
    """Prepare a logarithmic axis of ratios of ringing with to without vibration feedback, and mark the bounds."""
    for bound in (data["bounds"]["removed"], data["bounds"]["reduced"]):
        axis.axvline(bound, color="0.4", lw=1, ls=":")
    axis.axvline(1, color="0.4", lw=1)
    axis.set(xscale="log", title=PHASES[phase], xlabel=f"ringing with K4 = {data['gains']['k4']:g} over that with 0")
    mark_one_two_five(axis.xaxis)
    axis.xaxis.set_minor_locator(NullLocator())


def _assumptions(data: Data) -> Figure:
    """Ratio of ringing with to without vibration feedback, one row per value of each assumption."""
    usual = {scene["view"]: scene for scene in data["scenes"] if scene["place"] == STANDARD}
    rows = [{"assumption": "", "label": "standard move", "views": usual}, *data["alternatives"]]
    figure, axes = plt.subplots(1, 2, figsize=(9, 9.8), layout="constrained", sharey=True, sharex=True)
    for axis, phase in zip(axes, ("stop", "end"), strict=True):
        for view, (colour, marker, _) in _MARKS.items():
            ratios = _array([row["views"][view]["ratios"][phase] for row in rows])
            axis.scatter(ratios, np.arange(len(rows)), color=colour, marker=marker, s=32, zorder=2, label=view)
        for k in range(1, len(rows)):
            if rows[k]["assumption"] != rows[k - 1]["assumption"]:
                axis.axhline(k - 0.5, color="0.85", lw=0.8)
        _ratio_axis(axis, data, phase)
        axis.grid(axis="x", alpha=0.3)
    axes[0].set_yticks(range(len(rows)), [row["label"] for row in rows], fontsize=9)
    axes[0].set_ylim(len(rows) - 0.4, -0.6)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    return figure


def _moves(data: Data) -> Figure:
    """Ringing over the ramp time, and the share of random moves that vibration feedback calms."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 4.8), layout="constrained")
    _ramp_sweep(left, data)
    _distribution(right, data)
    for axis in (left, right):
        axis.grid(alpha=0.3)
        axis.legend(fontsize=9, loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=2, frameon=False)
    return figure


def _ramp_sweep(axis: Axes, data: Data) -> None:
    gains = ("0", f"{data['gains']['k4']:g}")
    for view, style in _STYLES.items():
        for ringing, colour, gain in zip(data["sweep"]["views"][view], (WITHOUT, SUPPRESSED), gains, strict=True):
            label = f"K4 = {gain}, {view}"
            axis.plot(data["sweep"]["ramp_times"], _array(ringing), color=colour, label=label, **style)
    period = 2 * np.pi / max(imaginary for _, imaginary in data["linear"]["poles"]["off"][1])
    axis.axvline(period, color="0.5", lw=1, ls=":")
    axis.text(period, 0.97, " one period", transform=axis.get_xaxis_transform(), color="0.35", fontsize=9, va="top")
    axis.set(xlabel="ramp time of the trapezoid (s)", ylabel="ringing after the stop (m/s²)")
    axis.set_ylim(bottom=0)
    move = data["move"]
    title = f"{degrees(move['start'])} to {degrees(move['goal'])} in {move['duration']:g} s"
    axis.set_title(title, fontsize=11)


def _distribution(axis: Axes, data: Data) -> None:
    for phase, colour, name in (("cruise", GREEN, "cruise"), ("stop", PINK, "after the stop")):
        for view, style in _STYLES.items():
            ratios = _array(data["random"][view]["phases"][phase]["ratios"])
            share = 100 * (np.arange(len(ratios)) + 1) / max(len(ratios), 1)
            axis.plot(ratios, share, color=colour, label=f"{name}, {view}", **style)
    reduced = data["bounds"]["reduced"]
    axis.axvline(1, color="0.5", lw=1, ls=":")
    axis.axvspan(reduced, 1 / reduced, color=_PHASE_SHADE, zorder=0)
    axis.set(xscale="log", ylabel="share of moves up to here (%)")
    axis.set(xlim=(0.08, 8), ylim=(0, 100), xlabel=f"ringing with K4 = {data['gains']['k4']:g} over that with 0")
    axis.set_xticks([0.1, 0.2, 0.5, 1, 2, 5], ["0.1", "0.2", "0.5", "1", "2", "5"])
    axis.set_title(f"{data['random_moves']['size']} random moves", fontsize=11)


def _swings(data: Data) -> Figure:
    """Velocity of the tip against a rigid arm on the reference, over time: ideal drive above, all effects below."""
    figure, axes = plt.subplots(2, 2, figsize=(9, 5.2), layout="constrained", sharex=True, sharey=True)
    time = data["swings"]["time"]
    for row, (drive, title) in zip(axes, _DRIVES.items(), strict=True):
        width = {"lw": 1.4} if drive == IDEAL else {"lw": 0.7, "alpha": 0.8}
        gains = (0.0, data["gains"]["k4"])
        for axis, lines, colour, k4 in zip(row, data["swings"][drive], (WITHOUT, SUPPRESSED), gains, strict=True):
            axis.axvspan(0, data["move"]["duration"], color=_PHASE_SHADE, zorder=0)
            for line in lines:
                axis.plot(time, _array(line), color=colour, **width)
            axis.set_title(f"K4 = {k4:g}, {title}", fontsize=11)
            axis.grid(alpha=0.3)
            axis.set_xlim(0, time[-1])
        row[0].set_ylabel("tip velocity less a\nrigid arm's, along x (m/s)")
    for axis in axes[-1]:
        axis.set_xlabel("time (s); grey: the move")
    return figure


def _drive_ratios(data: Data) -> Figure:
    """Ratio of ringing with to without vibration feedback, a row for each effect, a mark for each drive."""
    rows = {row["view"]: row["drives"] for row in data["drives"] if row["place"] == STANDARD}
    names = [drive["drive"] for drive in rows[FRICTION]]
    figure, axes = plt.subplots(1, 2, figsize=(9, 5.2), layout="constrained", sharex=True, sharey=True)
    for axis, phase in zip(axes, ("stop", "end"), strict=True):
        for view, (colour, marker, shift) in _MARKS.items():
            for k, drive in enumerate(rows[view]):
                ratios, height = _array(drive["ratios"][phase]), k + shift
                label, heights = view if k == 0 else None, np.full(len(ratios), height)
                axis.scatter(ratios, heights, color=colour, marker=marker, s=16, alpha=0.6, lw=0, label=label)
                known = ratios[np.isfinite(ratios)]
                if len(known):
                    axis.plot([np.median(known)] * 2, [height - 0.16, height + 0.16], color="black", lw=1.3)
        for k in range(1, len(names)):
            axis.axhline(k - 0.5, color="0.88", lw=0.8)
        _ratio_axis(axis, data, phase)
    axes[0].set_yticks(range(len(names)), [heading(name) for name in names], fontsize=9)
    axes[0].set_ylim(len(names) - 0.5, -0.5)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    return figure
