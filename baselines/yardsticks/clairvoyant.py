"""Clairvoyant optimum: the torques that minimise the environment's episode cost for the true arm and its drive.

    min  sum_k  |e_p| / 10 mm + |e_v| / 200 mm/s + 0.1 |u_k - u_(k-1)| / limit        (beltarm_env/task/cost.py)
    s.t. |u_k| <= limit

over the commands u_k of a whole move, from rest at its start or from where the optimum of the move before ended. The
arm is the environment's own simulation, so that torques cost here what they cost when they are replayed.

From torques that move the arm, `privileged`'s say, each iteration

1. linearises simulation and tip about the motion so far, friction included (`baselines.planning.norm_optimal`),
2. finds the norm-optimal change for each of several prices on the change itself, from almost none to one that allows
   hardly any (K. Levenberg 1944; D. Marquardt 1963), the norms being squares whose weights have the norms' slope there,
3. simulates all of them side by side, each with the feedback that belongs to it, and keeps the cheapest one.

That is differential dynamic programming without second derivatives of the motion (D. Jacobson, D. Mayne: Differential
Dynamic Programming, 1970; W. Li, E. Todorov: Iterative linear quadratic regulator design, ICINCO 2004), with limits on
the torque (Tassa, Mansard, Todorov 2014). It ends where ten iterations gain less than a ten-thousandth.

A motor that rests feels no small change of torque, so the search has to begin with a motion, and its result is a local
optimum: an attainable cost, close to the least, rather than a proven bound. On arms with an ideal drive it is the cost
of a nonlinear program (multiple shooting, IPOPT) within 0.05 %.

A shift is optimised move by move. Its cost is attainable, because each move begins with the state and the command with
which the last one ended. It is not proven the least: a move that costs a little more might end in a better state, and
each search is local. Searches from the torques of several controllers end some per cent apart: give it several.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from baselines.planning.norm_optimal import Linearisation, norm_weights, optimal_change
from beltarm_env import ArmParams
from beltarm_env.arm import Plant
from beltarm_env.arrays import Flags, Floats, Singles
from beltarm_env.engine import compiled
from beltarm_env.physics.drive import Drive, real_drive_of
from beltarm_env.physics.kinematics import tip_motion
from beltarm_env.physics.state import ArmState
from beltarm_env.recording import Recording
from beltarm_env.simulation import ArmSimulation
from beltarm_env.task.cost import step_cost
from beltarm_env.task.reference import MoveShape, sampled_moves

_SOFTNESS = (1e-2, 1e-3, 1e-4)  # share of their scale below which errors and torque changes weigh no more, in turn
_PRICES = np.logspace(-3, 6, 16)  # R of the change [1/(N m)^2]
_PATIENCE = 10  # iterations
_WORTHWHILE = 1e-4  # share of the cost that these have to gain


class Optimum(NamedTuple):
    """Torques of least cost for one move."""

    actions: Singles  # commanded torque over the limit, shape (T,)
    cost: float
    end: Floats  # state after the last sample, as `ArmSimulation` has it, shape (size,)


class _Motion(NamedTuple):
    """Motion of one arm over T samples, or, with an axis of n before each shape, of n candidates."""

    states: Floats  # before each sample and after the last, as `ArmSimulation` has them, shape (T + 1, size)
    actions: Floats  # commanded torque over the limit, in single precision, shape (T,)
    cost: Floats  # of the move, shape ()


class _Arm:
    """One arm and move, simulated with `count` candidates side by side.

    Args:
        params: The arm.
        move: The move.
        steps: T, samples of the move.
        count: Number of candidates.
        before: The move before; None for an arm at rest.
    """

    def __init__(self, params: ArmParams, move: MoveShape, steps: int, count: int, before: Optimum | None) -> None:
        self._row, self.limit = params.row(), params.torque_limit
        self._plant, self._drive = params.plant(), real_drive_of(self._row)
        self._task = np.ascontiguousarray(sampled_moves(np.array([move]), steps)[0, 1:, :2])
        self._simulation = ArmSimulation(params, count)
        self._table = np.repeat(self._row[None], count, axis=0)
        rest = self._simulation.at_rest(np.full(count, params.gear_ratio * move.start))
        self._start, self._before = rest, 0.0
        if before is not None:
            self._start, self._before = np.repeat(before.end[None], count, axis=0), float(before.actions[-1])
        self._linearisation = Linearisation(params, steps)
        self.size = self._simulation.size

    def moved(self, about: _Motion, change: Floats, gain: Floats) -> _Motion:
        """Motions under the torques of a motion, changed by `change` - `gain` z, of shapes (n, T) and (n, T, size + 1).

        z is the deviation from that motion's states, and that of the last torque.
        """
        x, actions = self._start, np.empty(change.shape)
        states, last = np.empty((len(x), change.shape[1] + 1, x.shape[1])), np.zeros((len(x), 1))
        states[:, 0] = x
        for k, planned in enumerate(about.actions * self.limit):
            z = np.concatenate([x - about.states[k], last], axis=1)
            torque = planned + change[:, k] - (gain[:, k] * z).sum(axis=1)
            actions[:, k] = np.clip(torque / self.limit, -1, 1).astype(np.float32)
            self._simulation.set_table(self._table, np.full(len(x), float(k)))
            x = self._simulation.advance(x, actions[:, k] * self.limit)
            states[:, k + 1], last = x, (actions[:, k] * self.limit - planned)[:, None]
        return _Motion(states, actions, _costs(states, actions, self._before, self._task, self._plant, self._drive))

    def changes(self, motion: _Motion, softness: float) -> tuple[Floats, Floats]:
        """Norm-optimal changes of a motion at each price, shape (n, T), and their gains, shape (n, T, size + 1)."""
        torque, before = motion.actions * self.limit, self._before * self.limit
        trial = self._linearisation.about(motion.states[:-1], torque, self._task, self._row)
        step = np.diff(torque, prepend=before)
        found = []
        for price in _PRICES:
            weights = norm_weights(trial.errors, step, self.limit, price, (softness, softness))
            found.append(optimal_change(trial, weights, torque, self.limit, before))
        changes, gains, _ = zip(*found, strict=True)
        return np.array(changes), np.array(gains)


@compiled
def _costs(states: Floats, actions: Floats, before: float, task: Floats, plant: Plant, drive: Drive | None) -> Floats:
    """Cost of n motions, shape (n,); `before` is the action before them."""
    costs = np.zeros(len(states))
    for i in range(len(states)):
        last = before
        for k in range(len(task)):
            x, action = states[i, k + 1], actions[i, k]
            tip = tip_motion(ArmState(x[0], x[1], x[2], x[3]), plant, drive)
            terms = step_cost(tip, task[k, 0], task[k, 1], action, last, plant)
            costs[i] += terms.position + terms.velocity + terms.torque_rate
            last = action
    return costs


def optimum(params: ArmParams, move: MoveShape, actions: Floats | Singles, before: Optimum | None = None) -> Optimum:
    """Torques of least cost for this arm and move, over as many samples as the actions that the search begins with.

    Args:
        params: The arm.
        move: The move.
        actions: Torques over the limit under which the arm moves, shape (T,).
        before: The move before, with whose end this one begins; None for an arm at rest.
    """
    arm, begin = _Arm(params, move, len(actions), len(_PRICES), before), np.asarray(actions, np.float64)
    still = np.zeros((len(_PRICES), len(begin)))
    rest = np.zeros((len(begin) + 1, arm.size))
    best = _cheapest(arm.moved(_Motion(rest, begin, np.zeros(())), still, np.zeros((*still.shape, arm.size + 1))))
    costs = [float(best.cost)]
    for softness in _SOFTNESS:
        began = len(costs)
        while len(costs) - began < _PATIENCE or costs[-_PATIENCE - 1] - costs[-1] > _WORTHWHILE * costs[-1]:
            found = _cheapest(arm.moved(best, *arm.changes(best, softness)))
            if found.cost >= best.cost:
                break
            best = found
            costs.append(float(best.cost))
    return Optimum(best.actions.astype(np.float32), costs[-1], best.states[-1])


def _cheapest(motions: _Motion) -> _Motion:
    return _Motion(*(part[np.argmin(motions.cost)] for part in motions))


def shift_optimum(*guesses: Recording) -> list[Optimum]:
    """Torques of least cost for each move of a shift, each from where the optimum of the move before ended.

    Args:
        *guesses: The same shift of one arm under several controllers. A search begins with the torques of each, and the
            cheapest result is kept.

    Raises:
        ValueError: If there are several arms in a recording.
    """
    if (most := max(guess.num_arms for guess in guesses)) > 1:
        raise ValueError(f"a shift is optimised for one arm, got a recording of {most}: give recording.arm(k)")
    found = list[Optimum]()
    for k in range(guesses[0].num_moves):
        params = ArmParams.from_row(guesses[0].params[k])
        move, before = MoveShape(*map(float, guesses[0].moves[k])), found[-1] if found else None
        begins = [guess.torque[:, k] / params.torque_limit for guess in guesses]
        found.append(min((optimum(params, move, begin, before) for begin in begins), key=lambda best: best.cost))
    return found


class Replay:
    """Controller that plays actions, torque over the limit of shape (n, samples), whatever it observes."""

    def __init__(self, actions: Singles) -> None:
        self._actions = actions

    def predict(
        self, observation: Singles, state: Any = None, episode_start: Flags | None = None, deterministic: bool = True
    ) -> tuple[Singles, int]:
        """Actions of the current sample, and the number of the next one; see `Controller`."""
        sample = state or 0
        return self._actions[:, sample, None], sample + 1
