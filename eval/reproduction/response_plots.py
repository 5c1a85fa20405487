"""Pictures of the study: time responses as in Figs. 4(b) and 8(b), alternatives, other moves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from beltarm_env.task.seeds import PAPER_MOVES
from eval.report.style import BLUE, GREEN, ORANGE, PINK, save_figures
from eval.report.text import degrees
from eval.reproduction.locus_plots import damping_picture, locus_picture
from eval.reproduction.loop import PAPER_ARM, k4_locus
from eval.reproduction.responses import Response
from eval.reproduction.ringing import PHASES, REDUCED, REMOVED, Suppression
from eval.reproduction.study import AS_ANALYSED, FRICTION, MAIN, STANDARD, TO_0, PaperStudy, Scene

WITHOUT, SUPPRESSED = ORANGE, BLUE
"""Colours of K4 = 0 and of the gain given."""
_PHASE_SHADE = "#F0F0F0"
_STYLES: dict[str, dict[str, Any]] = {AS_ANALYSED: {"lw": 4.5, "alpha": 0.35}, FRICTION: {"lw": 1.5}}
"""How lines as analysed and with friction are drawn: both can be seen where they coincide."""

_RADIAL = (
    ("motor speed (rad/s)", "motor_speed", "motor_speed_reference"),
    ("tip velocity ṙ (m/s)", "radial_speed", "radial_speed_reference"),
    ("tip acceleration r̈ (m/s²)", "radial_acceleration", "radial_acceleration_reference"),
)
_LATERAL = (
    *_RADIAL[:2],
    ("lateral velocity ẏ (m/s)", "lateral_speed", None),
    ("lateral acc. ÿ (m/s²)", "lateral_acceleration", None),
)


def save_pictures(study: PaperStudy, folder: Path) -> list[Path]:
    """Draw all pictures into `folder`, each atomically.

    Raises:
        OSError: If the folder cannot be written to.
    """
    figures = {
        "responses_standard.png": lambda: _responses(study, STANDARD, FRICTION, _RADIAL),
        "responses_standard_as_analysed.png": lambda: _responses(study, STANDARD, AS_ANALYSED, _RADIAL),
        "responses_to_0.png": lambda: _responses(study, TO_0, FRICTION, _LATERAL),
        "root_locus_90.png": lambda: locus_picture(study.gains, 90.0),
        "root_locus_0.png": lambda: locus_picture(study.gains, 0.0),
        "damping_map.png": lambda: damping_picture(study.gains),
        "assumptions.png": lambda: _assumptions(study),
        "moves.png": lambda: _moves(study),
    }
    return save_figures(figures, folder, dpi=100, pil_kwargs={"optimize": True})


def _responses(study: PaperStudy, place: str, view: str, rows: tuple[tuple[str, str, str | None], ...]) -> Figure:
    """Motor and tip over time, Figs. 4(b) and 8(b) side by side."""
    scene = study.scenes[place, view]
    figure, axes = plt.subplots(
        len(rows), 2, figsize=(9, 1.0 + 1.8 * len(rows)), layout="constrained", sharex=True, sharey="row"
    )
    columns = (
        (scene.without, WITHOUT, "K4 = 0"),
        (scene.suppressed, SUPPRESSED, f"K4 = {study.gains.k4:g}"),
    )
    for column, (shown, colour, title) in enumerate(columns):
        axes[0][column].set_title(f"{title} ({'as Fig. 4b' if column == 0 else 'as Fig. 8b'})", fontsize=11)
        for row, (label, name, reference) in enumerate(rows):
            axis: Axes = axes[row][column]
            _signal(axis, scene, shown, name, reference, colour, title)
            if column == 0:
                axis.set_ylabel(label)
        axes[-1][column].set_xlabel("time (s)")
    start, goal = scene.move[:2]
    figure.suptitle(f"{degrees(start)} to {degrees(goal)}, {view} (grey: the move)", fontsize=12)
    figure.align_ylabels()
    handles, labels = axes[0][0].get_legend_handles_labels()
    more, names = axes[0][1].get_legend_handles_labels()
    figure.legend(
        [handles[1], more[1], handles[0]],
        [labels[1], names[1], "rigid arm on the reference"],
        loc="outside lower center",
        ncols=3,
        frameon=False,
    )
    return figure


def _signal(
    axis: Axes, scene: Scene, shown: Response, name: str, reference: str | None, colour: str, label: str
) -> None:
    stop = scene.move.duration
    axis.axvspan(0, stop, color=_PHASE_SHADE, zorder=0)
    if reference is not None:
        axis.plot(shown.time, shown.signal(reference), color="0.35", lw=1.2, ls="--", label="reference")
    else:
        axis.axhline(0, color="0.35", lw=1.2, ls="--")
    axis.plot(shown.time, shown.signal(name), color=colour, lw=1.4, label=label)
    axis.set_xlim(0, shown.time[-1])
    axis.grid(alpha=0.3)


def _assumptions(study: PaperStudy) -> Figure:
    """Ratio of ringing with to without vibration feedback, one row per value of each assumption."""
    rows: list[tuple[str, dict[str, Suppression]]] = [("standard move", {view: study.standard(view) for view in MAIN})]
    breaks = [0.5]
    for assumption in study.assumptions:
        rows += [(a.label, {view: study.found[view][a.label] for view in MAIN}) for a in assumption.alternatives]
        breaks.append(len(rows) - 0.5)
    figure, axes = plt.subplots(1, 2, figsize=(9, 9.8), layout="constrained", sharey=True, sharex=True)
    for axis, (phase, title) in zip(axes, (("stop", PHASES["stop"]), ("end", PHASES["end"])), strict=True):
        for view, colour, marker in ((AS_ANALYSED, GREEN, "o"), (FRICTION, PINK, "D")):
            ratios = np.array([found[view].ratio(phase) for _, found in rows])
            shown = np.isfinite(ratios)
            axis.scatter(ratios[shown], np.flatnonzero(shown), color=colour, marker=marker, s=32, zorder=2, label=view)
        for position in breaks[:-1]:
            axis.axhline(position, color="0.85", lw=0.8)
        for bound in (REMOVED, REDUCED):
            axis.axvline(bound, color="0.4", lw=1, ls=":")
        axis.axvline(1, color="0.4", lw=1)
        axis.set(xscale="log", xlabel=f"ringing with K4 = {study.gains.k4:g} over that with 0", title=title)
        axis.grid(axis="x", alpha=0.3)
        axis.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.xaxis.set_major_formatter(FuncFormatter(lambda ratio, _: f"{ratio:g}"))
        axis.xaxis.set_minor_locator(NullLocator())
    axes[0].set_yticks(range(len(rows)), [name for name, _ in rows], fontsize=9)
    axes[0].set_ylim(len(rows) - 0.4, -0.6)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    return figure


def _moves(study: PaperStudy) -> Figure:
    """Ringing over the ramp time, and the share of random moves that vibration feedback calms."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 4.8), layout="constrained")
    _ramp_sweep(left, study)
    _distribution(right, study)
    return figure


def _ramp_sweep(axis: Axes, study: PaperStudy) -> None:
    for view, style in _STYLES.items():
        pair = study.sweep[view]
        for ringing, colour, gain in (
            (pair.without, WITHOUT, "0"),
            (pair.suppressed, SUPPRESSED, f"{study.gains.k4:g}"),
        ):
            there = np.isfinite(ringing.stop)  # the arm did not leave its workspace
            label = f"K4 = {gain}, {view}"
            axis.plot(study.ramp_times[there], ringing.stop[there], color=colour, label=label, **style)
    mode = np.abs(k4_locus(PAPER_ARM, np.pi / 2, study.gains, np.array([0.0])).imag).max()
    period = 2 * np.pi / mode
    axis.axvline(period, color="0.5", lw=1, ls=":")
    axis.text(period, 0.97, " one period", transform=axis.get_xaxis_transform(), color="0.35", fontsize=9, va="top")
    axis.set(xlabel="ramp time of the trapezoid (s)", ylabel="ringing after the stop (m/s²)")
    axis.set_ylim(bottom=0)
    start, goal = study.move[:2]
    axis.set_title(f"{degrees(start)} to {degrees(goal)} in {study.move.duration:g} s", fontsize=11)
    axis.grid(alpha=0.3)
    _legend_below(axis)


def _distribution(axis: Axes, study: PaperStudy) -> None:
    for phase, colour, name in (("cruise", GREEN, "cruise"), ("stop", PINK, "after the stop")):
        for view, style in _STYLES.items():
            ratios = study.random[view].ratios(phase)
            ratios = np.sort(ratios[~np.isnan(ratios)])
            share = 100 * (np.arange(len(ratios)) + 1) / len(ratios)
            axis.plot(ratios, share, color=colour, label=f"{name}, {view}", **style)
    axis.axvline(1, color="0.5", lw=1, ls=":")
    axis.axvspan(REDUCED, 1 / REDUCED, color=_PHASE_SHADE, zorder=0)
    axis.set_xscale("log")
    axis.set(xlabel=f"ringing with K4 = {study.gains.k4:g} over that with 0", ylabel="share of moves up to here (%)")
    axis.set(xlim=(0.08, 8), ylim=(0, 100))
    axis.set_xticks([0.1, 0.2, 0.5, 1, 2, 5], ["0.1", "0.2", "0.5", "1", "2", "5"])
    axis.set_title(f"{PAPER_MOVES.size} random moves", fontsize=11)
    axis.grid(alpha=0.3)
    _legend_below(axis)


def _legend_below(axis: Axes) -> None:
    axis.legend(fontsize=9, loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=2, frameon=False)
