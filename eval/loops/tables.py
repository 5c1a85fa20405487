"""Tables of the study: one function for each."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from baselines.models.linear import ANGLES
from beltarm_env.metrics import TORQUES, heading
from eval.comparison.statistics import estimate, interquartile_mean, worst_mean
from eval.loops.changes import CHANGES, LIMITS
from eval.loops.costs import PRIVILEGED, Costs
from eval.loops.gains import gains_table
from eval.loops.scan import ARMS, Scan, at_angle
from eval.loops.study import LoopStudy
from eval.report.text import cell, markdown_table, number, numbers, poles_text

_SHOWN = (0, 45, 90)
_SHOWN_METRICS = ("cost", "tip_rms_mm", "residual_pp_mm")
_MOST_POLES = 3
_DESIGN = slice(0, 1)  # of `ARMS`


def _factor(value: float) -> str:
    """A gain margin as text; a dash where there is none."""
    if not np.isfinite(value) or value == 0:
        return "–"
    return f"×{value:.3g}"


_MARGINS: dict[str, tuple[str, Callable[[float], str]]] = {
    "gain_up": ("gain up", _factor),
    "gain_down": ("gain down", _factor),
    "phase": ("phase (°)", partial(number, digits=0)),
    "delay": ("delay (samples)", partial(number, digits=1)),
    "modulus": ("modulus", partial(number, digits=2)),
}
"""Title and text of each margin."""
_MARGIN_TITLES = [title for title, _ in _MARGINS.values()]


def _label(name: str) -> str:
    return f"*{name}* (not ranked)" if name == PRIVILEGED else name


def ratio_text(value: float, failures: int = 0) -> str:
    """A ratio of costs, and how many arms left the workspace, if any."""
    return (f"{value:.2f}" if value < 9.95 else f"{value:.0f}") + (f" ({failures} left)" if failures else "")


def glance_table(study: LoopStudy) -> str:
    """A row for each controller: what it costs, how robust it is, what it asks of motor and computer."""
    titles = ["controller", "cost", "worst 5 %", *(change.title for change in LIMITS)]
    titles += ["least modulus", "least delay (samples)", heading("torque_reversals_hz"), "p99 (µs)"]
    rows = []
    for name, costs in study.costs.items():
        iqm = interquartile_mean(costs.built["cost"])
        cells = [f"{iqm:.0f}", f"×{ratio_text(worst_mean(costs.built['cost']) / iqm)}"]
        cells += [f"×{ratio_text(found.of_iqm, found.failures)}" for found in costs.limits]
        cells += _least(study.scans[name]) if name in study.scans else ["–", "–"]
        cells.append(number(interquartile_mean(costs.built["torque_reversals_hz"]), 1))
        cells.append(number(study.times[name].slow, 0) if name in study.times else "–")
        rows.append([_label(name), *cells])
    return markdown_table(titles, rows)


def _least(scan: Scan) -> list[str]:
    if not scan.margins.stable.all():
        return ["unstable", "–"]
    return [_MARGINS[name][1](scan.worst(name)[0]) for name in ("modulus", "delay")]


def margins_table(study: LoopStudy) -> str:
    """On the design model each margin's worst over the angles, with the angle."""
    rows = []
    for name, found in study.scans.items():
        stable = found.margins.stable[0].all()
        cells = ["yes" if stable else "no"]
        for column, (_, text) in _MARGINS.items():
            value, _, degrees = found.worst(column, _DESIGN)
            shown = text(value) if stable else "–"
            cells.append(shown if shown == "–" else f"{shown} at {degrees:.0f}°")
        slowest = max(float(poles.real.max()) for poles in found.poles)
        rows.append([name, *cells, number(slowest, 1 if slowest < -1 else 2)])
    return markdown_table(["controller", "stable", *_MARGIN_TITLES, "slowest pole (1/s)"], rows)


def corners_table(study: LoopStudy) -> str:
    """Least modulus and delay margin over arms and angles, with where."""
    rows = []
    for name, found in study.scans.items():
        cells = ["yes" if found.margins.stable.all() else "no"]
        for column in ("modulus", "delay"):
            value, arm, degrees = found.worst(column)
            cells += [_MARGINS[column][1](value), f"{arm}, {degrees:.0f}°"]
        rows.append([name, *cells])
    return markdown_table(["controller", "stable", "modulus", "where", "delay (samples)", "where"], rows, "llrlrl")


def arms_table(study: LoopStudy) -> str:
    """Least modulus margin over the angles on each arm."""
    rows = [
        [arm, *(number(found.margins.modulus[k].min(), 2) for found in study.scans.values())]
        for k, arm in enumerate(ARMS)
    ]
    return markdown_table(["arm", *study.scans], rows)


def costs_table(study: LoopStudy) -> str:
    """Metrics on arms as they are built, and cost on the design model."""
    head = ["controller", "cost, design model", *(heading(name) for name in _SHOWN_METRICS)]
    titles = [*head, "mean cost", "worst 5 %", "left", *(heading(name) for name in TORQUES)]
    rows = [[_label(name), *_costs_row(costs)] for name, costs in study.costs.items()]
    return markdown_table(titles, rows)


def _costs_row(costs: Costs) -> list[str]:
    metrics = {name: estimate(values[None]) for name, values in costs.built.items()}
    return [
        f"{interquartile_mean(costs.design):.0f}",
        *(cell(name, metrics[name]) for name in _SHOWN_METRICS),
        f"{costs.built['cost'].mean():.0f}",
        f"{worst_mean(costs.built['cost']):.0f}",
        str(costs.left),
        *(numbers(name, metrics[name])[0] for name in TORQUES),
    ]


def changes_table(study: LoopStudy) -> str:
    """A row for each change of the design model, a column for each controller."""
    rows = [
        [change.title, *(ratio_text(c.changes[k].of_mean, c.changes[k].failures) for c in study.costs.values())]
        for k, change in enumerate(CHANGES)
    ]
    return markdown_table(["change", *map(_label, study.costs)], rows)


def limits_table(study: LoopStudy) -> str:
    """Cost beyond the training ranges over that within: of interquartile means, and of means."""
    rows = []
    for name, costs in study.costs.items():
        cells = []
        for found in costs.limits:
            cells += [ratio_text(found.of_iqm), ratio_text(found.of_mean, found.failures)]
        rows.append([_label(name), *cells])
    titles = [f"{change.title}, {of}" for change in LIMITS for of in ("IQM", "mean")]
    return markdown_table(["controller", *titles], rows)


def prices_table(study: LoopStudy) -> str:
    """Cost with and without margins, and what margins are left without."""
    rows = []
    for name, found in study.prices.items():
        kept, free = interquartile_mean(found.kept), interquartile_mean(found.free)
        unstable = found.margins.growth >= 0
        left = "unstable" if unstable else f"{found.margins.modulus:.2f}, {number(found.margins.delay, 1)}"
        at = found.margins.modulus_at
        means = [f"{found.kept.mean():.0f}", f"{found.free.mean():.0f}"]
        rows.append([name, f"{kept:.0f}", f"{free:.0f}", f"×{ratio_text(kept / free)}", *means, left, at])
    titles = ["controller", "cost with", "without", "price", "mean with", "without", "modulus, delay without", "where"]
    return markdown_table(titles, rows, "lrrrrrrl")


def worth_table(study: LoopStudy) -> str:
    """What identification is worth: mean costs, and arms on which it costs more."""
    rows = [
        [of.title, f"{of.own.mean():.0f}", f"{of.other.mean():.0f}", f"{of.worse} of {len(of.own)}", f"×{of.worst:.2f}"]
        for of in study.worth
    ]
    return markdown_table(["beside", "mean cost", "of the other", "worse", "worst arm"], rows)


def times_table(study: LoopStudy) -> str:
    """Wall-clock per action."""
    titles = [
        "controller", "first action, with its plan (µs)", "later ones, p50 (µs)", "p99 (µs)",
        f"per action, batch of {study.sizes.batch} (µs)", f"episode of {study.sizes.batch} arms (s)",
    ]  # fmt: skip
    rows = [
        [name, *(number(t, 0) for t in (of.first, of.median, of.slow)), number(of.batched, 2), number(of.episode, 1)]
        for name, of in study.times.items()
    ]
    return markdown_table(titles, rows)


def gap_table(study: LoopStudy) -> str:
    """Costs over those of the clairvoyant optimum, scenario by scenario and in the mean of each kind."""
    optimum = study.oracle
    kinds = [name.split(":")[0] for name in optimum.names]
    groups = {kind: np.array([other == kind for other in kinds]) for kind in dict.fromkeys(kinds)}
    titles = ["controller", *(f"{kind}, all" for kind in groups), *optimum.names]
    rows = [["*optimum's cost*", *(number(optimum.costs[m].mean(), 1) for m in groups.values())]]
    rows[0] += [number(cost, 1) for cost in optimum.costs]
    for name, costs in study.costs.items():
        means = [costs.oracle[m].sum() / optimum.costs[m].sum() for m in groups.values()]
        rows.append([_label(name), *(ratio_text(value) for value in [*means, *costs.oracle / optimum.costs])])
    return markdown_table(titles, rows)


def controller_section(study: LoopStudy, name: str) -> str:
    """Gains, and margins and poles on the design model at some angles, of one controller."""
    found, rows = study.scans[name], []
    for degrees in _SHOWN:
        margin, k = at_angle(found, degrees)
        cells = [text(getattr(margin, column)) for column, (_, text) in _MARGINS.items()]
        cells = cells if margin.stable else ["unstable", *["–"] * (len(cells) - 1)]
        upper = found.poles[k][found.poles[k].imag > -1e-6]
        rows.append([f"{np.degrees(ANGLES[k]):.0f}°", *cells, poles_text(upper[:_MOST_POLES])])
    table = markdown_table(["angle", *_MARGIN_TITLES, "slowest poles (1/s)"], rows)
    return f"### {name}\n\n{gains_table(name)}\n\n{table}"
