"""The study of the controllers' loops, costs and times: everything that the page shows."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from baselines import CONTROLLERS
from baselines.models.linear import ANGLES
from beltarm_env.task.seeds import LOOPS
from eval.comparison.timing import Times, measure_times
from eval.loops.costs import Costs, OracleCosts, makers, measure, oracle
from eval.loops.models import Margins, Scan, scan

Result = TypeVar("Result")


@dataclass(frozen=True)
class LoopStudy:
    """Results by controller; `costs` also has the privileged yardstick, last."""

    arms: int  # per cost
    batch: int  # of the times
    scans: dict[str, Scan]
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
    return LoopStudy(arms, batch, scans, costs, times, oracle())


def worst(found: Scan, name: str) -> tuple[float, float]:
    """Worst value of a margin over the angles, and its angle [degrees]; only of `gain_down` is it the largest."""
    values = np.array([getattr(margin, name) for margin in found.margins])
    k = int(values.argmax() if name == "gain_down" else values.argmin())
    return float(values[k]), float(np.degrees(ANGLES[k]))


def at_angle(found: Scan, degrees: float) -> tuple[Margins, int]:
    """Margins at the tabulated angle nearest to one [degrees], and the index of that angle."""
    k = int(np.abs(np.degrees(ANGLES) - degrees).argmin())
    return found.margins[k], k
