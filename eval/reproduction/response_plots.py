"""Pictures of the paper's figures and of what became of its conclusion: time responses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

matplotlib.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from agents.files import write_atomically
from eval.colours import BLUE, GREEN, ORANGE, PINK
from eval.reproduction.cases import CLEAR
from eval.reproduction.locus_plots import damping_picture, locus_picture
from eval.reproduction.loop import PAPER_ARM, k4_locus
from eval.reproduction.runs import Response
from eval.reproduction.study import RANDOM_MOVES, Scene, Study

WITHOUT, SUPPRESSED = ORANGE, BLUE
"""Colours of K4 = 0 and of the gain given."""
_PHASE_SHADE = "#F0F0F0"
_DPI = 130
_STYLES: dict[bool, dict[str, Any]] = {False: {"lw": 4.5, "alpha": 0.35}, True: {"lw": 1.5}}
"""How lines with and without Coulomb friction are drawn: both can be seen where they coincide."""

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


def save_pictures(study: Study, folder: Path) -> list[Path]:
    """Draw all pictures into `folder`, each atomically.

    Raises:
        OSError: If the folder cannot be written to.
    """
    figures = {
        "responses_90.png": lambda: _responses(study, "90°", "with friction", _RADIAL),
        "responses_90_as_analysed.png": lambda: _responses(study, "90°", "as analysed", _RADIAL),
        "responses_0.png": lambda: _responses(study, "0°", "with friction", _LATERAL),
        "root_locus_90.png": lambda: locus_picture(study.gains, 90.0),
        "root_locus_0.png": lambda: locus_picture(study.gains, 0.0),
        "damping_map.png": lambda: damping_picture(study.gains),
        "assumptions.png": lambda: _assumptions(study),
        "moves.png": lambda: _moves(study),
    }
    paths = []
    for name, draw in figures.items():
        figure, path = draw(), folder / name
        write_atomically(path, lambda temporary, figure=figure: _write(figure, temporary))
        plt.close(figure)
        paths.append(path)
    return paths


def _write(figure: Figure, path: Path) -> None:
    """Write a picture of few colours, which takes half the space."""
    canvas = FigureCanvasAgg(figure)
    figure.set_dpi(_DPI)
    canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    picture.quantize(128, dither=Image.Dither.NONE).save(path, optimize=True)


def _responses(study: Study, place: str, view: str, rows: tuple[tuple[str, str, str | None], ...]) -> Figure:
    """Motor and tip over time, Figs. 4(b) and 8(b) side by side."""
    scene = study.scenes[place, view]
    figure, axes = plt.subplots(
        len(rows), 2, figsize=(9, 1.0 + 1.95 * len(rows)), layout="constrained", sharex=True, sharey="row"
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
    start, goal = np.degrees(scene.move[:2])
    figure.suptitle(f"{start:.0f}° to {goal:.0f}°, {view} (grey: the move)", fontsize=12)
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
        axis.plot(shown.time, getattr(shown, reference), color="0.35", lw=1.2, ls="--", label="reference")
    else:
        axis.axhline(0, color="0.35", lw=1.2, ls="--")
    axis.plot(shown.time, getattr(shown, name), color=colour, lw=1.4, label=label)
    axis.set_xlim(0, shown.time[-1])
    axis.grid(alpha=0.3)


def _assumptions(study: Study) -> Figure:
    """Ringing without and with vibration feedback, one row per value of each assumption."""
    rows = [("standard move", study.scenes["90°", "with friction"].compared)]
    breaks = [0.5]
    for question in study.questions:
        pairs = zip(question.variants, study.found[question.name], strict=True)
        rows += [(variant.label, found) for variant, found in pairs]
        breaks.append(len(rows) - 0.5)
    figure, axes = plt.subplots(1, 2, figsize=(9, 8.8), layout="constrained", sharey=True)
    for axis, phase, title in zip(axes, ("cruise", "stop"), ("during the cruise", "after the stop"), strict=True):
        for y, (_, found) in enumerate(rows):
            before, after = getattr(found.without, phase)[0], getattr(found.suppressed, phase)[0]
            axis.plot([before, after], [y, y], color="0.6", lw=1.5, zorder=1)
            axis.scatter(before, y, color=WITHOUT, marker="o", s=34, zorder=2, label="K4 = 0" if y == 0 else None)
            label = f"K4 = {study.gains.k4:g}" if y == 0 else None
            axis.scatter(after, y, color=SUPPRESSED, marker="D", s=30, zorder=2, label=label)
        for position in breaks[:-1]:
            axis.axhline(position, color="0.85", lw=0.8)
        axis.set(xlabel="ringing (m/s²)", title=title)
        axis.set_xlim(left=0)
        axis.grid(axis="x", alpha=0.3)
    axes[0].set_yticks(range(len(rows)), [name for name, _ in rows], fontsize=9)
    axes[0].set_ylim(len(rows) - 0.4, -0.6)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    return figure


def _moves(study: Study) -> Figure:
    """Ringing over the ramp time, and the share of random moves that vibration feedback calms."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 4.8), layout="constrained")
    _ramp_sweep(left, study)
    _distribution(right, study)
    return figure


def _ramp_sweep(axis: Axes, study: Study) -> None:
    for friction, style in _STYLES.items():
        pair = study.sweep.ringing[friction]
        name = "friction" if friction else "no friction"
        for ringing, colour, gain in (
            (pair.without, WITHOUT, "0"),
            (pair.suppressed, SUPPRESSED, f"{study.gains.k4:g}"),
        ):
            axis.plot(study.sweep.ramp_times, ringing.stop, color=colour, label=f"K4 = {gain}, {name}", **style)
    mode = np.abs(k4_locus(PAPER_ARM, np.pi / 2, study.gains, np.array([0.0])).imag).max()
    period = 2 * np.pi / mode
    axis.axvline(period, color="0.5", lw=1, ls=":")
    axis.text(period, 0.97, " one period", transform=axis.get_xaxis_transform(), color="0.35", fontsize=9, va="top")
    axis.set(xlabel="ramp time of the trapezoid (s)", ylabel="ringing after the stop (m/s²)")
    axis.set_ylim(bottom=0)
    axis.set_title(_title(study), fontsize=11)
    axis.grid(alpha=0.3)
    _legend_below(axis)


def _title(study: Study) -> str:
    start, goal = np.degrees(study.move[:2])
    return f"{start:.0f}° to {goal:.0f}° in {study.move.duration:g} s"


def _distribution(axis: Axes, study: Study) -> None:
    share = (np.arange(RANDOM_MOVES) + 1) / RANDOM_MOVES * 100
    for phase, colour, name in (("cruise", GREEN, "cruise"), ("stop", PINK, "after the stop")):
        for friction, style in _STYLES.items():
            label = f"{name}, {'friction' if friction else 'no friction'}"
            axis.plot(np.sort(study.random[friction].ratios(phase)), share, color=colour, label=label, **style)
    axis.axvline(1, color="0.5", lw=1, ls=":")
    axis.axvspan(CLEAR, 1 / CLEAR, color=_PHASE_SHADE, zorder=0)
    axis.set_xscale("log")
    axis.set(xlabel=f"ringing with K4 = {study.gains.k4:g} over that with 0", ylabel="share of moves up to here (%)")
    axis.set(xlim=(0.08, 8), ylim=(0, 100))
    axis.set_xticks([0.1, 0.2, 0.5, 1, 2, 5], ["0.1", "0.2", "0.5", "1", "2", "5"])
    axis.set_title(f"{RANDOM_MOVES} random moves", fontsize=11)
    axis.grid(alpha=0.3)
    _legend_below(axis)


def _legend_below(axis: Axes) -> None:
    axis.legend(fontsize=9, loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=2, frameon=False)
