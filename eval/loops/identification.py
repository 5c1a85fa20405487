"""What identification is worth arm by arm: `adaptive` over controllers that believe in the design model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from baselines import CONTROLLERS
from baselines.estimation.identification import IdentifyingController
from beltarm_env.arrays import Floats
from eval.comparison.statistics import interquartile_mean
from eval.loops.costs import blind, built_arms, run_arms
from eval.studies.steps.study import BESIDE

IDENTIFYING = BESIDE.name
"""Name of the controller that is asked about."""
WORSE = 1.2
"""Cost over that of another controller on the same arm from which it counts as worse."""


@dataclass(frozen=True)
class Beside:
    """Costs of the controller that identifies and of another one on the same arms, each of shape (n,)."""

    title: str  # of the other
    own: Floats
    other: Floats

    @property
    def worse(self) -> int:
        """Number of arms that cost over `WORSE` times as much."""
        return int((self.own > WORSE * self.other).sum())

    @property
    def worst(self) -> float:
        """Largest ratio of one arm's costs."""
        return float(np.max(self.own / self.other))


def worth(costs: Mapping[str, Floats]) -> list[Beside]:
    """Identification beside the same law without it, and beside the best of the controllers that do not identify.

    Args:
        costs: By name of `CONTROLLERS`, on the same arms, each of shape (n,). Without `IDENTIFYING` there is no answer.
    """
    if IDENTIFYING not in costs or BESIDE.make is None:
        return []
    own = costs[IDENTIFYING]
    others = [name for name in costs if not isinstance(CONTROLLERS[name](), IdentifyingController)]
    best = sorted(others, key=lambda name: interquartile_mean(costs[name]))[:1]
    same = run_arms(blind(BESIDE.make()), built_arms(len(own))).cost
    return [Beside(BESIDE.title, own, same), *(Beside(f"`{name}`", own, costs[name]) for name in best)]
