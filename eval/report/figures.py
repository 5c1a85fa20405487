"""Pictures of the numbers: paired differences, performance profiles, robustness maps."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.ticker import FuncFormatter, SymmetricalLogLocator

from eval.comparison.results import Comparison, profiles
from eval.comparison.statistics import tail_mean
from eval.report.scenes import Map
from eval.report.style import mark_one_two_five
from eval.report.svg import GROUND, INK, WIDTH, Panel, colour_of, faint, line, panel, panel_style
from eval.report.text import cell

STRONGEST = 4
"""Ratio of a map's strongest colour, in all maps, so that they can be compared."""
_MARKERS = {"classical": "o", "learned": "s", "added": "D"}


def forests(comparison: Comparison, colours: dict[str, str]) -> list[Panel]:
    """Differences in cost from the best classical controller, split by split."""
    with panel_style():
        return [_forest(comparison, split, colours) for split in comparison.splits() if comparison.against_best[split]]


def _forest(comparison: Comparison, split: str, colours: dict[str, str]) -> Panel:
    best = comparison.best_classical(split)
    assert best is not None
    pairs = comparison.against_best[split]
    shown = [outcome for outcome in comparison.on(split) if outcome.method.name in pairs]
    order = [outcome.method.name for outcome in shown]
    costs = best.metrics["cost"]
    figure, axis = plt.subplots(figsize=(WIDTH, 0.85 + 0.23 * len(order)), layout="constrained")
    for height, outcome in enumerate(shown):
        method, theirs = outcome.method, outcome.metrics["cost"]
        pair, colour = pairs[method.name]["cost"], colour_of(colours, method.name)
        value = pair.difference
        ends = np.abs([[value.iqm - value.low], [value.high - value.iqm]])
        style = {"fmt": _MARKERS[method.kind], "color": colour, "ms": 5, "capsize": 2.5}
        axis.errorbar(value.iqm, height, xerr=ends, mfc=None if pair.survives else "none", **style)
        axis.plot(theirs.mean() - costs.mean(), height, marker="|", ms=11, mew=1.6, color=INK)
        axis.plot(tail_mean(theirs) - tail_mean(costs), height, marker="x", ms=5, mew=1.2, color=INK)
    axis.axvline(0, color=INK, lw=0.9)
    axis.set_yticks(range(len(order)), order)
    axis.set_ylim(len(order) - 0.3, -0.7)
    _symmetric_log(axis, 0.1 * best.estimates["cost"].iqm)
    axis.set_xlabel(f"cost minus that of {best.method.name}")
    axis.grid(axis="x")
    alt = "; ".join(f"{method} {cell('cost', pairs[method]['cost'].difference)}" for method in reversed(order))
    return panel(figure, f"forest-{split}", split, f"Difference in cost from {best.method.name} on {split}: {alt}.")


def _symmetric_log(axis: Axes, unit: float) -> None:
    """Scale an axis linearly within a power of ten near `unit`, logarithmically beyond, with room for the labels."""
    threshold = 10.0 ** np.round(np.log10(max(unit, 1e-6)))
    axis.set_xscale("symlog", linthresh=threshold, linscale=0.7)
    axis.xaxis.set_major_locator(SymmetricalLogLocator(base=10, linthresh=threshold))
    axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: _short(value)))
    axis.minorticks_off()
    low, high = axis.get_xlim()
    axis.set_xlim(min(1.3 * low, -0.4 * threshold), max(1.3 * high, 0.4 * threshold))


def _short(value: float) -> str:
    sign = "−" if value < 0 else "+" if value > 0 else ""
    size = abs(value)
    return f"{sign}{size / 1000:g}k" if size >= 1000 else f"{sign}{size:g}"


def background(comparison: Comparison, colours: dict[str, str]) -> list[str]:
    """Ranked methods without a colour, which profiles show by their number in this list, from 1."""
    return [
        outcome.method.name for outcome in comparison.methods() if outcome.ranked and outcome.method.name not in colours
    ]


def profile_panels(comparison: Comparison, colours: dict[str, str]) -> list[Panel]:
    """Share of the runs at or below a cost, split by split; methods without a colour stay in the background."""
    with panel_style():
        splits = [split for split in comparison.splits() if any(outcome.ranked for outcome in comparison.on(split))]
        return [_profile(comparison, split, colours) for split in splits]


def _profile(comparison: Comparison, split: str, colours: dict[str, str]) -> Panel:
    found = profiles([outcome for outcome in comparison.on(split) if outcome.ranked], "cost")
    figure, axis = plt.subplots(figsize=(WIDTH, 3.0), layout="constrained")
    others = background(comparison, colours)
    for number, method in enumerate(others, 1):
        if method in found.shares:
            share = 100 * found.shares[method]
            axis.plot(found.thresholds, share, **faint(method))
            height = 12 + 76 * number / (len(others) + 1)  # each at its own, so that neighbours do not cover each other
            first = np.searchsorted(share, height)
            place = np.interp(height, share[first - 1 : first + 1], np.log(found.thresholds[first - 1 : first + 1]))
            halo = {"boxstyle": "circle,pad=0.1", "fc": GROUND, "ec": "none"}
            axis.text(np.exp(place), height, str(number), color=INK, fontsize=8, ha="center", va="center", bbox=halo)
    halves = []
    for method in colours:
        if method in found.shares:
            share = found.shares[method]
            axis.plot(found.thresholds, 100 * share, lw=1.6, **line(colours, method))
            reached = found.thresholds[np.searchsorted(share, 0.5)]
            halves.append(f"{method} reaches half of its runs at a cost of {reached:.0f}")
    axis.axhline(95, color=INK, lw=0.8, ls=":")
    axis.set_xscale("log")
    mark_one_two_five(axis.xaxis)
    axis.set(xlabel="cost", ylabel="runs at or below (%)", ylim=(0, 101))
    axis.grid()
    return panel(figure, f"profile-{split}", split, f"Performance profiles on {split}: {'; '.join(halves)}.")


def map_panels(maps: list[Map], colours: dict[str, str]) -> list[Panel]:
    """Ratio of costs over two properties of the arm, in the colour of whichever method is better, and in figures."""
    with panel_style():
        return [_map(k, found, colours) for k, found in enumerate(maps)]


def _map(number: int, found: Map, colours: dict[str, str]) -> Panel:
    ratio, means = np.array(found.ratio), np.array(found.means)
    figure, axis = plt.subplots(figsize=(WIDTH, 3.3), layout="constrained")
    ends = colour_of(colours, found.challenger), "#f7f7f7", colour_of(colours, found.classical)
    shades = LinearSegmentedColormap.from_list("better", ends)
    reach = np.log2(STRONGEST)
    shade = Normalize(-reach, reach, clip=True)
    axis.imshow(np.log2(ratio), cmap=shades, norm=shade, origin="lower", aspect="auto")
    for (row, column), value in np.ndenumerate(ratio):
        red, green, blue, _ = shades(shade(np.log2(value)))
        dark = 0.3 * red + 0.6 * green + 0.1 * blue < 0.5
        style: dict[str, Any] = {"ha": "center", "color": "#ffffff" if dark else "#111111"}
        weight = "bold" if value < 1 else "normal"
        axis.text(column, row, _ratio(value), va="bottom", fontsize=9, weight=weight, **style)
        axis.text(column, row - 0.06, _ratio(float(means[row, column])), va="top", fontsize=7, **style)
    axis.set_xticks(range(len(found.x)), [f"{value:g}" for value in found.x])
    axis.set_yticks(range(len(found.y)), [f"{value:g}" for value in found.y])
    axis.set(xlabel=found.x_label, ylabel=found.y_label)
    title = f"{found.y_label.split(' (')[0]} by {found.x_label.removesuffix(' over nominal')}"
    wins = int(np.sum(ratio < 1))
    alt = f"Cost of {found.challenger} over {found.classical}, {title}: below 1 in {wins} of {ratio.size} cells, "
    return panel(figure, f"map{number}", title, alt + f"from {ratio.min():.2f} to {ratio.max():.2f}.")


def _ratio(value: float) -> str:
    return f"{value:.2f}" if value < 10 else f"{value:.0f}"
