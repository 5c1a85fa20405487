"""Classical controllers in numbers: margins, costs, limits, times and tuning of each.

Poles and margins of the closed loop over joint angle and arms; cost and metrics on arms as they are built; cost with
one thing changed; the price of the margins; what identification is worth; time per action; gains and their tuning.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np

from baselines import CONTROLLERS, TUNABLE
from baselines.gains import read_file
from baselines.loops.condition import CORNERS, MarginCondition, margins_on
from baselines.loops.models import continuous
from baselines.models.linear import ANGLES
from baselines.tools.command import require_known
from baselines.tools.progress import progress_over
from baselines.yardsticks.privileged import PrivilegedController
from beltarm_env.arrays import Floats
from beltarm_env.task.seeds import LOOPS
from eval.comparison.check import measure_times
from eval.studies._frame import StudyOptions
from eval.studies.loops.costs import CHANGES, LIMITS, blind, measure_costs, optimum, price, worth
from eval.studies.loops.page import pictures, tables

__all__ = ["QUICK", "Options", "measure", "pictures", "tables"]
ORACLE = "privileged"
"""Name of the controller that knows arm and state; never ranked."""
QUICK = {"names": ("paper", "ei"), "arms": 8, "batch": 2}
ARMS = tuple(CORNERS)
"""Arms that loops are looked at on; the first is the design model."""
NONE_LEFT = {"gain_up": 1.0, "gain_down": 1.0, "phase": 0.0, "delay": 0.0, "modulus": 0.0}
"""Margins by name, and their values for an unstable loop."""
_PLANE = (-62.0, 72.0)  # smallest real and largest imaginary part of the poles that are drawn [1/s]


@dataclass(frozen=True)
class Options(StudyOptions):
    """Options of the study."""

    bounds: ClassVar[Mapping[str, tuple[int, int | None]]] = {"arms": (8, 10_000), "batch": (1, LOOPS.size)}

    names: tuple[str, ...] = ()
    """Controllers to show. Default: all."""
    arms: int = 256
    """Arms for each cost, 8 to 10000. Where one thing is changed, a quarter of them."""
    batch: int = 256
    """Arms of the batch that is timed."""


def measure(options: Options) -> dict[str, Any]:
    """Everything about the chosen controllers; `ORACLE`, the last, has costs alone.

    Raises:
        ValueError: If a name is unknown, or a file of gains or of the optimum is damaged.
    """
    require_known(options.names, CONTROLLERS, "no controller {} to show: --names")
    names = list(dict.fromkeys(options.names)) or list(CONTROLLERS)
    entries, built_costs, rows = {}, {}, {}
    makers = {**{name: blind(CONTROLLERS[name]()) for name in names}, ORACLE: PrivilegedController}
    for name, make in progress_over("controllers", list(makers.items())):
        built, rows[name] = measure_costs(make, options.arms, options.arms // 4)
        if name == ORACLE:
            continue
        built_costs[name] = built
        rows[name] |= {
            "loop": scan(CONTROLLERS[name]()),
            "price": price(name, built),
            "times": measure_times(make([]), options.batch, LOOPS.first),
        }
        entries[name] = gains(name)
    return {
        "arms": options.arms,
        "moves": options.arms // 4,
        "batch": options.batch,
        "first_seed": LOOPS.first,
        "oracle": ORACLE,
        "changes": [change.title for change in CHANGES],
        "limits": [change.title for change in LIMITS],
        "corners": ARMS,
        "asked": {"modulus": MarginCondition().modulus, "delay": MarginCondition().delay},
        "controllers": rows,
        "gains": entries,
        "worth": worth(built_costs),
        "optimum": optimum(),
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
    own = CONTROLLERS[name]().gains
    origin = read_file().get(name, {}).get("provenance") if name in TUNABLE else None
    shown = ("command", "seed", "steps", "trials", "refused", "seconds", "date", "commit", "cost_untuned", "cost")
    return {
        "law": type(own).__name__,
        "values": [
            {"name": gain.name, "value": getattr(own, gain.name), "searched": dict(gain.metadata) or None}
            for gain in fields(own)
        ],
        "tuning": origin and {key: origin[key] for key in (*shown, "measured_on")},
    }
