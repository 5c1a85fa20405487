"""SVG of Matplotlib figures for a page: colours follow its light or dark theme, element names do not clash."""

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
from matplotlib.figure import Figure

from eval.report.style import COLOURS

INK = "#010203"  # stands for the page's colour of text
MUTED = "#7f7f7e"  # of what is in the background
SHADE = "#eeeeed"  # of an area in the background
GROUND = "#fefefd"  # stands for the page's own
STYLES = ("-", (0, (5, 1.5)), (0, (1, 1.2)), (0, (6, 1.5, 1, 1.5)), (0, (3, 1, 1, 1, 1, 1)), (0, (8, 3)))
"""Of the lines of methods, beside their colours."""
WIDTH = 4.2  # of a panel [in]

_NAMED = "method-"  # begins the name of a line, which the page shows to a pointer that rests on it
_THEMED = {INK: "currentColor", MUTED: "var(--muted)", SHADE: "var(--shade)", GROUND: "var(--ground)"}
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


def faint(method: str) -> dict[str, Any]:
    """Style of a method's line in the background."""
    return {"color": MUTED, "lw": 0.8, "alpha": 0.8, "gid": f"{_NAMED}{method}"}


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
    text = re.sub(r"#[0-9a-f]{6}\b", lambda found: _THEMED.get(found[0], found[0]), text)
    text = re.sub(rf'<g id="{name}-{_NAMED}([^"]+)">', r"\g<0><title>\1</title>", text)
    width, height = re.findall(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', text)[0]
    opening = f'<svg viewBox="0 0 {width} {height}" role="img" aria-label="{escape(alt, quote=True)}">'
    return Panel(re.sub(r"<svg[^>]*>", lambda _: opening, text, count=1), title)
