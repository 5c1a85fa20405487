"""Pictures of a comparison beside its page: motions on every split, and all intervals."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from beltarm_env.arrays import Floats
from beltarm_env.metrics import heading
from beltarm_env.rollout import Recording
from eval.report.recordings import Traces
from eval.report.style import BLUE, COLOURS, OF_KIND, mark_one_two_five
from eval.report.table import Record, Results, estimate

_MOVE_SHADE = "#EEEEEE"
_SHOWN = ("tip_rms_mm", "tip_max_mm", "residual_pp_mm", "cost")
_ACROSS = 3  # splits side by side
Quantity = Callable[[Recording], Floats]


def plots(results: Results, traces: Traces) -> dict[str, Callable[[], Figure]]:
    """Recipes of all pictures, by the names of their files."""
    shown = dict.fromkeys(name for methods in traces.values() for name in methods)
    colours: dict[str, str] = dict(zip(shown, COLOURS, strict=False))
    of_traces: dict[str, Callable[[], Figure]] = {
        "tip_error.png": partial(_time_plot, traces, colours, _tip_error, "tip error (mm)"),
        "residual.png": partial(_residual_plot, traces, colours),
        "torque.png": partial(_time_plot, traces, colours, _torque, "torque command (N m)"),
    }
    caption = f"Scenarios of the {results.label.title}"
    figures = {name: partial(_captioned, draw, caption) for name, draw in of_traces.items()} if traces else {}
    how = "interquartile means with 95 % intervals; further left is better"
    return {**figures, "intervals.png": partial(_captioned, partial(_intervals, results), f"{caption}: {how}")}


def _captioned(draw: Callable[[], Figure], caption: str) -> Figure:
    figure = draw()
    figure.suptitle(caption, fontsize=10, color="0.4")
    return figure


def _grid(count: int, height: float, rows: int = 1) -> tuple[Figure, list[list[Axes]]]:
    """Figure with `rows` axes, one below the other, for each of `count` splits."""
    across = min(count, _ACROSS)
    down = -(-count // across)
    figure, axes = plt.subplots(
        down * rows, across, figsize=(4.0 * across, height * down * rows + 0.5), layout="constrained", squeeze=False
    )
    for unused in range(count, down * across):
        for row in range(rows):
            axes[rows * (unused // across) + row][unused % across].set_axis_off()
    return figure, [[axes[rows * (k // across) + row][k % across] for row in range(rows)] for k in range(count)]


def _tip_error(recording: Recording) -> Floats:
    return 1000 * np.linalg.norm(recording.tip_error[:, 0], axis=1)


def _torque(recording: Recording) -> Floats:
    return recording.torque[:, 0]


def _mark_move(axis: Axes, duration: float) -> None:
    axis.axvspan(0, duration, color=_MOVE_SHADE, zorder=0)
    axis.text(duration / 2, 0.98, "move", transform=axis.get_xaxis_transform(), ha="center", va="top", color="0.45")


def _describe(recording: Recording) -> str:
    start, goal = np.degrees(recording.moves[0, :2])
    return f"{start:.0f}° to {goal:.0f}°"


def _legend(figure: Figure, axes: list[Axes], columns: int, **options: Any) -> None:
    entries = {}
    for axis in axes:
        entries.update(dict(zip(*reversed(axis.get_legend_handles_labels()), strict=True)))
    order = list(OF_KIND)
    if all(label in order for label in entries):
        entries = {label: entries[label] for label in sorted(entries, key=order.index)}
    options = {"loc": "outside lower center", "ncols": columns, "frameon": False} | options
    figure.legend(list(entries.values()), list(entries), **options)


def _time_plot(traces: Traces, colours: dict[str, str], quantity: Quantity, label: str) -> Figure:
    figure, axes = _grid(len(traces), 3.0)
    for (axis,), (split, methods) in zip(axes, traces.items(), strict=True):
        for method, recording in methods.items():
            axis.plot(recording.time, quantity(recording), color=colours[method], lw=1.2, label=method)
        recording = next(iter(methods.values()))
        axis.margins(y=0.12)
        _mark_move(axis, recording.moves[0, 2])
        axis.set(xlabel="time (s)", ylabel=label, xlim=(0, recording.time[-1]))
        axis.set_title(f"{split}: median scenario, {_describe(recording)}", fontsize=10)
        axis.grid(alpha=0.3)
    _legend(figure, [axis for (axis,) in axes], len(colours))
    return figure


def _residual_plot(traces: Traces, colours: dict[str, str]) -> Figure:
    figure, axes = _grid(len(traces), 2.2, rows=2)
    for pair, (split, methods) in zip(axes, traces.items(), strict=True):
        for method, recording in methods.items():
            duration = recording.moves[0, 2]
            after = recording.time >= duration
            for row, axis in enumerate(pair):
                motion = 1000 * recording.tip_error[after, 0, row]
                axis.plot(recording.time[after] - duration, motion, color=colours[method], lw=1.2, label=method)
        pair[0].set_title(f"{split}: after the move, {_describe(next(iter(methods.values())))}", fontsize=10)
        pair[0].set_ylabel("radial tip\nerror (mm)")
        pair[1].set(ylabel="lateral tip\nerror (mm)", xlabel="time since the move's end (s)")
        for axis in pair:
            axis.grid(alpha=0.3)
            axis.axhline(0, color="0.6", lw=0.8)
    _legend(figure, [pair[0] for pair in axes], len(colours))
    return figure


def _intervals(results: Results) -> Figure:
    """Interquartile means with their intervals: a row of axes per split, best at the top, what is not ranked below."""
    count = len(results.methods)
    figure, axes = plt.subplots(
        len(results.splits),
        len(_SHOWN),
        figsize=(3.0 * len(_SHOWN), (0.9 + 0.19 * count) * len(results.splits) + 0.6),
        layout="constrained",
        squeeze=False,
    )
    for row, split in zip(axes, results.splits, strict=True):
        ranking = sorted(results.on(split), key=lambda r: (r["kind"] != "privileged", -estimate(r, "cost").iqm))
        best = results.records.get((results.best_classical(split) or "", split))
        for axis, name in zip(row, _SHOWN, strict=True):
            _interval_axis(axis, ranking, name)
            if best and np.isfinite(estimate(best, name).iqm):
                axis.axvline(estimate(best, name).iqm, color=BLUE, lw=0.8, ls=":")
            axis.set_xlabel(heading(name))
            axis.set_yticks([])
        row[0].set_yticks(range(len(ranking)), [record["method"] for record in ranking], fontsize=8)
        row[0].set_title(split, loc="left", fontsize=11)
    _legend(figure, [axis for row in axes for axis in row], 4)
    return figure


def _interval_axis(axis: Axes, ranking: list[Record], name: str) -> None:
    for kind in dict.fromkeys(record["kind"] for record in ranking):
        heights = [height for height, record in enumerate(ranking) if record["kind"] == kind]
        values = [estimate(ranking[height], name) for height in heights]  # not numbers where no arm arrives
        ends = np.abs([[value.iqm - value.low for value in values], [value.high - value.iqm for value in values]])
        middles, colour = [value.iqm for value in values], OF_KIND[kind]
        axis.errorbar(middles, heights, xerr=ends, fmt="o", color=colour, ms=4, capsize=2, label=kind)
    unranked = sum(record["kind"] == "privileged" for record in ranking)
    if unranked:
        axis.axhline(unranked - 0.5, color="0.55", lw=0.8)
    axis.set_xscale("log")
    mark_one_two_five(axis.xaxis)
    axis.set_ylim(-0.7, len(ranking) - 0.3)
    axis.grid(axis="x", which="both", alpha=0.3)
    axis.tick_params(labelsize=8)
