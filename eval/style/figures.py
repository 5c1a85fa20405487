"""Matplotlib figures as files, drawn without a display."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from baselines.tools.files import write_atomically


def save_figure(figure: Figure, path: Path, dpi: int = 120, **options: Any) -> None:
    """Write a figure atomically, and close it; further options are those of `Figure.savefig`.

    Raises:
        OSError: If the file cannot be written.
    """
    write_atomically(path, lambda temporary: figure.savefig(temporary, dpi=dpi, **options))
    plt.close(figure)


def save_figures(figures: Mapping[str, Callable[[], Figure]], folder: Path, **options: Any) -> list[Path]:
    """Draw figures one after the other into files of `folder`, by name; arguments and errors as of `save_figure`."""
    for name, draw in figures.items():
        save_figure(draw(), folder / name, **options)
    return [folder / name for name in figures]
