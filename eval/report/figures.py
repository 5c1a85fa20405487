"""Pictures of the report as SVG: paired differences in cost; and of motions the error, the torque, and the spectrum.

Colours follow the page's light or dark theme, element names do not clash. `eval.report.publish` draws motions alike.
"""

import io
import re
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from html import escape
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase
from matplotlib.layout_engine import ConstrainedLayoutEngine
from scipy.signal import detrend
from scipy.signal.windows import hann

from baselines.models.linear import held_mode
from beltarm_env.arm import ArmParams
from beltarm_env.arrays import Floats
from beltarm_env.rollout import Recording
from beltarm_env.timing import CONTROL_PERIOD
from eval.comparison.schema import AGAINST
from eval.report.recordings import Scene
from eval.report.style import COLOURS
from eval.report.table import Results, estimate
from eval.report.text import cell

INK = "#010203"  # stands for the page's colour of text
MUTED = "#7f7f7e"  # of the background
SHADE = "#eeeeed"  # of an area in the background
STYLES = ("-", (0, (5, 1.5)), (0, (1, 1.2)), (0, (6, 1.5, 1, 1.5)), (0, (3, 1, 1, 1, 1, 1)), (0, (8, 3)))
"""Of the lines of methods, beside their colours."""
WIDTH = 4.2  # of a panel [in]

_MARKERS = {"classical": "o", "learned": "s", "added": "D"}
_NAMED = "method-"  # begins the name of a line, which the page shows to a pointer that rests on it
_THEMED = {INK: "currentColor", MUTED: "var(--muted)", SHADE: "var(--shade)"}
_THEMED |= {colour.lower(): f"var(--c{k})" for k, colour in enumerate(COLOURS)}
LOOK: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "beltarm",
    "font.sans-serif": ["DejaVu Sans"],  # each text of an SVG repeats the list
    "font.size": 10,
    **dict.fromkeys("text.color xtick.color ytick.color axes.edgecolor axes.labelcolor axes.titlecolor".split(), INK),
    "grid.color": MUTED,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "path.simplify_threshold": 0.2,
}
"""Style of all figures of the page."""


def colours_of(results: Results, scenes: Sequence[Scene]) -> dict[str, str]:
    """Colours of methods: those whose motion is shown, or else the best challenger and the best classical one."""
    shown = {method for scene in scenes for method in scene.motions}
    shown = shown or {*(results.of_kind("learned") or results.of_kind("added"))[:1], *results.of_kind("classical")[:1]}
    return dict(zip([row["method"] for row in results.methods if row["method"] in shown], COLOURS, strict=False))


def line(colours: dict[str, str], method: str) -> dict[str, Any]:
    """Style of a method's line: colour and dashes, so that either alone tells methods apart, and its name."""
    style = STYLES[list(colours).index(method)]
    return {"lw": 1.3, "color": colours[method], "ls": style, "gid": f"{_NAMED}{method}", "label": method}


class Panel(NamedTuple):
    """Picture of the page."""

    svg: str
    title: str


def panel(figure: Figure, name: str, title: str, alt: str) -> Panel:
    """Render a figure as SVG, and close it; `name` is before all identifiers, `alt` is for those who do not see it."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    plt.close(figure)
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.S)
    text = re.sub(r' d="[^"]*"', lambda path: re.sub(r"(\.\d\d)\d+", r"\1", path[0]), text)  # a hundredth of a pixel
    text = re.sub(r'(\bid="|url\(#|href="#)', rf"\g<1>{name}-", text)
    text = re.sub(r"#[0-9a-f]{6}\b", lambda colour: _THEMED.get(colour[0], colour[0]), text)
    text = re.sub(rf'<g id="{name}-{_NAMED}([^"]+)">', r"\g<0><title>\1</title>", text)
    said = f'role="img" aria-label="{escape(alt, quote=True)}"'
    text = re.sub(r'<svg[^>]*(viewBox="[^"]*")[^>]*>', lambda opening: f"<svg {opening[1]} {said}>", text, count=1)
    return Panel(text, title)


def forests(results: Results, colours: dict[str, str]) -> list[Panel]:
    """Differences in cost from the best classical controller, split by split."""
    of_splits = {split: results.against(AGAINST[0], split) for split in results.splits}
    with plt.rc_context(LOOK):
        return [_forest(results, split, against, colours) for split, against in of_splits.items() if against]


def _forest(results: Results, split: str, against: dict[str, dict[str, Any]], colours: dict[str, str]) -> Panel:
    best = results.records[results.best_classical(split) or "", split]
    pairs = {name: estimate(pair, "cost") for name, pair in against.items()}
    figure, axis = plt.subplots(figsize=(WIDTH, 0.85 + 0.23 * len(pairs)), layout="constrained")
    for height, (name, pair) in enumerate(pairs.items()):
        row, colour = results.records[name, split], colours.get(name, MUTED)
        ends = np.abs([[pair.iqm - pair.low], [pair.high - pair.iqm]])
        style = {"fmt": _MARKERS[row["kind"]], "color": colour, "ms": 5, "capsize": 2.5}
        axis.errorbar(pair.iqm, height, xerr=ends, mfc=None if pair.p_holm < 0.05 else "none", **style)
        for average, mark in (("cost_mean", {"marker": "|", "ms": 11}), ("cost_worst", {"marker": "x", "ms": 5})):
            axis.plot(row.get(average, np.nan) - best.get(average, np.nan), height, mew=1.4, color=INK, **mark)
    axis.axvline(0, color=INK, lw=0.9)
    axis.set_yticks(range(len(pairs)), list(pairs))
    axis.set_ylim(len(pairs) - 0.3, -0.7)
    _symmetric_log(axis, 0.1 * estimate(best, "cost").iqm)
    axis.set_xlabel(f"cost minus that of {best['method']}")
    axis.grid(axis="x")
    alt = "; ".join(f"{name} {cell('cost', pair)}" for name, pair in reversed(pairs.items()))
    return panel(figure, f"forest-{split}", split, f"Difference in cost from {best['method']} on {split}: {alt}.")


def _symmetric_log(axis: Axes, unit: float) -> None:
    """Scale an axis linearly within a power of ten near `unit`, logarithmically beyond, with room for the labels."""

    def short(value: float, _: float) -> str:
        size, sign = abs(value), "−" if value < 0 else "+" if value > 0 else ""
        return f"{sign}{size / 1000:g}k" if size >= 1000 else f"{sign}{size:g}"

    threshold = 10.0 ** np.round(np.log10(max(unit, 1e-6)))
    axis.set_xscale("symlog", linthresh=threshold, linscale=0.7)
    axis.xaxis.set_major_formatter(short)
    axis.minorticks_off()
    low, high = axis.get_xlim()
    axis.set_xlim(min(1.3 * low, -0.4 * threshold), max(1.3 * high, 0.4 * threshold))


# Motions

Run = tuple[Recording, dict[str, Any]]
"""Motion with the style of its method's line."""
Draw = Callable[[FigureBase, list[Run]], Iterable[float]]
"""Draws some runs; returns the numbers that the alternative text names, one for each."""
_EVERY = 3  # samples; 4.5 ms are finer than a line on the page
_START_S = 0.15  # in which a motor breaks away and its load speeds up
_PADDED = 8192  # samples of a spectrum, most of them zeros: interpolates, does not resolve
_HIGHEST_HZ = 25.0


def runs_of(scene: Scene, colours: dict[str, str]) -> list[Run]:
    """Motions of a scene in the order of the colours."""
    return [(scene.motions[name], line(colours, name)) for name in colours if name in scene.motions]


def scene_panels(scene: Scene, number: int, colours: dict[str, str]) -> list[Panel]:
    """Pictures of one scene."""
    drawn: list[tuple[str, str, Draw]] = [
        ("error of the arm's end", "largest in mm", tip_error),
        (f"torque, first {_START_S:g} s", "largest in N m", partial(torque, end=_START_S)),
        ("torque after the move", "largest in N m", _torque_at_rest),
        ("spectrum after the move", "peak in mm", _spectrum),
    ]
    runs, made = runs_of(scene, colours), []
    with plt.rc_context(LOOK):
        for part, (title, unit, draw) in enumerate(drawn):
            figure = plt.figure(figsize=(WIDTH, 2.7), layout=ConstrainedLayoutEngine(hspace=0, h_pad=0.01))
            values = zip(runs, draw(figure, runs), strict=True)
            said = ", ".join(f"{style['label']} {value:.3g}" for (_, style), value in values)
            alt = f"{title} on scenario {scene.scenario} of {scene.split}, {unit}: {said}."
            made.append(panel(figure, f"scene{number}-{part}", title, alt))
    return made


def tip_error(figure: FigureBase, runs: list[Run]) -> list[float]:
    """Draw the size of the error of the arm's end over time; returns the largest [mm]."""
    axis = figure.subplots()
    errors = [1000 * np.linalg.norm(motion.tip_error[:, 0], axis=1) for motion, _ in runs]
    for (motion, style), error in zip(runs, errors, strict=True):
        axis.plot(motion.time[::_EVERY], np.maximum(error[::_EVERY], 1e-3), **style)
    first, _ = runs[0]
    duration = first.moves[0, 2]
    axis.axvspan(0, duration, color=SHADE, zorder=0, lw=0)
    axis.text(duration / 2, 1.01, "move", transform=axis.get_xaxis_transform(), ha="center", color=MUTED)
    axis.set(xlabel="time (s)", xlim=(0, first.time[-1]), ylabel="error (mm)", yscale="log")
    axis.set_ylim(bottom=max(axis.get_ylim()[0], 0.01))
    axis.grid()
    return [float(error.max()) for error in errors]


def tip_after(figure: FigureBase, runs: list[Run]) -> list[float]:
    """Draw both components of the error of the arm's end after the move; it has no numbers to return."""
    axes: list[Axes] = list(figure.subplots(2, 1, sharex=True))
    for component, (axis, name) in enumerate(zip(axes, ("radial", "lateral"), strict=True)):
        for motion, style in runs:
            duration = motion.moves[0, 2]
            after = motion.time >= duration
            axis.plot(motion.time[after] - duration, 1000 * motion.tip_error[after, 0, component], **style)
        axis.axhline(0, color=MUTED, lw=0.8)
        axis.set_ylabel(f"{name} error\n(mm)")
        axis.grid()
    axes[1].set_xlabel("time since the end of the move (s)")
    return []


def torque(figure: FigureBase, runs: list[Run], end: float | None = None) -> list[float]:
    """Draw the torques up to a time, by default all, one over the other; returns the largest [N m]."""
    axis = figure.subplots()
    end = float(runs[0][0].time[-1]) if end is None else end
    axis.axhline(0, color=MUTED, lw=0.8)
    axis.set(xlabel="time (s)", xlim=(0, end), ylabel="torque (N m)")
    axis.grid()
    return [_draw_torque(axis, run, 0.0, end) for run in runs]


def _torque_at_rest(figure: FigureBase, runs: list[Run]) -> list[float]:
    """Draw the torques after the move, one below the other: they would cover each other."""
    axes: list[Axes] = list(figure.subplots(len(runs), 1, sharex=True, sharey=True, squeeze=False)[:, 0])
    largest = []
    for axis, run in zip(axes, runs, strict=True):
        motion, style = run
        first, last = float(motion.moves[0, 2]), float(motion.time[-1])
        largest.append(_draw_torque(axis, run, first, last))
        axis.axhline(0, color=MUTED, lw=0.8)
        axis.text(1.01, 0.5, style["label"], transform=axis.transAxes, va="center", fontsize=9)
        axis.set_xlim(0, last - first)
        axis.spines.bottom.set_visible(axis is axes[-1])
        axis.tick_params(bottom=axis is axes[-1])
    highest = max(*largest, 1e-3)
    power = 10.0 ** np.floor(np.log10(highest))
    axes[0].set(ylim=(-1.1 * highest, 1.1 * highest), yticks=[0, np.floor(highest / power) * power])
    axes[-1].set_xlabel("time since the end of the move (s)")
    figure.supylabel("torque (N m)", fontsize=10)
    return largest


def _draw_torque(axis: Axes, run: Run, begin: float, end: float) -> float:
    """Draw a torque over the time since `begin`; a command is held over the sample that ends at its time."""
    motion, style = run
    shown = (motion.time > begin) & (motion.time <= end + CONTROL_PERIOD)
    values = motion.torque[shown, 0]
    axis.plot(motion.time[shown] - begin, values, drawstyle="steps-pre", **style)
    return float(np.abs(values).max())


def _spectrum(figure: FigureBase, runs: list[Run]) -> list[float]:
    axis, peaks = figure.subplots(), []
    for motion, style in runs:
        hertz, amplitude = spectrum(motion)
        shown = hertz <= _HIGHEST_HZ
        axis.plot(hertz[shown], amplitude[shown], **style)
        peaks.append(float(amplitude.max()))
    arm = ArmParams.from_row(runs[0][0].params[0])
    mode = float(1 / held_mode(runs[0][0].moves[0, 1], arm.plant()).period)  # at the goal, with the motor held [Hz]
    axis.axvline(mode, color=MUTED, ls=":", lw=1.2)
    label = f"mode: {mode:.1f} Hz, {2 * np.pi * mode:.0f} rad/s"
    beside = "left" if mode < 0.3 * _HIGHEST_HZ else "center"
    axis.text(mode, 1.01, label, transform=axis.get_xaxis_transform(), ha=beside, color=MUTED)
    axis.set(xlabel="frequency (Hz)", ylabel="amplitude (mm)", xlim=(0, _HIGHEST_HZ), ylim=(0, None))
    axis.grid()
    return peaks


def spectrum(recording: Recording) -> tuple[Floats, Floats]:
    """Frequencies [Hz] and amplitudes [mm] of the tip's vibration after the move, each of shape (n,).

    Both components of the tip error from the move's end on are detrended and windowed (Hann), then taken together. A
    sine of amplitude a gives a peak of height a. Resolution: about 2 / (time after the move), 2 to 3 Hz.
    """
    after = recording.time > recording.moves[0, 2]
    motion = detrend(1000 * recording.tip_error[after, 0], axis=0)
    window = hann(len(motion), sym=False)[:, None]
    lines = 2 * np.abs(np.fft.rfft(motion * window, _PADDED, axis=0)) / window.sum()
    hertz = np.arange(len(lines)) / (_PADDED * CONTROL_PERIOD)
    return hertz, np.sqrt(np.sum(lines**2, axis=1))
