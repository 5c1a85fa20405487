"""SVG pictures of the report: colours follow the page's light or dark theme, element names do not clash.

Also the picture of the paired differences in cost; `eval.report.motions` has those of single runs.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from html import escape
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, SymmetricalLogLocator

from eval.comparison.schema import AGAINST
from eval.report.content import Results, difference, estimate
from eval.report.style import COLOURS
from eval.report.text import cell

INK = "#010203"  # stands for the page's colour of text
MUTED = "#7f7f7e"  # of what is in the background
SHADE = "#eeeeed"  # of an area in the background
STYLES = ("-", (0, (5, 1.5)), (0, (1, 1.2)), (0, (6, 1.5, 1, 1.5)), (0, (3, 1, 1, 1, 1, 1)), (0, (8, 3)))
"""Of the lines of methods, beside their colours."""
WIDTH = 4.2  # of a panel [in]

_MARKERS = {"classical": "o", "learned": "s", "added": "D"}
_NAMED = "method-"  # begins the name of a line, which the page shows to a pointer that rests on it
_THEMED = {INK: "currentColor", MUTED: "var(--muted)", SHADE: "var(--shade)"}
_THEMED |= {colour.lower(): f"var(--c{k})" for k, colour in enumerate(COLOURS)}
_LOOK: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "beltarm",
    "font.sans-serif": ["DejaVu Sans"],  # each text of an SVG repeats the list
    "font.size": 10,
    "text.color": INK,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "grid.color": MUTED,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.unicode_minus": True,
    "path.simplify_threshold": 0.2,
}


def line(colours: dict[str, str], method: str) -> dict[str, Any]:
    """Style of a method's line: colour and dashes, so that either alone tells methods apart, and its name."""
    return {"color": colours[method], "ls": STYLES[list(colours).index(method)], "gid": f"{_NAMED}{method}"}


def colour_of(colours: dict[str, str], method: str) -> str:
    """Colour of a method's marks, in every picture the same; grey for one that has no colour of its own."""
    return colours.get(method, MUTED)


@dataclass(frozen=True, slots=True)
class Panel:
    """Picture of the page."""

    svg: str
    title: str


@contextmanager
def panel_style() -> Iterator[None]:
    """Apply the page's style to all figures drawn within."""
    with matplotlib.rc_context(_LOOK):
        yield


def panel(figure: Figure, name: str, title: str, alt: str) -> Panel:
    """Render a figure as SVG.

    Args:
        figure: What is drawn; closed afterwards.
        name: Distinguishes its parts from those of other pictures on the page.
        title: Shown above.
        alt: What it shows, for those who do not see it.
    """
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
    width, height = re.findall(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', text)[0]
    opening = f'<svg viewBox="0 0 {width} {height}" role="img" aria-label="{escape(alt, quote=True)}">'
    return Panel(re.sub(r"<svg[^>]*>", lambda _: opening, text, count=1), title)


def forests(results: Results, colours: dict[str, str]) -> list[Panel]:
    """Differences in cost from the best classical controller, split by split."""
    with panel_style():
        return [_forest(results, split, colours) for split in results.splits if results.against(AGAINST[0], split)]


def _forest(results: Results, split: str, colours: dict[str, str]) -> Panel:
    best = results.records[results.best_classical(split) or "", split]
    pairs = {name: difference(pair, "cost") for name, pair in results.against(AGAINST[0], split).items()}
    figure, axis = plt.subplots(figsize=(WIDTH, 0.85 + 0.23 * len(pairs)), layout="constrained")
    for height, (name, pair) in enumerate(pairs.items()):
        assert pair is not None
        row, colour = results.records[name, split], colour_of(colours, name)
        ends = np.abs([[pair.iqm - pair.low], [pair.high - pair.iqm]])
        style = {"fmt": _MARKERS[row["kind"]], "color": colour, "ms": 5, "capsize": 2.5}
        axis.errorbar(pair.iqm, height, xerr=ends, mfc=None if pair.p_holm < 0.05 else "none", **style)
        axis.plot(_beyond(row, best, "cost_mean"), height, marker="|", ms=11, mew=1.6, color=INK)
        axis.plot(_beyond(row, best, "cost_worst"), height, marker="x", ms=5, mew=1.2, color=INK)
    axis.axvline(0, color=INK, lw=0.9)
    axis.set_yticks(range(len(pairs)), list(pairs))
    axis.set_ylim(len(pairs) - 0.3, -0.7)
    _symmetric_log(axis, 0.1 * estimate(best, "cost").iqm)
    axis.set_xlabel(f"cost minus that of {best['method']}")
    axis.grid(axis="x")
    alt = "; ".join(f"{name} {cell('cost', pair)}" for name, pair in reversed(pairs.items()))
    return panel(figure, f"forest-{split}", split, f"Difference in cost from {best['method']} on {split}: {alt}.")


def _beyond(row: dict[str, float], best: dict[str, float], average: str) -> float:
    return row.get(average, np.nan) - best.get(average, np.nan)


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
