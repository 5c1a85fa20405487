"""The study of the controllers' loops, costs and times: everything that the page shows."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TypeVar

from baselines import CONTROLLERS
from beltarm_env.task.seeds import LOOPS
from eval.comparison.check import Times, measure_times
from eval.loops.costs import Costs, OracleCosts, makers, measure, oracle
from eval.loops.identification import Beside, worth
from eval.loops.price import Price, price
from eval.loops.scan import Scan, scan

Result = TypeVar("Result")


@dataclass(frozen=True)
class Sizes:
    """Numbers of arms."""

    arms: int  # as they are built, per cost
    moves: int  # of the design model, per cost with one thing changed
    batch: int  # of the times


@dataclass(frozen=True)
class LoopStudy:
    """Results by controller; `costs` also has the privileged yardstick, last."""

    sizes: Sizes
    scans: dict[str, Scan]
    costs: dict[str, Costs]
    times: dict[str, Times]
    prices: dict[str, Price]
    worth: list[Beside]  # of identification; empty if the controller that identifies is not asked about
    oracle: OracleCosts


def run_study(names: Sequence[str], sizes: Sizes, tell: Callable[[str], object]) -> LoopStudy:
    """Compute everything about some of `CONTROLLERS`, reporting progress with `tell`.

    Raises:
        ValueError: If gains, a policy or the oracle's file are damaged, or a controller has no linear law.
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
    costs = of_each("costs", known, lambda name: measure(known[name], sizes.arms, sizes.moves))
    prices = of_each("price of margins", names, lambda name: price(name, costs[name].built["cost"]))
    times = of_each("times", names, lambda name: measure_times(known[name]([]), sizes.batch, LOOPS.first))
    return LoopStudy(
        sizes=sizes,
        scans=scans,
        costs=costs,
        times=times,
        prices={name: found for name, found in prices.items() if found is not None},
        worth=worth({name: costs[name].built["cost"] for name in names}),
        oracle=oracle(),
    )
