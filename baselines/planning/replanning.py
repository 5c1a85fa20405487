"""Plans of arms about which more and more is known: made before the move, and anew while the arm moves.

Before the move the plan of `baselines.planning.plan` is made for the arm believed in, and improved for the task's own
cost (`baselines.planning.task_plan`). Every 30 ms the rest of the move is planned anew for arms whose estimated
constants have changed by more than 2 % (certainty equivalence: K. J. Astrom, B. Wittenmark: Adaptive Control, 1995).
Computing takes time: such a plan, which takes less than a sample, is begun after the torque is given, and acts from the
next sample on.

Later plans stay as the squares have them. Improved as well, they gain little on arms of the training ranges and lose
more on arms whose structure is not the plan's: what is cut so fine for an arm that is believed in suits no other one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baselines.planning.plan import Plans, Weights, replanned
from baselines.planning.task_plan import anchored, improved
from beltarm_env.arrays import Flags, Floats, Integers

STEPS = 6
"""Steps of improvement of the first plan, after which little is left to gain."""
_EVERY = 20  # samples between plans
_CHANGE = 0.02  # of a constant, relative, from which a plan is stale


@dataclass(frozen=True)
class Situation:
    """What plans of n arms are made for."""

    moves: Floats  # start, goal [rad], duration, ramp time [s]; shape (n, 4)
    step: Integers  # samples since the move's start, shape (n,)
    time: Floats  # the same when a command given now acts, shape (n,)
    states: Floats  # x then, shape (n, 4)
    logs: Floats  # of the estimated constants over their nominal values, shape (n, m)
    table: Floats  # constants that plans are made for, columns as `ArmParams`, shape (n, len(FIELDS))


@dataclass(frozen=True)
class PlanCache:
    """Plans of n arms, with the estimated constants that they were computed for."""

    plans: Plans
    logs: Floats  # `Situation.logs` at the time; NaN where there is no plan

    @classmethod
    def empty(cls, logs: Floats) -> PlanCache:
        """Cache without any plan, for arms with constants as `Situation.logs`."""
        return cls([np.empty(0)] * len(logs), np.full_like(logs, np.nan))

    def begun(self, begins: Flags, now: Situation, weights: Weights, steps: int = STEPS) -> PlanCache:
        """Cache with plans for arms that begin a move, improved by some steps."""
        if not begins.any():
            return self
        cache = self._planned(begins, now, weights)
        plans = anchored(cache.plans, begins, now.time, now.states, now.moves, now.table)
        plans, _ = improved(plans, begins, now.time, now.moves, now.table, steps)
        return PlanCache(plans, cache.logs)

    def renewed(self, now: Situation, weights: Weights) -> PlanCache:
        """Cache with new plans for arms whose plans are stale."""
        stale = (np.abs(now.logs - self.logs).max(axis=1) > _CHANGE) & (now.step % _EVERY == 0)
        return self._planned(stale, now, weights) if stale.any() else self

    def _planned(self, which: Flags, now: Situation, weights: Weights) -> PlanCache:
        """Cache with new plans for some arms."""
        plans = replanned(self.plans, which, now.moves, now.table, weights)
        return PlanCache(plans, np.where(which[:, None], now.logs, self.logs))
