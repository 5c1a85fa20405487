"""Colours, axes, panels and legends of pictures, and figures as files, drawn without a display."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter
from PIL import Image

from baselines.tools.files import write_atomically

matplotlib.use("Agg")

COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9")
BLUE, ORANGE, GREEN, PINK, VERMILION, SKY = COLOURS
OF_KIND = {"classical": BLUE, "learned": ORANGE, "added": GREEN, "privileged": "0.55"}
"""Of a method of the comparison, by its kind."""


class _OneTwoFive(LogLocator):
    """1, 2 and 5 times the powers of ten; round numbers where an axis is so short that it may have but one of those."""

    def tick_values(self, vmin: float, vmax: float) -> Sequence[float]:
        short = vmax < 5 * vmin
        return MaxNLocator(4, steps=[1, 2, 5, 10]).tick_values(vmin, vmax) if short else super().tick_values(vmin, vmax)


def mark_one_two_five(axis: Axis) -> None:
    """Name 1, 2 and 5 times the powers of ten on a logarithmic axis, or a few round numbers on a short one."""
    axis.set_major_locator(_OneTwoFive(subs=(1, 2, 5)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def save_figure(figure: Figure, path: Path, dpi: int = 120, **options: Any) -> None:
    """Write a figure atomically, and close it; further options are those of `Figure.savefig`.

    A PNG has 256 colours: a third of the size, and no difference that one sees in a drawing.

    Raises:
        OSError: If the file cannot be written.
    """
    write_atomically(path, lambda temporary: _save(figure, temporary, dpi=dpi, **options))
    plt.close(figure)


def _save(figure: Figure, path: Path, **options: Any) -> None:
    figure.savefig(path, **options)
    if path.suffix == ".png":
        with Image.open(path) as picture:
            few = picture.convert("RGB").quantize(256, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
        few.save(path, optimize=True)


def save_figures(figures: Mapping[str, Callable[[], Figure]], folder: Path, **options: Any) -> None:
    """Draw figures one after the other into files of `folder`, by name; arguments and errors as of `save_figure`."""
    for name, draw in figures.items():
        save_figure(draw(), folder / name, **options)


def panels(count: int, across: int, size: tuple[float, float], **options: Any) -> tuple[Figure, list[Axes]]:
    """Make a figure with some panels of a size [in], of which a row holds `across`."""
    across = min(across, count)
    down = -(-count // across)
    figure, grid = plt.subplots(
        down, across, figsize=(size[0] * across, size[1] * down), layout="constrained", squeeze=False, **options
    )
    for axis in list(grid.flat)[count:]:
        axis.set_visible(False)
    return figure, list(grid.flat)[:count]


def name_rows(axis: Axes, names: Sequence[str]) -> None:
    """Name rows from top to bottom, at heights 0, 1, ..., with a grid behind them."""
    axis.set_yticks(range(len(names)), names)
    axis.set_ylim(len(names) - 0.5, -0.5)
    axis.grid(axis="x", color="0.9", lw=0.6)
    axis.set_axisbelow(True)
    axis.spines[["top", "right"]].set_visible(False)


def below(figure: Figure, axis: Axes, columns: int, **options: Any) -> None:
    """Put the legend of one panel below all of them."""
    entries = axis.get_legend_handles_labels()
    figure.legend(*entries, loc="outside lower center", frameon=False, ncols=columns, **options)


def damping_lines(axis: Axes, *ratios: float) -> None:
    """Draw lines of equal damping ratio in the left half plane of poles, and its border."""
    for ratio in ratios:
        axis.axline((0, 0), slope=-np.sqrt(1 - ratio**2) / ratio, color="0.75", lw=0.8, ls="--", zorder=1)
    axis.axvline(0, color="0.4", lw=0.9)
