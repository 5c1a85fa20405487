"""Pictures of the comparison."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agents.files import write_atomically
from beltarm_env.rollout import Recording
from eval.colours import COLOURS
from eval.results import Comparison
from eval.summary import COLUMNS

_MOVE_SHADE = "#EEEEEE"
_BARS = ("tip_rms_mm", "tip_max_mm", "residual_pp_mm", "cost")

Traces = dict[str, dict[str, tuple[Recording, int]]]
"""Per split and method: a recording, and which of its episodes to show (the same scenario for all methods)."""


def save_plots(comparison: Comparison, traces: Traces, folder: Path) -> list[Path]:
    """Draw all pictures into `folder`."""
    colours = {outcome.method.name: COLOURS[i % len(COLOURS)] for i, outcome in enumerate(_first_split(comparison))}
    figures = {
        "tip_error.png": _time_plot(traces, colours, _tip_error, "tip error (mm)"),
        "residual.png": _residual_plot(traces, colours),
        "torque.png": _time_plot(traces, colours, _torque, "motor torque (N m)"),
        "bars.png": _bars(comparison, colours),
    }
    paths = []
    for name, figure in figures.items():
        path = folder / name
        write_atomically(path, lambda temporary, figure=figure: figure.savefig(temporary, dpi=120))
        plt.close(figure)
        paths.append(path)
    return paths


def _first_split(comparison: Comparison) -> list:
    return comparison.on(comparison.splits()[0])


def _tip_error(recording: Recording, episode: int) -> np.ndarray:
    return 1000 * np.linalg.norm(recording.tip_error[:, episode], axis=1)


def _torque(recording: Recording, episode: int) -> np.ndarray:
    return recording.torque[:, episode]


def _axes(count: int, height: float) -> tuple[Figure, list[Axes]]:
    figure, axes = plt.subplots(1, count, figsize=(5.2 * count, height), layout="constrained", squeeze=False)
    return figure, list(axes[0])


def _mark_move(axis: Axes, duration: float) -> None:
    axis.axvspan(0, duration, color=_MOVE_SHADE, zorder=0)
    axis.text(duration / 2, 0.98, "move", transform=axis.get_xaxis_transform(), ha="center", va="top", color="0.45")


def _describe(recording: Recording, episode: int) -> str:
    start, goal = np.degrees(recording.moves[episode, :2])
    return f"{start:.0f}° to {goal:.0f}°"


def _time_plot(traces: Traces, colours: dict[str, str], quantity, label: str) -> Figure:
    figure, axes = _axes(len(traces), 3.6)
    for axis, (split, methods) in zip(axes, traces.items(), strict=True):
        for method, (recording, episode) in methods.items():
            axis.plot(recording.time, quantity(recording, episode), color=colours[method], lw=1.3, label=method)
        recording, episode = next(iter(methods.values()))
        _mark_move(axis, recording.moves[episode, 2])
        axis.set(xlabel="time (s)", ylabel=label, xlim=(0, recording.time[-1]))
        axis.set_title(f"{split}: median scenario, {_describe(recording, episode)}", fontsize=10)
        axis.grid(alpha=0.3)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(colours), frameon=False)
    return figure


def _residual_plot(traces: Traces, colours: dict[str, str]) -> Figure:
    figure, axes = plt.subplots(
        2, len(traces), figsize=(5.2 * len(traces), 5), layout="constrained", squeeze=False, sharex="col"
    )
    for column, (split, methods) in enumerate(traces.items()):
        for method, (recording, episode) in methods.items():
            duration = recording.moves[episode, 2]
            after = recording.time >= duration
            for row in range(2):
                motion = 1000 * recording.tip_error[after, episode, row]
                axes[row][column].plot(
                    recording.time[after] - duration, motion, color=colours[method], lw=1.3, label=method
                )
        recording, episode = next(iter(methods.values()))
        axes[0][column].set_title(f"{split}: after the move, {_describe(recording, episode)}", fontsize=10)
        axes[0][column].set_ylabel("radial tip error (mm)")
        axes[1][column].set(ylabel="lateral tip error (mm)", xlabel="time since the move's end (s)")
    for axis in axes.flat:
        axis.grid(alpha=0.3)
        axis.axhline(0, color="0.6", lw=0.8)
    handles = axes[0][0].get_legend_handles_labels()
    figure.legend(*handles, loc="outside lower center", ncols=len(colours), frameon=False)
    return figure


def _bars(comparison: Comparison, colours: dict[str, str]) -> Figure:
    figure, axes = plt.subplots(1, len(_BARS), figsize=(3.1 * len(_BARS), 3.6), layout="constrained")
    figure.suptitle("Interquartile means with 95 % intervals; lower is better", fontsize=10, color="0.4")
    splits = comparison.splits()
    width = 0.8 / len(colours)
    for axis, name in zip(axes, _BARS, strict=True):
        for i, (method, colour) in enumerate(colours.items()):
            values = [
                outcome.estimates[name]
                for split in splits
                for outcome in comparison.on(split)
                if outcome.method.name == method
            ]
            heights = np.array([value.iqm for value in values])
            below = heights - [value.low for value in values]
            above = np.array([value.high for value in values]) - heights
            positions = np.arange(len(splits)) + (i - (len(colours) - 1) / 2) * width
            axis.bar(positions, heights, 0.92 * width, color=colour, label=method)
            axis.errorbar(positions, heights, [below, above], fmt="none", ecolor="0.2", capsize=3, lw=1)
        title, unit = COLUMNS[name]
        axis.set_title(title if unit == "-" else f"{title} ({unit})", fontsize=10)
        axis.set_xticks(range(len(splits)), splits)
        axis.grid(axis="y", alpha=0.3)
        axis.set_axisbelow(True)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(colours), frameon=False)
    return figure
