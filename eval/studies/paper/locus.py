"""Pictures of the linear analysis: root loci, Fig. 6, and the map of the dominant damping."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eval.report.style import VERMILION
from eval.studies.paper.linear import (
    GAIN_RANGES,
    PAPER_ARM,
    Floats,
    Poles,
    ServoGains,
    closed_loop,
    damping_map,
    k4_locus,
    natural_frequency_locus,
    nominal_m2,
    poles,
)

_POINTS = 241
_LAST_LABEL = 0.5  # contours of higher damping are too close together for labels
_GRID_DAMPING = (0.1, 0.3, 0.6)


def locus_picture(gains: ServoGains, angle_deg: float) -> Figure:
    """Root loci over K_4 and over omega_n at one joint angle, the poles at the gains given marked."""
    angle = np.radians(angle_deg)
    k4 = np.linspace(0, _up_to("k4", 0.5, gains.k4), _POINTS)
    frequencies = np.linspace(0.1, _up_to("natural_frequency", 15.0, gains.natural_frequency), _POINTS)
    over_k4 = k4_locus(PAPER_ARM, angle, gains, k4)
    over_frequency = natural_frequency_locus(PAPER_ARM, angle, gains, frequencies)
    chosen = poles(closed_loop(PAPER_ARM, angle, gains))
    top = 1.12 * max(25.0, float(over_k4.imag.max()), float(over_frequency.imag.max()))
    left = -min(max(60.0, 1.15 * float(-chosen.real.min())), 3 * top)
    figure, axes = plt.subplots(1, 2, figsize=(9, 5.6 if angle_deg < 45 else 3.8), layout="constrained", sharey=True)
    given = f"$\\omega_n$ = {gains.natural_frequency:g} rad/s, $\\xi$ = {gains.damping:g}"
    panels = (
        (over_k4, k4, "$K_4$ (N m s/rad)", f"(a) over $K_4$; {given}"),
        (
            over_frequency,
            frequencies,
            "$\\omega_n$ (rad/s)",
            f"(b) over $\\omega_n$; $K_4$ = {gains.k4:g}, $\\xi$ = {gains.damping:g}",
        ),
    )
    for axis, (locus, parameter, label, title) in zip(axes, panels, strict=True):
        axis.set(xlim=(left, 8), ylim=(-0.06 * top, top), xlabel="real part (1/s)")
        axis.set_aspect("equal")
        _damping_grid(axis)
        shown = _draw_locus(axis, locus, parameter, chosen, gains)
        figure.colorbar(shown, ax=axis, label=label, location="bottom", shrink=0.9, pad=0.02, aspect=30)
        axis.set_title(title, fontsize=11)
    axes[0].set_ylabel("imaginary part (1/s)")
    figure.suptitle(f"Root loci at $\\theta_1$ = {angle_deg:.0f}° (upper half plane)", fontsize=12)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    return figure


def _up_to(name: str, usual: float, given: float) -> float:
    """Largest value of a gain to show: twice the one given where that is more than usual, within its range."""
    return min(max(usual, 2 * given), GAIN_RANGES[name][1])


def _draw_locus(axis: Axes, locus: Poles, parameter: Floats, chosen: Poles, gains: ServoGains):
    upper = locus.imag > -1e-6
    values = np.repeat(parameter[:, None], locus.shape[1], axis=1)
    shown = axis.scatter(locus.real[upper], locus.imag[upper], c=values[upper], s=9, cmap="viridis", zorder=3)
    first = locus[0][locus[0].imag > -1e-6]
    axis.scatter(
        first.real, first.imag, marker="x", color="black", s=55, lw=1.6, zorder=5, label="smallest value", clip_on=False
    )
    _arrow(axis, locus)
    here = chosen[chosen.imag > -1e-6]
    label = "Table 2" if gains == ServoGains() else "gains given"
    axis.scatter(here.real, here.imag, marker="s", facecolor="none", edgecolor=VERMILION, s=75, lw=2, zorder=6)
    axis.scatter([], [], marker="s", facecolor="none", edgecolor=VERMILION, s=75, lw=2, label=f"poles at {label}")
    return shown


def _arrow(axis: Axes, locus: Poles) -> None:
    """Draw an arrowhead on the oscillating branch, in the direction of the growing parameter."""
    branch = [row[row.imag.argmax()] for row in locus if row.imag.max() > 1]
    if len(branch) < 20:
        return
    k = int(0.75 * len(branch))
    before, after = branch[k - 8], branch[k]
    axis.annotate(
        "",
        (after.real, after.imag),
        (before.real, before.imag),
        arrowprops={"arrowstyle": "-|>", "color": "black", "mutation_scale": 16, "shrinkA": 0, "shrinkB": 0},
        zorder=7,
    )


def _damping_grid(axis: Axes) -> None:
    """Draw lines of equal damping ratio, labelled where they leave the picture."""
    left, top = axis.get_xlim()[0], axis.get_ylim()[1]
    for ratio in _GRID_DAMPING:
        slope = np.sqrt(1 - ratio**2) / ratio
        x = max(left, -top / slope)
        axis.plot([0, x], [0, -slope * x], color="0.75", lw=0.8, ls="--", zorder=1)
        at = 0.94 * x
        axis.text(
            at,
            -slope * at,
            f"{ratio:g}",
            color="0.4",
            fontsize=8.5,
            ha="center",
            va="center",
            zorder=2,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.8},
        )
    axis.axvline(0, color="0.4", lw=0.8)
    axis.axhline(0, color="0.4", lw=0.8)


def damping_picture(gains: ServoGains) -> Figure:
    """Map of the dominant damping over K_4 and M2: left of the line of best gains more K_4 helps, right of it hurts."""
    k4 = np.linspace(0, _up_to("k4", 0.5, gains.k4), 501)
    m2 = np.linspace(0.008, 0.14, 133)
    damping = damping_map(gains, k4, m2)
    figure, axis = plt.subplots(figsize=(9, 5.2), layout="constrained")
    levels = np.arange(0.05 * np.floor(20 * damping.min()), damping.max() + 0.05, 0.05)
    shown = axis.contourf(k4, m2, damping, levels=levels, cmap="cividis")
    lines = axis.contour(k4, m2, damping, levels=levels, colors="white", linewidths=0.7)
    axis.clabel(lines, levels=[level for level in lines.levels if level <= _LAST_LABEL], fmt="%.2f", fontsize=8.5)
    axis.plot(
        k4[damping.argmax(axis=1)],
        m2,
        color=VERMILION,
        lw=2.2,
        label="best K4: left of it more helps, right of it hurts",
    )
    axis.axvline(gains.k4, color="black", lw=1.8, ls="--", label=f"K4 = {gains.k4:g}")
    _mark_inertias(axis)
    axis.set(xlabel="$K_4$ (N m s/rad)", ylabel="$M_2$ (kg m²)", xlim=(0, k4[-1]), ylim=(m2[0], m2[-1]))
    figure.colorbar(shown, ax=axis, label="smallest damping ratio of any pole")
    figure.legend(*axis.get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    return figure


def _mark_inertias(axis: Axes) -> None:
    """Draw lines at the nominal arm's inertias, named on a second axis."""
    m2 = [nominal_m2(0), nominal_m2(np.pi / 2), nominal_m2(np.pi / 2, 0.2)]
    for value in m2:
        axis.axhline(value, color="white", lw=1.6, ls=":")
    names = axis.secondary_yaxis("right")
    names.set_yticks(m2, ["0°", "90°", "90°,\npayload\n0.2 kg"])
