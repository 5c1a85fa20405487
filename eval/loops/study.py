"""The study of the controllers' loops, costs and times: everything that the page shows."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

from baselines import CONTROLLERS
from baselines.loops.condition import LeastMargins, least_margins
from beltarm_env.task.seeds import LOOPS
from eval.comparison.timing import Times, measure_times
from eval.loops.costs import Costs, OracleCosts, makers, measure, oracle
from eval.loops.scan import Scan, scan

Result = TypeVar("Result")


class DrivenMargins(NamedTuple):
    """Least margins of a controller over all angles, with the drive as it is built."""

    design: LeastMargins  # on the design model
    corners: LeastMargins  # on it and at the corners of the training ranges


def driven_margins(controller: Any) -> DrivenMargins:
    """Least margins of a controller with the drive as it is built."""
    return DrivenMargins(least_margins(controller, ("design model",)), least_margins(controller))


@dataclass(frozen=True)
class LoopStudy:
    """Results by controller; `costs` also has the privileged yardstick, last."""

    arms: int  # per cost
    batch: int  # of the times
    scans: dict[str, Scan]
    driven: dict[str, DrivenMargins]
    costs: dict[str, Costs]
    times: dict[str, Times]
    oracle: OracleCosts


def run_study(names: Sequence[str], arms: int, batch: int, tell: Callable[[str], object]) -> LoopStudy:
    """Compute everything about some of `CONTROLLERS`, reporting progress with `tell`.

    Raises:
        ValueError: If gains or the oracle's file are damaged, or a controller has no linear law.
    """
    known = makers(names)

    def of_each(what: str, chosen: Iterable[str], work: Callable[[str], Result]) -> dict[str, Result]:
        results = {}
        for name in chosen:
            began = time.perf_counter()
            results[name] = work(name)
            tell(f"{name}: {what}, {time.perf_counter() - began:.1f} s")
        return results

    scans = of_each("margins", names, lambda name: scan(CONTROLLERS[name]()))
    costs = of_each("costs", known, lambda name: measure(name, known[name], arms))
    times = of_each("times", names, lambda name: measure_times(known[name]([]), batch, LOOPS.first))
    driven = of_each("margins on drives", names, lambda name: driven_margins(CONTROLLERS[name]()))
    return LoopStudy(arms, batch, scans, driven, costs, times, oracle())
