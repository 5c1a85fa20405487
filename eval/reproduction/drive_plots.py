"""Pictures of the paper's servo on the drive as it is built."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from eval.comparison.effects import ALL, IDEAL, heading
from eval.report.style import BLUE, GREEN, ORANGE, PINK, mark_one_two_five, save_figures
from eval.reproduction.drive_page import PICTURES
from eval.reproduction.drives import DRIVES, DrivesStudy
from eval.reproduction.ringing import PHASES, REDUCED, REMOVED
from eval.reproduction.study import AS_ANALYSED, FRICTION, STANDARD

_TITLES = {IDEAL: "ideal drive", ALL: "all effects of the drive"}


def save_drive_pictures(study: DrivesStudy, folder: Path) -> list[Path]:
    """Draw the pictures into `folder`, each atomically.

    Raises:
        OSError: If the folder cannot be written to.
    """
    swings, ratios = PICTURES
    figures = {swings: lambda: _swings(study), ratios: lambda: _ratios(study)}
    return save_figures(figures, folder, dpi=100, pil_kwargs={"optimize": True})


def _swings(study: DrivesStudy) -> Figure:
    """Velocity of the tip against a rigid arm on the reference, over time: ideal drive above, all effects below."""
    figure, axes = plt.subplots(2, 2, figsize=(9, 5.2), layout="constrained", sharex=True, sharey=True)
    stop = study.moves[STANDARD].duration
    for row, drive in zip(axes, _TITLES, strict=True):
        swings = study.found[STANDARD, FRICTION, drive].swings
        for axis, signal, colour, k4 in zip(
            row, (swings.without, swings.suppressed), (ORANGE, BLUE), (0.0, study.gains.k4), strict=True
        ):
            axis.axvspan(0, stop, color="#F0F0F0", zorder=0)
            if drive == IDEAL:  # all of them are one
                axis.plot(swings.time, signal[:, 0], color=colour, lw=1.4)
            else:
                axis.plot(swings.time, signal, color=colour, lw=0.7, alpha=0.8)
            axis.set_title(f"K4 = {k4:g}, {_TITLES[drive]}", fontsize=11)
            axis.grid(alpha=0.3)
            axis.set_xlim(0, swings.time[-1])
        row[0].set_ylabel("tip velocity less a\nrigid arm's, along x (m/s)")
    for axis in axes[-1]:
        axis.set_xlabel("time (s); grey: the move")
    return figure


def _ratios(study: DrivesStudy) -> Figure:
    """Ratio of ringing with to without vibration feedback, a row for each effect, a mark for each drive."""
    figure, axes = plt.subplots(1, 2, figsize=(9, 5.2), layout="constrained", sharex=True, sharey=True)
    for axis, phase in zip(axes, ("stop", "end"), strict=True):
        for view, colour, marker, shift in ((AS_ANALYSED, GREEN, "o", -0.17), (FRICTION, PINK, "D", 0.17)):
            for k, drive in enumerate(DRIVES):
                ratios = study.found[STANDARD, view, drive].ringing.ratios(phase)
                ratios = ratios[np.isfinite(ratios)]
                label = view if k == 0 else None
                axis.scatter(
                    ratios,
                    np.full(len(ratios), k + shift),
                    color=colour,
                    marker=marker,
                    s=16,
                    alpha=0.6,
                    lw=0,
                    label=label,
                )
                if len(ratios):
                    axis.plot([np.median(ratios)] * 2, [k + shift - 0.16, k + shift + 0.16], color="black", lw=1.3)
        for k in range(1, len(DRIVES)):
            axis.axhline(k - 0.5, color="0.88", lw=0.8)
        for bound in (REMOVED, REDUCED):
            axis.axvline(bound, color="0.4", lw=1, ls=":")
        axis.axvline(1, color="0.4", lw=1)
        axis.set(xscale="log", title=PHASES[phase], xlabel=f"ringing with K4 = {study.gains.k4:g} over that with 0")
        mark_one_two_five(axis.xaxis)
        axis.xaxis.set_minor_locator(NullLocator())
    axes[0].set_yticks(range(len(DRIVES)), [heading(drive) for drive in DRIVES], fontsize=9)
    axes[0].set_ylim(len(DRIVES) - 0.5, -0.5)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    return figure
