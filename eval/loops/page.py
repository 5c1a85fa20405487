"""The numbers of all controllers as a page in Markdown."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from baselines.loops.condition import CORNERS, MarginCondition
from beltarm_env.metrics import heading
from beltarm_env.task.seeds import LOOPS
from eval.comparison.estimates import estimate
from eval.loops.costs import CHANGES, PRIVILEGED
from eval.loops.gains import gains_table
from eval.loops.scan import at_angle, worst
from eval.loops.study import LoopStudy
from eval.style.markdown_table import markdown_table
from eval.style.metrics import cell
from eval.style.text import number, poles_text

_SHOWN = (0, 45, 90)
_SHOWN_METRICS = ("cost", "tip_rms_mm", "residual_pp_mm")
_MOST_POLES = 3


def factor(value: float) -> str:
    """A gain margin as text; a dash where there is none."""
    if not np.isfinite(value) or value == 0:
        return "–"
    return f"×{value:.3g}"


_MARGINS: dict[str, tuple[str, Callable[[float], str]]] = {
    "gain_up": ("gain up", factor),
    "gain_down": ("gain down", factor),
    "phase": ("phase (°)", partial(number, digits=0)),
    "delay": ("delay (samples)", partial(number, digits=1)),
    "modulus": ("modulus", partial(number, digits=2)),
}
"""Title and text of each margin."""
_MARGIN_TITLES = [title for title, _ in _MARGINS.values()]


def margins_table(study: LoopStudy) -> str:
    """Each margin's worst over the angles, with the angle."""
    rows = []
    for name, found in study.scans.items():
        cells = ["yes" if found.margins.stable.all() else "no"]
        for column, (_, text) in _MARGINS.items():
            value, degrees = worst(found, column)
            shown = text(value)
            cells.append(shown if shown == "–" else f"{shown} at {degrees:.0f}°")
        slowest = max(float(poles.real.max()) for poles in found.poles)
        rows.append([name, *cells, number(slowest, 1 if slowest < -1 else 2)])
    return markdown_table(["controller", "stable", *_MARGIN_TITLES, "slowest pole (1/s)"], rows)


def driven_table(study: LoopStudy) -> str:
    """Least modulus and delay margins over the angles on the design model, and at the corners, with where."""
    rows = []
    for name, (design, corners) in study.driven.items():
        cells = []
        for least in (design, corners):
            stable = least.growth < 0
            cells += [
                f"{least.modulus:.2f} at {least.modulus_at}" if stable else f"unstable at {least.modulus_at}",
                f"{number(least.delay, 1)} at {least.delay_at}" if stable else "–",
            ]
        rows.append([name, *cells])
    titles = [f"{margin}, {arms}" for arms in ("design model", "corners") for margin in ("modulus", "delay (samples)")]
    return markdown_table(["controller", *titles], rows)


def _ratio(value: float) -> str:
    return f"{value:.2f}" if value < 9.95 else f"{value:.0f}"


def _label(name: str) -> str:
    return f"*{name}* (not ranked)" if name == PRIVILEGED else name


def costs_table(study: LoopStudy) -> str:
    """Metrics on nominal and randomized arms."""
    titles = [
        "controller",
        *(f"{heading(name)}, {arms}" for arms in ("nominal", "train ranges") for name in _SHOWN_METRICS),
    ]
    rows = []
    for name, costs in study.costs.items():
        cells = [
            cell(metric, estimate(found[metric][None]))
            for found in (costs.nominal, costs.randomized)
            for metric in _SHOWN_METRICS
        ]
        rows.append([_label(name), *cells])
    return markdown_table(titles, rows)


def times_table(study: LoopStudy) -> str:
    """Wall-clock per action."""
    titles = [
        "controller", "one arm, p50 (µs)", "p99 (µs)", f"per action, batch of {study.batch} (µs)",
        f"episode of {study.batch} arms (s)",
    ]  # fmt: skip
    rows = [
        [name, number(t.median, 0), number(t.slow, 0), number(t.batched, 2), number(t.episode, 1)]
        for name, t in study.times.items()
    ]
    return markdown_table(titles, rows)


def breaks_table(study: LoopStudy) -> str:
    """Cost ratios, and the number of arms that left the workspace."""
    rows = []
    for name, costs in study.costs.items():
        cells = [_ratio(b.ratio) + (f" ({b.failures} left)" if b.failures else "") for b in costs.breaks]
        rows.append([_label(name), *cells])
    return markdown_table(["controller", *(change.title for change in CHANGES)], rows)


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
        rows.append([_label(name), *(_ratio(value) for value in [*means, *costs.oracle / optimum.costs])])
    return markdown_table(titles, rows)


def controller_section(study: LoopStudy, name: str) -> str:
    """Gains, and margins and poles at some angles, of one controller."""
    found, rows = study.scans[name], []
    for degrees in _SHOWN:
        margin, k = at_angle(found, degrees)
        cells = [text(getattr(margin, column)) for column, (_, text) in _MARGINS.items()]
        cells = cells if margin.stable else ["unstable", *["–"] * (len(cells) - 1)]
        upper = found.poles[k][found.poles[k].imag > -1e-6]
        rows.append([f"{degrees}°", *cells, poles_text(upper[:_MOST_POLES])])
    table = markdown_table(["angle", *_MARGIN_TITLES, "slowest poles (1/s)"], rows)
    return f"### {name}\n\n{gains_table(name)}\n\n{table}"


def markdown(study: LoopStudy, pictures: Sequence[Path], origin: str) -> str:
    """The content of `summary.md`."""
    shown = {path.stem: f"![{path.stem}]({path.name})" for path in pictures}
    parts = [
        "# The classical controllers in numbers",
        "Laws and what limits them are in [../baselines.md](../baselines.md). Everything on this page is written by "
        "`make loops`.",
        "## Linear loops",
        _LOOPS,
        margins_table(study),
        shown["margins"],
        "Gain margins: upwards in blue, downwards in vermilion where there is one. Dashed: 6 dB, 30°, one sample, 0.5.",
        shown["poles"],
        "Poles s = ln z / 1.5 ms, upper half plane; faster ones lie outside. Dashed: damping ratios 0.1 and 0.3.",
        "### With the drive as it is built",
        _DRIVEN,
        driven_table(study),
        "## Costs",
        f"Interquartile means with bootstrap 95 % intervals over {study.arms} arms with Coulomb friction, nominal and "
        f"from the training ranges, seeds {LOOPS.first} to {LOOPS.first + study.arms - 1}, on which nothing was tuned, "
        f"trained or tested. *{PRIVILEGED}* knows the true constants and the true state.",
        costs_table(study),
        "## Where each breaks",
        f"Mean cost over the mean cost on the nominal arm, same {study.arms} moves, one thing moved at a time; "
        "*left*: episodes in which the arm left the workspace. A ratio near 1 does not make a controller good: read it "
        f"with the costs above. *{PRIVILEGED}* is told the constants that are moved, but neither of the delay nor of "
        "the full arm.",
        shown["breaks"],
        breaks_table(study),
        "## Gap to the clairvoyant optimum",
        "Cost over that of `baselines/oracle.json`, which knows arm, state and move; a local optimum. The seeds are "
        "among those that tuning may draw arms from.",
        gap_table(study),
        "## Time",
        "Wall-clock on the machine below, the controller's period being 1500 µs; the last column has the environment "
        "and the plans made at the start in it.",
        times_table(study),
        "## Each controller",
        *(controller_section(study, name) for name in study.scans),
        "## Where this comes from",
        origin,
    ]
    return "\n\n".join(parts) + "\n"


_ASKED = MarginCondition()
_DRIVEN = (
    "The same loops on arms behind current loop, latency and torque constant: on the design model, the middle of the "
    f"training ranges, and on {len(CORNERS) - 1} corners of them; the delay is what is borne beyond the arm's own "
    "latency. `adaptive` is taken to have found the arm's constants. Gains are tuned under the condition that both "
    f"margins are at least {_ASKED.modulus:g} and {_ASKED.delay:g} sample on all of them "
    "(`baselines/loops/condition.py`), unless `baselines/tune.py --no-margins` found them."
)
_LOOPS = (
    "The arm is at rest at a joint angle, on the lumped model with nominal constants; Coulomb friction and its "
    "compensation, the encoder's resolution and the torque limit are left out. There is one measurement, the motor's "
    "angle, so the loop may be cut at the torque or at the encoder alike. *Gain up* and *gain down* are the factors at "
    "which the loop becomes unstable, *delay* is the encoder's delay (or the torque's, if the controller does not know "
    "of it) that it bears in samples of 1.5 ms, *modulus* is 1 / max|S|. The worst over 46 angles from 0° to 90°, and "
    "where; *stable*: every pole lies inside the unit circle at all of them. `preview` and `adaptive` have the gain of "
    "the plan long before its end, `adaptive` with the nominal arm and an encoder in time identified and held: one "
    "that is late from the start on it finds out about, and its margin is for one that becomes late. `mpc` has the "
    "first torque of its horizon within the torque limit. Friction damps what these loops leave undamped, and "
    "compensating it at rest multiplies the gain for small pushes: a small margin here is a warning, not yet a "
    "failure. What a late encoder costs the arm with friction stands below, under *Where each breaks*."
)
