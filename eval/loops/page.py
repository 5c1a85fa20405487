"""The numbers of all controllers as a page in Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from beltarm_env.metrics import METRICS, heading
from beltarm_env.task.seeds import LOOPS
from eval.comparison.estimates import Estimate, estimate
from eval.loops.costs import CHANGES, PRIVILEGED
from eval.loops.gains import gains_table
from eval.loops.models import Margins, Poles
from eval.loops.study import LoopStudy, at_angle, worst
from eval.style.markdown_table import markdown_table
from eval.style.text import number, poles_text

_SHOWN = (0, 45, 90)
_SHOWN_METRICS = ("cost", "tip_rms_mm", "residual_pp_mm")
_MOST_POLES = 3


def factor(value: float) -> str:
    """A gain margin as text; a dash where there is none."""
    if not np.isfinite(value) or value == 0:
        return "–"
    return f"×{value:.3g}"


def _cells(margin: Margins) -> list[str]:
    if not margin.stable:
        return ["unstable", *["–"] * 4]
    texts = [factor(margin.gain_up), factor(margin.gain_down), number(margin.phase, 0)]
    return [*texts, number(margin.delay, 1), number(margin.modulus, 2)]


def _slowest(poles: Poles) -> str:
    """The slowest poles [1/s]."""
    return poles_text(poles[poles.imag > -1e-6][:_MOST_POLES])


def margins_table(study: LoopStudy) -> str:
    """Each margin's worst over the angles, with the angle."""
    titles = ["controller", "gain up", "gain down", "phase (°)", "delay (samples)", "modulus", "slowest pole (1/s)"]
    rows = []
    for name, found in study.scans.items():
        cells = []
        for column, text in (
            ("gain_up", factor),
            ("gain_down", factor),
            ("phase", lambda value: number(value, 0)),
            ("delay", lambda value: number(value, 1)),
            ("modulus", lambda value: number(value, 2)),
        ):
            value, degrees = worst(found, column)
            shown = text(value)
            cells.append(shown if shown == "–" else f"{shown} at {degrees:.0f}°")
        slowest = [float(poles.real.max()) for poles in found.poles]
        rows.append([name, *cells, number(max(slowest), 1 if max(slowest) < -1 else 2)])
    return markdown_table(titles, rows)


def stability_line(study: LoopStudy) -> str:
    """Name the loops that are not stable at all angles."""
    unstable = [name for name, found in study.scans.items() if not all(margin.stable for margin in found.margins)]
    total = len(study.scans)
    if not unstable:
        return f"All {total} loops are stable at all angles: every pole lies inside the unit circle."
    return f"Not stable at all angles: {', '.join(unstable)}; the other {total - len(unstable)} loops are."


def delay_lines(study: LoopStudy) -> list[str]:
    """Costs with a delayed encoder beside the delay margins: does the linear loop predict the arm with friction?"""
    lines = []
    for samples in (1, 2):
        title = f"delay {samples} sample" + ("s" if samples > 1 else "")
        column = [change.title for change in CHANGES].index(title)
        beyond, within = [], []
        for name, found in study.scans.items():
            (beyond if worst(found, "delay")[0] < samples else within).append(name)
        said = [
            f"{names}: {_ratios(study, listed, column)}"
            for names, listed in (("worst margin below that", beyond), ("above", within))
            if listed
        ]
        lines.append(f"- {title}, cost over that without it; {'; '.join(said)}.")
    return lines


def _ratios(study: LoopStudy, names: list[str], column: int) -> str:
    return ", ".join(f"{name} {_ratio(study.costs[name].breaks[column].ratio)}" for name in names)


def _ratio(value: float) -> str:
    return f"{value:.2f}" if value < 9.95 else f"{value:.0f}"


def _label(name: str) -> str:
    return f"*{name}* (not ranked)" if name == PRIVILEGED else name


def _interval(value: Estimate, digits: int) -> str:
    return f"{value.iqm:.{digits}f} [{value.low:.{digits}f}, {value.high:.{digits}f}]"


def costs_table(study: LoopStudy) -> str:
    """Metrics on nominal and randomized arms."""
    titles = [
        "controller",
        *(f"{heading(name)}, {arms}" for arms in ("nominal", "train ranges") for name in _SHOWN_METRICS),
    ]
    rows = []
    for name, costs in study.costs.items():
        cells = [
            _interval(estimate(found[metric][None]), METRICS[metric].digits)
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
    found = study.scans[name]
    titles = ["angle", "gain up", "gain down", "phase (°)", "delay (samples)", "modulus", "slowest poles (1/s)"]
    rows = []
    for degrees in _SHOWN:
        margin, k = at_angle(found, degrees)
        rows.append([f"{degrees}°", *_cells(margin), _slowest(found.poles[k])])
    return f"### {name}\n\n{gains_table(name)}\n\n{markdown_table(titles, rows)}"


def markdown(study: LoopStudy, pictures: Sequence[Path], origin: str) -> str:
    """The content of `summary.md`."""
    shown = {path.stem: f"![{path.stem}]({path.name})" for path in pictures}
    parts = [
        "# The classical controllers in numbers",
        "Laws and what limits them are in [../baselines.md](../baselines.md). Everything on this page is written by "
        "`make loops`.",
        "## Linear loops",
        _LOOPS,
        stability_line(study),
        margins_table(study),
        shown["margins"],
        "Gain margins: upwards in blue, downwards in vermilion where there is one. Dashed: 6 dB, 30°, one sample, 0.5.",
        "The encoder's delay is where the loop and the arm with friction can be compared:",
        "\n".join(delay_lines(study)),
        shown["poles"],
        "Poles s = ln z / 1.5 ms, upper half plane; faster ones lie outside. Dashed: damping ratios 0.1 and 0.3.",
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


_LOOPS = (
    "The arm is at rest at a joint angle, on the lumped model with nominal constants; Coulomb friction and its "
    "compensation, the encoder's resolution and the torque limit are left out. There is one measurement, the motor's "
    "angle, so the loop may be cut at the torque or at the encoder alike. *Gain up* and *gain down* are the factors at "
    "which the loop becomes unstable, *delay* is the encoder's delay (or the torque's, if the controller does not know "
    "of it) that it bears in samples of 1.5 ms, *modulus* is 1 / max|S|. The worst over 46 angles from 0° to 90°, and "
    "where. `preview` and `adaptive` have the gain of the plan long before its end, `adaptive` with the nominal arm "
    "and an encoder in time identified and held: one that is late from the start on it finds out about, and its margin "
    "is for one that becomes late. `mpc` has the first torque of its horizon within the torque limit. Friction damps "
    "what these loops leave undamped, and compensating it at rest multiplies the gain for small pushes: a small margin "
    "here is a warning, not yet a failure."
)
