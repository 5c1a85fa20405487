"""Pictures of the comparison."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from baselines.files import write_atomically
from beltarm_env.rollout import Recording
from eval.colours import COLOURS
from eval.results import Comparison
from eval.summary import COLUMNS

_MOVE_SHADE = "#EEEEEE"
_SHOWN = ("tip_rms_mm", "tip_max_mm", "residual_pp_mm", "cost")

Traces = dict[str, dict[str, tuple[Recording, int]]]
"""Per split and method: a recording, and which of its episodes to show (the same scenario for all methods)."""


def save_plots(comparison: Comparison, traces: Traces, folder: Path) -> list[Path]:
    """Draw all pictures into `folder`."""
    colours: dict[str, str] = dict(zip(_drawn(comparison), COLOURS, strict=False))
    drawn = {split: {name: runs[name] for name in colours} for split, runs in traces.items()}
    figures = {
        "tip_error.png": _time_plot(drawn, colours, _tip_error, "tip error (mm)"),
        "residual.png": _residual_plot(drawn, colours),
        "torque.png": _time_plot(drawn, colours, _torque, "motor torque (N m)"),
        "intervals.png": _intervals(comparison),
    }
    paths = []
    for name, figure in figures.items():
        path = folder / name
        write_atomically(path, lambda temporary, figure=figure: figure.savefig(temporary, dpi=120))
        plt.close(figure)
        paths.append(path)
    return paths


def _drawn(comparison: Comparison) -> list[str]:
    """Methods whose motion is drawn: the first, all learned ones, and the best others by cost on the last split."""
    outcomes = comparison.on(comparison.splits()[-1])
    ranked = sorted(outcomes[1:], key=lambda outcome: outcome.estimates["cost"].iqm)
    learned = [outcome for outcome in ranked if outcome.method.kind == "learned"]
    others = [outcome for outcome in ranked if outcome.method.kind != "learned"]
    chosen = [outcomes[0], *learned, *others][: len(COLOURS) - 2]
    return [outcome.method.name for outcome in outcomes if outcome in chosen]


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


def _intervals(comparison: Comparison) -> Figure:
    """Every method's interquartile means with their intervals, a row each, best at the top."""
    splits = comparison.splits()
    last = sorted(comparison.on(splits[-1]), key=lambda outcome: -outcome.estimates["cost"].iqm)
    rows = {outcome.method.name: row for row, outcome in enumerate(last)}
    figure, axes = plt.subplots(
        1, len(_SHOWN), figsize=(3.0 * len(_SHOWN), 1.6 + 0.28 * len(rows)), layout="constrained", sharey=True
    )
    figure.suptitle("Interquartile means with 95 % intervals; further left is better", fontsize=10, color="0.4")
    for axis, name in zip(axes, _SHOWN, strict=True):
        for k, split in enumerate(splits):
            outcomes = comparison.on(split)
            values = [outcome.estimates[name] for outcome in outcomes]
            point = np.array([value.iqm for value in values])
            ends = np.abs(np.array([[value.low for value in values], [value.high for value in values]]) - point)
            height = [rows[outcome.method.name] + 0.24 * ((len(splits) - 1) / 2 - k) for outcome in outcomes]
            axis.errorbar(point, height, xerr=ends, fmt="os"[k % 2], color=COLOURS[k], ms=4.5, capsize=2.5, label=split)
        title, unit = COLUMNS[name]
        axis.set_xlabel(title if unit == "-" else f"{title} ({unit})")
        axis.set_xscale("log")
        axis.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.xaxis.set_major_formatter("{x:g}")
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.grid(axis="x", which="both", alpha=0.3)
        axis.grid(axis="y", alpha=0.15)
    axes[0].set_yticks(range(len(rows)), list(rows))
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(splits), frameon=False)
    return figure
