"""Race of trials on the same arms, and the division of a budget; see `baselines.tuning.search`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from beltarm_env import EPISODE_STEPS
from beltarm_env.arrays import Floats

RUNGS = (32, 64, 128)
"""Arms that a trial has run on when it is compared with the best; after the last it is complete."""
MARGIN = 1.0
"""Standard errors by which a trial must be worse than the best to be pruned."""
FINALISTS = 7
MOST_REVERSALS = 10.0
"""Of an arm's torque [1/s], beyond which its cost is charged in proportion."""
MAX_CHOICE_ARMS = 1000
MIN_BUDGET = RUNGS[-1] * EPISODE_STEPS * 5 // 4
"""Steps for one trial and a choice."""


class BudgetSplit(NamedTuple):
    """Division of a budget of simulated steps."""

    search: int  # steps
    arms: int  # of the choice, for each finalist and for the untuned gains


def split_budget(budget: int) -> BudgetSplit:
    """Divide a budget: a fifth for the choice, at most `MAX_CHOICE_ARMS` arms.

    Raises:
        ValueError: If the budget is too small.
    """
    if budget < MIN_BUDGET:
        raise ValueError(f"--budget must be at least {MIN_BUDGET} steps, enough for one trial, got {budget}")
    each = (FINALISTS + 1) * EPISODE_STEPS
    arms = min(MAX_CHOICE_ARMS, budget // 5 // each)
    return BudgetSplit(budget - arms * each, arms)


def charged(costs: Floats, reversals: Floats) -> Floats:
    """Charge arms whose torque reverses often: cost times reversals over `MOST_REVERSALS`, where that is above 1.

    Args:
        costs: Episode costs, shape (n,).
        reversals: Of the torque [1/s], shape (n,).
    """
    return costs * np.maximum(1.0, reversals / MOST_REVERSALS)


def estimate(costs: Floats, best: Floats) -> float:
    """Estimate a trial's mean cost on all arms from those that it has run on, and the best trial so far.

    Args:
        costs: Of the trial, shape (n,).
        best: Of the best trial, shape (at least n,); empty if there is none.
    """
    if len(costs) == RUNGS[-1] or not len(best):
        return float(costs.mean())
    return float(best.mean() + (costs - best[: len(costs)]).mean())


def hopeless(costs: Floats, best: Floats) -> bool:
    """Whether a trial has lost the race against the best one; arguments as those of `estimate`."""
    if not len(best):
        return False
    difference = costs - best[: len(costs)]
    return bool(difference.mean() > MARGIN * difference.std(ddof=1) / np.sqrt(len(difference)))
