"""Classical controllers in numbers: margins, costs, limits, times and tuning of each.

Poles and margins of the closed loop over joint angle and arms; cost and metrics on arms as they are built; cost with
one thing changed; the price of the margins; what identification is worth; time per action; gains and their tuning.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar

from baselines import CONTROLLERS, TUNABLE
from baselines.gains import read_file
from baselines.loops.condition import MarginCondition
from baselines.tools.command import require_known
from baselines.tools.progress import progress_over
from baselines.yardsticks.privileged import PrivilegedController
from beltarm_env.task.seeds import LOOPS
from eval.comparison.check import measure_times
from eval.studies._frame import StudyOptions
from eval.studies.loops.changes import CHANGES, LIMITS
from eval.studies.loops.costs import blind, measure_costs, optimum, price, worth
from eval.studies.loops.page import pictures, tables
from eval.studies.loops.scan import ARMS, scan

__all__ = ["QUICK", "Options", "measure", "pictures", "tables"]
ORACLE = "privileged"
"""Name of the controller that knows arm and state; never ranked."""
QUICK = {"names": ("paper", "ei"), "arms": 8, "batch": 2}


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
