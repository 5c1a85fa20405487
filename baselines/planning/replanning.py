"""Plans of arms about which more and more is known: made anew and improved, a piece of work in each sample.

Before the move the plan of `baselines.planning.plan` is made for the arm believed in, and improved for the task's own
cost (`baselines.planning.task_plan`). Every 30 ms the rest of the move is planned anew for arms whose estimated
constants have changed by more than 2 % (certainty equivalence: K. J. Astrom, B. Wittenmark: Adaptive Control, 1995),
from where the arm is then, and improved in the samples after that.

Computing takes time. So no sample has more than one piece of work, a new plan or a step of improvement, each of which
takes less than a sample; it begins after the torque is given, and acts from the next sample on.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from baselines.planning.plan import Plans, Weights, replanned
from baselines.planning.task_plan import anchored, improved
from beltarm_env.arrays import Flags, Floats, Integers

STEPS = 6
"""Steps of improvement of a plan, after which little is left to gain."""
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
    steps_left: Integers  # steps of improvement to come, shape (n,)
    steps: int = STEPS  # of improvement of each plan

    @classmethod
    def empty(cls, logs: Floats, steps: int = STEPS) -> PlanCache:
        """Cache without any plan, for arms with constants as `Situation.logs`."""
        return cls([np.empty(0)] * len(logs), np.full_like(logs, np.nan), np.zeros(len(logs), np.intp), steps)

    def begun(self, begins: Flags, now: Situation, weights: Weights) -> PlanCache:
        """Cache with plans for arms that begin a move, improved as far as they will be."""
        if not begins.any():
            return self
        cache = self._planned(begins, now, weights)
        plans = cache.plans
        for _ in range(self.steps):
            plans, _ = improved(plans, begins, now.time, now.moves, now.table)
        return replace(cache, plans=plans, steps_left=np.where(begins, 0, cache.steps_left))

    def worked_on(self, now: Situation, weights: Weights) -> PlanCache:
        """Cache after the work of a sample: a new plan where the old one is stale, elsewhere a step of improvement."""
        stale = (np.abs(now.logs - self.logs).max(axis=1) > _CHANGE) & (now.step % _EVERY == 0)
        planned = self._planned(stale, now, weights) if stale.any() else self
        improving = (self.steps_left > 0) & ~stale
        if not improving.any():
            return planned
        plans, gained = improved(planned.plans, improving, now.time, now.moves, now.table)
        left = planned.steps_left - improving
        return replace(planned, plans=plans, steps_left=np.where(improving & ~gained, 0, left))

    def _planned(self, which: Flags, now: Situation, weights: Weights) -> PlanCache:
        """Cache with new plans for some arms, from their present states on."""
        plans = replanned(self.plans, which, now.moves, now.table, weights)
        plans = anchored(plans, which, now.time, now.states, now.moves, now.table)
        logs = np.where(which[:, None], now.logs, self.logs)
        return replace(self, plans=plans, logs=logs, steps_left=np.where(which, self.steps, self.steps_left))
