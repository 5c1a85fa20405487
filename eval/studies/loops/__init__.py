"""Classical controllers in numbers: margins, costs, limits, times and tuning of each.

Poles and margins of the closed loop over joint angle and arms; cost and metrics on randomized arms; cost with
one thing changed; gains and their tuning.
"""

from dataclasses import dataclass, fields
from itertools import product
from math import isfinite
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from baselines import CONTROLLERS, TUNABLE
from baselines.gains import read_file
from baselines.loops.condition import CORNERS, MarginCondition, margins_on
from baselines.loops.models import continuous
from baselines.models.linear import ANGLES
from baselines.tools.progress import progress_over
from baselines.yardsticks.privileged import PrivilegedController
from beltarm_env.arrays import Floats
from beltarm_env.metrics import TORQUES
from beltarm_env.task.seeds import LOOPS
from eval.comparison.methods import PRIVILEGED, chosen
from eval.report.style import BLUE, VERMILION, damping_lines, panels
from eval.studies._frame import Bounds, Pictures, StudyOptions, shown
from eval.studies.loops import costs

QUICK = {"names": ("ei",), "arms": 8}
ARMS = tuple(CORNERS)
"""Arms that loops are looked at on; the first is the design model."""
NONE_LEFT = {"gain_up": 1.0, "gain_down": 1.0, "phase": 0.0, "delay": 0.0, "modulus": 0.0}
"""Margins by name, and their values for an unstable loop."""
_PLANE = (-62.0, 72.0)  # smallest real and largest imaginary part of the poles that are drawn [1/s]


@dataclass(frozen=True)
class Options(StudyOptions):
    """Options of the study."""

    bounds = Bounds(arms=(8, 10_000))

    names: tuple[str, ...] = ()
    """Controllers to show. Default: all."""
    arms: int = 256
    """Arms for each cost, 8 to 10000. Where one thing is changed, a quarter of them."""


def measure(options: Options) -> dict[str, Any]:
    """Everything about the chosen controllers; `PRIVILEGED`, the last, has costs alone.

    Raises:
        ValueError: If a name is unknown, or the file of gains is damaged.
    """
    names = chosen("controller", options.names, CONTROLLERS)
    rows = {}
    for name in progress_over("controllers", [*names, PRIVILEGED]):
        make = PrivilegedController if name == PRIVILEGED else costs.blind(CONTROLLERS[name]())
        rows[name] = costs.measure_costs(make, options.arms, options.arms // 4)
        if name != PRIVILEGED:
            rows[name]["loop"] = scan(CONTROLLERS[name]())
    return {
        "arms": options.arms,
        "moves": options.arms // 4,
        "first_seed": LOOPS.first,
        "oracle": PRIVILEGED,
        "changes": [change.title for change in costs.CHANGES],
        "limits": [change.title for change in costs.LIMITS],
        "corners": ARMS,
        "asked": {"modulus": MarginCondition().modulus, "delay": MarginCondition().delay},
        "controllers": rows,
        "gains": {name: gains(name) for name in names},
    }


def scan(controller: Any) -> dict[str, Any]:
    """Margins and poles of a controller on `ARMS` at each of `ANGLES`, as the page shows them.

    Raises:
        ValueError: If there is no linear law for the controller.
    """
    least, closed = margins_on(controller)
    margins = {name: np.where(least.stable, getattr(least, name), none) for name, none in NONE_LEFT.items()}
    poles = [continuous(at_angle) for at_angle in closed[0]]
    shown = [p[(p.imag > -1e-6) & (p.imag < _PLANE[1]) & (p.real > _PLANE[0])] for p in poles]
    return {
        "stable": bool(least.stable.all()),
        "stable_design": bool(least.stable[0].all()),
        "slowest": max(float(at_angle.real.max()) for at_angle in poles),
        "worst": {name: worst(name, values) for name, values in margins.items()},
        "worst_design": {name: worst(name, values[:1]) for name, values in margins.items()},
        "modulus_by_arm": margins["modulus"].min(axis=1),
        "design": {name: values[0] for name, values in margins.items()},
        "over_arms": {
            name: values.max(axis=0) if name == "gain_down" else values.min(axis=0) for name, values in margins.items()
        },
        "poles": [np.stack([each.real, each.imag], axis=-1) for each in shown],
    }


def worst(name: str, values: Floats) -> dict[str, Any]:
    """Worst value of a margin, shape (arms, 46), with its arm and its angle [degrees]."""
    place = values.argmax() if name == "gain_down" else values.argmin()
    arm, k = np.unravel_index(int(place), values.shape)
    return {"value": values[arm, k], "arm": ARMS[arm], "degrees": np.degrees(ANGLES[k])}


def gains(name: str) -> dict[str, Any]:
    """Gains of a controller with the ranges that are searched, and the provenance of their tuning, if there was one."""
    own, tuned = CONTROLLERS[name]().gains, name in TUNABLE
    origin = read_file().get(name, {}).get("provenance") if tuned else None
    shown = ("command", "seed", "steps", "trials", "refused", "seconds", "date", "commit", "cost_untuned", "cost")
    return {
        "law": type(own).__name__,
        "values": [
            {"name": gain.name, "value": getattr(own, gain.name), "searched": (tuned and dict(gain.metadata)) or None}
            for gain in fields(own)
        ],
        "tuning": origin and {key: origin[key] for key in (*shown, "measured_on")},
    }


# Page

Data = dict[str, Any]
_MARGINS = {"gain_up": "gain up", "gain_down": "gain down", "phase": "phase (°)", "delay": "delay (samples)"}
_MARGINS |= {"modulus": "modulus"}
"""Title of each margin."""
_DIGITS = {"phase": 0, "delay": 1, "modulus": 2}
_PANELS = (
    (("gain_up", "gain_down"), "gain (dB)", (-45.0, 45.0), (-30, 0, 30), (6.0, -6.0)),
    (("phase",), "phase (°)", (0.0, 115.0), (0, 50, 100), (30.0,)),
    (("delay",), "delay (samples)", (0.5, 200.0), (1, 10, 100), ()),
    (("modulus",), "modulus", (0.0, 1.05), (0, 0.5, 1), ()),
)
"""Margins, title, limits and marks of the axis, and levels beside those that are asked for."""


def tables(data: Data) -> Data:
    """Controllers as the template names them, texts of margins and ratios, and names for its sentences."""
    rows = data["controllers"]
    ranked = {name: row for name, row in rows.items() if name != data["oracle"]}
    searches = {name: entry["tuning"] for name, entry in data["gains"].items() if entry["tuning"]}
    return {
        "labelled": {f"*{name}* (not ranked)" if name == data["oracle"] else name: row for name, row in rows.items()},
        "ranked": ranked,
        "titles": _MARGINS,
        "margin": margin_text,
        "ratio": lambda value, left=0: f"{value:.{2 if value < 9.95 else 0}f}{f' ({left} left)' if left else ''}",
        "shown": costs.SHOWN_METRICS,
        "torques": TORQUES,
        "kept": [name for name, search in searches.items() if search["cost"] == search["cost_untuned"]],
    }


def margin_text(name: str, value: float | None) -> str:
    """A margin as text; a dash where there is none."""
    if name in _DIGITS:
        return shown(value, _DIGITS[name])
    return f"×{value:.3g}" if value and isfinite(value) else "–"


def pictures(data: Data) -> Pictures:
    """All pictures, by the name of their file; small letters are legible where a page is 800 pixels wide."""
    scans = {name: row["loop"] for name, row in data["controllers"].items() if "loop" in row}
    return {"margins.png": lambda: _margins(scans, data["asked"]), "poles.png": lambda: _poles(scans)}


def _margins(scans: Data, asked: dict[str, float]) -> Figure:
    """One row for each controller, one column for each margin, axes shared down the columns."""
    figure, axes = panels(len(scans) * len(_PANELS), len(_PANELS), (2.25, 0.95), sharex=True, sharey="col")
    for axis, ((name, scan), (margins, title, limits, marks, levels)) in zip(
        axes, product(scans.items(), _PANELS), strict=True
    ):
        for margin in margins:
            axis.plot(np.degrees(ANGLES), _drawn(margin, scan["over_arms"][margin]), color=VERMILION, lw=1.6)
            axis.plot(np.degrees(ANGLES), _drawn(margin, scan["design"][margin]), color=BLUE, lw=1.8)
        axis.hlines(levels or asked[margins[0]], 0, 90, color="0.55", lw=0.9, ls="--", zorder=1)
        axis.grid(color="0.92", lw=0.6)
        axis.tick_params(labelsize=9.5)
        axis.set(yscale="log" if "delay" in margins else "linear", xlim=(0, 90), xticks=(0, 30, 60, 90), ylim=limits)
        axis.set_yticks(marks, [f"{mark:g}" for mark in marks])
        if axis in axes[: len(_PANELS)]:
            axis.set_title(title, fontsize=11)
        if axis in axes[:: len(_PANELS)]:
            axis.set_ylabel(name, rotation=0, ha="right", va="center", labelpad=8, fontsize=11)
    figure.supxlabel("joint angle (°)", fontsize=11)
    return figure


def _drawn(margin: str, known: list[float | None]) -> Floats:
    """Margins as drawn: gains in dB, NaN, which is not drawn, where there is no margin."""
    values = np.array(known, dtype=np.float64)
    return 20 * np.log10(np.where(values > 0, values, np.nan)) if margin.startswith("gain") else values


def _poles(scans: Data) -> Figure:
    """Closed-loop poles in the upper half plane, coloured by the angle of the arm."""
    figure, axes = panels(len(scans), 4, (2.25, 2.3), sharex=True, sharey=True)
    shown_poles = None
    for axis, (name, scan) in zip(axes, scans.items(), strict=True):
        angles = np.repeat(np.degrees(ANGLES), [len(poles) for poles in scan["poles"]])
        real, imaginary = np.concatenate([np.reshape(poles, (-1, 2)) for poles in scan["poles"]]).T
        shown_poles = axis.scatter(real, imaginary, c=angles, vmin=0, vmax=90, cmap="viridis", s=7, zorder=3)
        damping_lines(axis, 0.1, 0.3)
        axis.set(xlim=(-62, 4), ylim=(-2, 72))
        axis.set_title(name, fontsize=11)
        axis.tick_params(labelsize=9.5)
        axis.grid(color="0.94", lw=0.6)
    figure.supxlabel("real part (1/s)", fontsize=11)
    figure.supylabel("imaginary part (1/s)", fontsize=11)
    if shown_poles is not None:
        figure.colorbar(shown_poles, ax=axes, label="joint angle (°)", shrink=0.6, ticks=(0, 30, 60, 90))
    return figure
