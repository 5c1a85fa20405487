"""What the page names and counts, and its pictures, from the data alone.

Time responses, Figs. 4(b) and 8(b), root loci, Fig. 6, damping, alternatives, random moves, drives.
"""

from collections import Counter
from collections.abc import Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from beltarm_env.arrays import Floats
from eval.report.style import BLUE, GREEN, ORANGE, PINK, VERMILION, below, damping_lines, mark_one_two_five
from eval.report.text import degrees, number
from eval.studies._arms import ALL, IDEAL, heading
from eval.studies._frame import Pictures
from eval.studies.paper import linear, runs

Data = dict[str, Any]
_COLOURS = (ORANGE, BLUE)  # of K4 = 0 and of the gain given
_PHASE_SHADE = "#F0F0F0"
_STYLES: dict[str, dict[str, Any]] = {runs.AS_ANALYSED: {"lw": 4.5, "alpha": 0.35}, runs.FRICTION: {"lw": 1.5}}
"""Lines as analysed and with friction: both can be seen where they coincide."""
_MARKS = {runs.AS_ANALYSED: (GREEN, "o", -0.17), runs.FRICTION: (PINK, "D", 0.17)}
"""Colour, marker and shift of marks, by conditions."""
_LABELS = {
    "motor_speed": "motor speed (rad/s)",
    "radial_speed": "tip velocity ṙ (m/s)",
    "radial_acceleration": "tip acceleration r̈ (m/s²)",
    "lateral_speed": "lateral velocity ẏ (m/s)",
    "lateral_acceleration": "lateral acc. ÿ (m/s²)",
}
_RATIO = "ringing with K4 = {k4:g} over that with 0"
_K4_SHOWN = 0.5  # largest K_4 in root loci and map [N m s/rad]


def tables(data: Data) -> Data:
    """Scenes by conditions and place, alternatives by their label, answers and their number."""
    scenes: dict[str, Data] = {}
    for scene in data["scenes"]:
        scenes.setdefault(scene["view"], {})[scene["place"]] = scene
    standard = {row["view"]: row for row in data["drives"] if row["place"] == runs.STANDARD}
    return {
        "counts": {view: counts(data, view) for view in runs.MAIN},
        "scene": scenes,
        "tried": {row["label"]: row["views"] for row in data["alternatives"]},
        "chosen": {row["assumption"]: row["chosen"] for row in data["alternatives"]},
        "answers": runs.ANSWERS,
        "phases": runs.PHASES,
        "main": tuple(runs.MAIN),
        "both_arms": tuple(runs.BOTH_ARMS),
        "effect": heading,
        "pole_pairs": pole_pairs,
        "verdicts": [_verdict(standard[view]) for view in (runs.AS_ANALYSED, runs.FRICTION)],
    }


def pole_pairs(pairs: list[list[float]]) -> str:
    """Poles of the data [1/s] as text, in their order, each conjugate pair once with its damping ratio."""
    texts = []
    for pole in (complex(*pair) for pair in pairs if pair[1] > -1e-6):
        rest = f" ± {number(pole.imag, 1)}j (ζ {number(-pole.real / abs(pole), 3)})" if pole.imag > 1e-6 else ""
        texts.append(number(pole.real, 2) + rest)
    return ", ".join(texts)


def counts(data: Data, view: str) -> Counter[str]:
    """Number of alternatives with each answer, of those that change anything."""
    views = [row["views"][view] for row in data["alternatives"]]
    return Counter(row["answer"] for row in views if not row["same"])


def _verdict(row: Data) -> Data:
    """Whether K4 still suppresses the vibration of the standard move with all effects together."""
    by_name = {drive["drive"]: drive for drive in row["drives"]}
    ideal, real = by_name[IDEAL], by_name[ALL]
    answers = {answer: real["answers"].get(answer, 0) for answer in runs.ANSWERS[:3]}
    draws, usual = sum(ideal["answers"].values()), max(ideal["answers"], key=ideal["answers"].get)
    reduced = answers["yes"] + answers["in part"]
    as_good = {"yes": answers["yes"], "in part": reduced}.get(usual)
    if as_good is None:
        survives = "nothing"
    elif 2 * as_good > draws:
        survives = "yes" if as_good == draws else "mostly"
    else:
        survives = "in part" if 2 * reduced > draws else "no"
    return {
        "view": row["view"],
        "ideal": ideal,
        "real": real,
        "usual": usual,
        "answers": answers,
        "reduced": reduced,
        "survives": survives,
    }


def pictures(data: Data) -> Pictures:
    """All pictures, by the name of their file; those of the linear loop follow from the gains."""
    gains = linear.ServoGains(**data["gains"])
    return {
        "responses_standard.png": lambda: _responses(data, runs.STANDARD, runs.FRICTION),
        "responses_standard_as_analysed.png": lambda: _responses(data, runs.STANDARD, runs.AS_ANALYSED),
        "responses_to_0.png": lambda: _responses(data, runs.TO_0, runs.FRICTION),
        "root_locus_90.png": lambda: _root_loci(gains, 90.0),
        "root_locus_0.png": lambda: _root_loci(gains, 0.0),
        "damping_map.png": lambda: _damping(gains),
        "assumptions.png": lambda: _assumptions(data),
        "moves.png": lambda: _moves(data),
        "drive_ratios.png": lambda: _drive_ratios(data),
    }


def _array(values: Sequence[Any]) -> Floats:
    return np.array(values, dtype=np.float64)


def _responses(data: Data, place: str, view: str) -> Figure:
    """Motor and tip over time, Figs. 4(b) and 8(b) side by side."""
    (move,) = [scene["move"] for scene in data["scenes"] if (scene["place"], scene["view"]) == (place, view)]
    signals, names = data["signals"][f"{place}, {view}"], runs.SIGNALS[place, view]
    time, size = signals["time"], (9, 1.0 + 1.9 * len(names))
    figure, axes = plt.subplots(len(names), 2, figsize=size, layout="constrained", sharex=True, sharey="row")
    titles = ("K4 = 0 (as Fig. 4b)", f"K4 = {data['gains']['k4']:g} (as Fig. 8b)")
    for column, key, title, colour in zip(axes.T, ("without", "suppressed"), titles, _COLOURS, strict=True):
        for axis, name in zip(column, names, strict=True):
            axis.axvspan(0, move["duration"], color=_PHASE_SHADE, zorder=0)
            reference = signals.get(f"{name}_reference", np.zeros(len(time)))
            axis.plot(time, reference, color="0.35", lw=1.2, ls="--", label="rigid arm on the reference")
            axis.plot(time, _array(signals[key][name]), color=colour, lw=1.4)
            axis.set_xlim(0, time[-1])
            axis.grid(alpha=0.3)
        column[0].set_title(title, fontsize=11)
        column[-1].set_xlabel("time (s)")
    for axis, name in zip(axes[:, 0], names, strict=True):
        axis.set_ylabel(_LABELS[name])
    figure.suptitle(f"{degrees(move['start'])} to {degrees(move['goal'])}, {view} (grey: the move)", fontsize=12)
    figure.align_ylabels()
    below(figure, axes[0, 0], 1)
    return figure


def _assumptions(data: Data) -> Figure:
    """Ratio of ringing with to without vibration feedback, one row per value of each assumption."""
    usual = {scene["view"]: scene for scene in data["scenes"] if scene["place"] == runs.STANDARD}
    rows = [{"assumption": "", "label": "standard move", "views": usual}, *data["alternatives"]]
    changes = [k for k in range(1, len(rows)) if rows[k]["assumption"] != rows[k - 1]["assumption"]]
    ratios = {view: [row["views"][view]["ratios"] for row in rows] for view in _MARKS}
    return _ratios(data, [row["label"] for row in rows], ratios, changes, 9.8)


def _drive_ratios(data: Data) -> Figure:
    """Ratio of ringing with to without vibration feedback, a row for each effect, a mark for each drive."""
    rows = {row["view"]: row["drives"] for row in data["drives"] if row["place"] == runs.STANDARD}
    names = [heading(drive["drive"]) for drive in rows[runs.FRICTION]]
    ratios = {view: [drive["ratios"] for drive in rows[view]] for view in _MARKS}
    return _ratios(data, names, ratios, list(range(1, len(names))), 5.2)


def _ratios(data: Data, names: list[str], ratios: Data, lines: list[int], height: float) -> Figure:
    """Draw ratios of ringing with to without vibration feedback, and the medians of several: a named row for each.

    `ratios` are by conditions, for each row, by phase; `lines` are rows over which there is a line.
    """
    figure, axes = plt.subplots(1, 2, figsize=(9, height), layout="constrained", sharex=True, sharey=True)
    for axis, phase in zip(axes, ("stop", "end"), strict=True):
        for view, (colour, marker, shift) in _MARKS.items():
            for k, row in enumerate(ratios[view]):
                values, label = np.atleast_1d(_array(row[phase])), view if k == 0 else None
                heights = np.full(len(values), k + shift)
                axis.scatter(values, heights, color=colour, marker=marker, s=20, alpha=0.7, lw=0, label=label)
                known = values[np.isfinite(values)]
                if len(known) > 1:
                    axis.plot([np.median(known)] * 2, [k + shift - 0.16, k + shift + 0.16], color="black", lw=1.3)
        for k in lines:
            axis.axhline(k - 0.5, color="0.87", lw=0.8)
        for bound in (data["bounds"]["removed"], data["bounds"]["reduced"]):
            axis.axvline(bound, color="0.4", lw=1, ls=":")
        axis.axvline(1, color="0.4", lw=1)
        axis.set(xscale="log", title=runs.PHASES[phase], xlabel=_RATIO.format(**data["gains"]))
        mark_one_two_five(axis.xaxis)
        axis.xaxis.set_minor_locator(NullLocator())
    axes[0].set_yticks(range(len(names)), names, fontsize=9)
    axes[0].set_ylim(len(names) - 0.4, -0.6)
    below(figure, axes[0], 2)
    return figure


def _moves(data: Data) -> Figure:
    """Share of random moves over the ratio of ringing."""
    figure, axis = plt.subplots(figsize=(6, 4.8), layout="constrained")
    for view, style in _STYLES.items():
        for phase, colour in (("cruise", GREEN), ("stop", PINK)):
            ratios = _array(data["random"][view]["phases"][phase]["ratios"])
            share = 100 * (np.arange(len(ratios)) + 1) / max(len(ratios), 1)
            axis.plot(ratios, share, color=colour, label=f"{runs.PHASES[phase]}, {view}", **style)
    reduced = data["bounds"]["reduced"]
    axis.axvline(1, color="0.5", lw=1, ls=":")
    axis.axvspan(reduced, 1 / reduced, color=_PHASE_SHADE, zorder=0)
    axis.set(xscale="log", xlim=(0.08, 8), ylim=(0, 100), ylabel="share of moves up to here (%)")
    axis.set_xlabel(_RATIO.format(**data["gains"]))
    axis.set_xticks([0.1, 0.2, 0.5, 1, 2, 5], ["0.1", "0.2", "0.5", "1", "2", "5"])
    axis.set_title(f"{data['random_moves']['size']} random moves", fontsize=11)
    axis.grid(alpha=0.3)
    below(figure, axis, 2, fontsize=9)
    return figure


def _root_loci(gains: linear.ServoGains, angle_deg: float) -> Figure:
    """Root loci over K_4 and over omega_n at one joint angle, the poles at the gains given marked."""
    parameters = {
        "k4": (np.linspace(0, _K4_SHOWN, 241), "$K_4$ (N m s/rad)"),
        "natural_frequency": (np.linspace(0.1, 15.0, 241), "$\\omega_n$ (rad/s)"),
    }
    angle = np.radians(angle_deg)
    loci = [linear.locus(angle, gains, name, values) for name, (values, _) in parameters.items()]
    chosen = linear.poles(linear.closed_loop(linear.PAPER_ARM, angle, gains))
    top = 1.12 * max(25.0, *(float(each.imag.max()) for each in loci))
    titles = (
        f"(a) over $K_4$; $\\omega_n$ = {gains.natural_frequency:g} rad/s, $\\xi$ = {gains.damping:g}",
        f"(b) over $\\omega_n$; $K_4$ = {gains.k4:g}, $\\xi$ = {gains.damping:g}",
    )
    figure, axes = plt.subplots(1, 2, figsize=(9, 5.6 if angle_deg < 45 else 3.8), layout="constrained", sharey=True)
    for axis, each, (values, label), title in zip(axes, loci, parameters.values(), titles, strict=True):
        axis.set(xlim=(-60, 8), ylim=(-0.06 * top, top), xlabel="real part (1/s)", aspect="equal")
        damping_lines(axis, 0.1, 0.3, 0.6)
        colour = np.repeat(values, each.shape[1])
        shown = axis.scatter(each.real, each.imag, c=colour, s=9, cmap="viridis", zorder=3)
        axis.plot(each[0].real, each[0].imag, "x", color="black", ms=7, zorder=5, label="smallest value")
        axis.plot(chosen.real, chosen.imag, "s", mfc="none", mec=VERMILION, ms=9, mew=2, zorder=6, label="gains given")
        figure.colorbar(shown, ax=axis, label=label, location="bottom", shrink=0.9, pad=0.02, aspect=30)
        axis.set_title(title, fontsize=11)
    axes[0].set_ylabel("imaginary part (1/s)")
    figure.suptitle(f"Root loci at $\\theta_1$ = {angle_deg:.0f}° (upper half plane)", fontsize=12)
    below(figure, axes[0], 2)
    return figure


def _damping(gains: linear.ServoGains) -> Figure:
    """Map of the dominant damping over K_4 and M2: left of the line of best gains more K_4 helps, right of it hurts."""
    k4, m2 = np.linspace(0, _K4_SHOWN, 501), np.linspace(0.008, 0.14, 133)
    damping = linear.damping_map(gains, k4, m2)
    best = k4[damping.argmax(axis=1)]
    figure, axis = plt.subplots(figsize=(9, 5.2), layout="constrained")
    levels = np.arange(0.05 * np.floor(20 * damping.min()), damping.max() + 0.05, 0.05)
    shown = axis.contourf(k4, m2, damping, levels=levels, cmap="cividis")
    lines = axis.contour(k4, m2, damping, levels=levels, colors="white", linewidths=0.7)
    # Contours of higher damping are too close together for labels.
    axis.clabel(lines, levels=[level for level in lines.levels if level <= 0.5], fmt="%.2f", fontsize=8.5)
    axis.plot(best, m2, color=VERMILION, lw=2.2, label="best K4: left of it more helps, right of it hurts")
    axis.axvline(gains.k4, color="black", lw=1.8, ls="--", label=f"K4 = {gains.k4:g}")
    axis.set(xlabel="$K_4$ (N m s/rad)", ylabel="$M_2$ (kg m²)", xlim=(0, k4[-1]), ylim=(m2[0], m2[-1]))
    for value in linear.MARKED_ARMS.values():
        axis.axhline(value, color="white", lw=1.6, ls=":")
    names = [name.replace(", ", ",\n").replace("payload ", "payload\n") for name in linear.MARKED_ARMS]
    axis.secondary_yaxis("right").set_yticks(list(linear.MARKED_ARMS.values()), names)
    figure.colorbar(shown, ax=axis, label="smallest damping ratio of any pole")
    below(figure, axis, 2)
    return figure
