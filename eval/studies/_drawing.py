"""What pictures of several studies have in common."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure


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
    figure.legend(
        *axis.get_legend_handles_labels(), loc="outside lower center", frameon=False, ncols=columns, **options
    )


def damping_lines(axis: Axes, *ratios: float) -> None:
    """Draw lines of equal damping ratio in the left half plane of poles, and its border."""
    for ratio in ratios:
        axis.axline((0, 0), slope=-np.sqrt(1 - ratio**2) / ratio, color="0.75", lw=0.8, ls="--", zorder=1)
    axis.axvline(0, color="0.4", lw=0.9)
