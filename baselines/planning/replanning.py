"""Plans of arms about which more and more is known: made before the move, and anew while the arm moves.

Before the move the plan of `baselines.planning.plan` is made for the arm believed in, and improved for the task's own
cost (`baselines.planning.task_plan`). Every 30 ms the rest of the move is planned anew for arms whose estimated
constants have changed by more than 2 % (certainty equivalence: K. J. Astrom, B. Wittenmark: Adaptive Control, 1995).
Computing takes time: such a plan, which takes less than a sample, is begun after the torque is given, and acts from the
next sample on.

Around the reference's end, from 0.15 s before it to 0.3 s after it, every such plan is made, stale or not, from the
state that the arm is in, and improved by two steps: the squares hardly charge for the last millimetre, the task does.
So the arm is still sooner. Before, plans stay as the squares have them. Improved as well, they gain nothing more on
arms of the training ranges and lose on arms whose structure is not the plan's: what is cut so fine for an arm that is
believed in suits no other one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baselines.models.linear import write_linear_arm
from baselines.planning.plan import PLAN_COLUMNS, Plans, Weights, replaced
from baselines.planning.task_plan import Start, plan_room, plan_task
from beltarm_env import CONTROL_PERIOD, EPISODE_STEPS
from beltarm_env.arrays import Flags, Floats, Integers
from beltarm_env.engine import compiled, inlined
from beltarm_env.physics.models import LUMPED, Model
from beltarm_env.task.reference import MoveShape

STEPS = 6
"""Steps of improvement of the first plan, after which little is left to gain."""
EVERY = 20
"""Samples between plans."""
SETTLING_STEPS = 2
"""Steps of improvement of plans around the reference's end."""
_BEFORE, _AFTER = 100, 200  # samples before and after the reference's end in which plans are improved
_CHANGE = 0.02  # of a constant, relative, from which a plan is stale


@inlined
def settles(duration: float, step: int) -> bool:
    """Whether the end of a reference, `duration` [s] after its start, is near enough for plans to be improved."""
    beyond = step - duration / CONTROL_PERIOD
    return -_BEFORE <= beyond <= _AFTER


@inlined
def steps_of(duration: float, step: int, most: int) -> int:
    """Steps by which a plan made anew is improved: `most`, and at most `SETTLING_STEPS`, around the reference's end."""
    return min(most, SETTLING_STEPS) if settles(duration, step) else 0


@compiled
def is_stale(duration: float, step: int, logs: Floats, of_plan: Floats) -> bool:
    """Whether a plan made for some logarithms of constants, shape (m,), is to be made anew for others.

    Args:
        duration: Of the reference [s].
        step: Samples since the move's start.
        logs: See `Situation`.
        of_plan: Those that the plan was made for.
    """
    most = 0.0
    for k in range(len(logs)):
        most = max(most, abs(logs[k] - of_plan[k]))
    return step % EVERY == 0 and (most > _CHANGE or settles(duration, step))


@dataclass(frozen=True)
class Situation:
    """What plans of n arms are made for."""

    moves: Floats  # start, goal [rad], duration, ramp time [s]; shape (n, 4)
    step: Integers  # samples since the move's start, shape (n,)
    time: Floats  # the same when a command given now acts, shape (n,)
    states: Floats  # x then, shape (n, 4)
    logs: Floats  # of the estimated constants over their nominal values, shape (n, m)
    table: Floats  # constants that plans are made for, columns as `ArmParams`, shape (n, len(FIELDS))
    model: Model = LUMPED  # whose equations of motion plans rely on

    def plan(self, arm: int, weights: Weights, first: int, steps: int) -> Floats:
        """Plan of one arm from a sample on, shape (1200, 10), with `first` or improved by steps after it."""
        rows, move = np.zeros((EPISODE_STEPS, PLAN_COLUMNS)), MoveShape(*self.moves[arm].tolist())
        start = Start(first, float(self.time[arm]), self.states[arm], steps)
        room = plan_room()
        write_linear_arm(self.table[arm], self.model, room.model)
        plan_task(move, self.table[arm], weights, start, room, rows)
        return rows


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
        """Cache with plans for arms that begin a move, improved by some steps; those that begin alike share one."""
        if not begins.any():
            return self

        def plan(arm: int) -> Floats:
            return now.plan(arm, weights, 0, steps)

        tasks, first = np.column_stack([now.moves, now.time, now.states, now.table]), dict[bytes, int]()
        like = {arm: first.setdefault(tasks[arm].tobytes(), arm) for arm in np.flatnonzero(begins).tolist()}
        which = np.zeros(len(begins), np.bool_)
        which[list(first.values())] = True
        plans = replaced(self.plans, which, plan)
        for arm, other in like.items():
            plans[arm] = plans[other]
        return PlanCache(plans, np.where(begins[:, None], now.logs, self.logs))

    def renewed(self, now: Situation, weights: Weights, most: int = STEPS) -> PlanCache:
        """Cache with new plans for arms whose plans are stale, improved as `steps_of` says."""
        if not (now.step % EVERY == 0).any():
            return self
        duration = now.moves[:, 2].tolist()
        rows = zip(duration, now.step.tolist(), now.logs, self.logs, strict=True)
        stale = np.array([is_stale(*row) for row in rows])

        def plan(arm: int) -> Floats:
            step = int(now.step[arm])
            return now.plan(arm, weights, step, steps_of(duration[arm], step, most))

        return PlanCache(replaced(self.plans, stale, plan), np.where(stale[:, None], now.logs, self.logs))
