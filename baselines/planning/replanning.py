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

from baselines.planning.plan import PLAN_COLUMNS, Plans, Weights, plan_cost, planned, replaced, rows_at, step_of_plan
from baselines.planning.task_plan import plan_room, plan_task
from beltarm_env import EPISODE_STEPS
from beltarm_env.arrays import Flags, Floats, Integers
from beltarm_env.engine import compiled
from beltarm_env.task.reference import MoveShape

STEPS = 6
"""Steps of improvement of the first plan, after which little is left to gain."""
EVERY = 20
"""Samples between plans."""
_CHANGE = 0.02  # of a constant, relative, from which a plan is stale
_NEAR = EVERY + 8  # rows of a plan: those that are read before the next one, where commands act 6 samples later


@compiled
def is_stale(step: int, logs: Floats, of_plan: Floats) -> bool:
    """Whether a plan is to be made anew.

    Args:
        step: Samples since the move's start.
        logs: Of the estimated constants over their nominal values, shape (m,).
        of_plan: Those that the plan was made for.
    """
    most = 0.0
    for k in range(len(logs)):
        most = max(most, abs(logs[k] - of_plan[k]))
    return most > _CHANGE and step % EVERY == 0


@compiled
def _mark_stale(steps: Integers, logs: Floats, of_plans: Floats, stale: Flags) -> None:
    for arm in range(len(steps)):
        stale[arm] = is_stale(steps[arm], logs[arm], of_plans[arm])


@compiled
def _copy_pairs(near: Floats, first: Integers, time: Floats, pairs: Floats) -> bool:
    """Copy the rows before and after some times; tell whether all of them are near."""
    for arm in range(len(time)):
        step, _ = step_of_plan(time[arm])
        at = step - first[arm]
        if not 0 <= at < near.shape[1] - 1:
            return False
        for row in range(2):
            for column in range(pairs.shape[2]):
                pairs[arm, row, column] = near[arm, at + row, column]
    return True


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
    near: Floats  # rows of the plans from `first` on, for all arms in one piece of memory, shape (n, _NEAR, 10)
    first: Integers  # shape (n,)

    @classmethod
    def empty(cls, logs: Floats) -> PlanCache:
        """Cache without any plan, for arms with constants as `Situation.logs`."""
        count = len(logs)
        near = np.zeros((count, _NEAR, PLAN_COLUMNS))
        return cls([np.empty(0)] * count, np.full_like(logs, np.nan), near, np.zeros(count, np.intp))

    def begun(self, begins: Flags, now: Situation, weights: Weights, steps: int = STEPS) -> PlanCache:
        """Cache with plans for arms that begin a move, improved by some steps; those that begin alike share one."""
        if not begins.any():
            return self
        cost = plan_cost(weights)

        def plan(arm: int) -> Floats:
            rows, move = np.empty((EPISODE_STEPS, PLAN_COLUMNS)), MoveShape(*now.moves[arm].tolist())
            plan_task(move, now.table[arm], cost, float(now.time[arm]), now.states[arm], steps, plan_room(), rows)
            return rows

        tasks, first = np.column_stack([now.moves, now.time, now.states, now.table]), dict[bytes, int]()
        like = {arm: first.setdefault(tasks[arm].tobytes(), arm) for arm in np.flatnonzero(begins).tolist()}
        which = np.zeros(len(begins), np.bool_)
        which[list(first.values())] = True
        plans = replaced(self.plans, which, plan)
        for arm, other in like.items():
            plans[arm] = plans[other]
        return self._with(plans, np.where(begins[:, None], now.logs, self.logs), begins, now.step)

    def renewed(self, now: Situation, weights: Weights) -> PlanCache:
        """Cache with new plans for arms whose plans are stale."""
        due = now.step % EVERY == 0
        if not due.any():
            return self
        plans, stale = self.plans, np.empty(len(now.step), np.bool_)
        _mark_stale(now.step, now.logs, self.logs, stale)
        if stale.any():
            plans = replaced(
                plans, stale, lambda arm: planned(now.moves[arm], now.table[arm], weights, int(now.step[arm]))
            )
        return self._with(plans, np.where(stale[:, None], now.logs, self.logs), due, now.step)

    def rows_at(self, time: Floats) -> Floats:
        """Rows of the plans before and after times [samples] of shape (n,): shape (n, 2, 10)."""
        pairs = np.empty((len(time), 2, PLAN_COLUMNS))
        return pairs if _copy_pairs(self.near, self.first, time, pairs) else rows_at(self.plans, time)

    def _with(self, plans: Plans, logs: Floats, which: Flags, step: Integers) -> PlanCache:
        """Cache with other plans and logs, and the rows near a step for some arms."""
        near, first = self.near.copy(), np.where(which, np.minimum(step, EPISODE_STEPS - _NEAR), self.first)
        for arm, k in zip(np.flatnonzero(which).tolist(), first[which].tolist(), strict=True):
            near[arm] = plans[arm][k : k + _NEAR]
        return PlanCache(plans, logs, near, first)
