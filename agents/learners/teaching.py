"""Advice to a student: the best torques of an episode, computed with the true constants of arm and drive.

After the episode the teacher simulates it once more, by the environment's own equations with the true constants, and
linearises it about the motion that the student made (`baselines.planning.norm_optimal`). From the end backwards, the
linear-quadratic problem gives for every sample the change c[k] of the torque that would have been best *there*, in the
student's own state:

    Q_k(v) - Q_k(c[k]) = h[k] (v - c[k])^2,    c[k] = -q[k] / h[k]

with q the slope and h the curvature of the cost to go, both halved. Every later torque is assumed to be optimal, and to
react to the change by the problem's own feedback. A price of p u^2 per sample, u the residual as a share of the torque
limit, keeps residuals small where they change little, as while the motor sticks. Over the samples k for which a
residual u is held, the best one is

    y = u + sum (h[k] c[k] - p u) / sum (h[k] + p),    with weight w = sum (h[k] + p)

The slope q is that of the student's own cost: what the best later torques are does not enter it (the envelope theorem,
which `tests/agents/test_imitation.py` checks). So where E[w (y - u) | what the student sees] = 0, no small change of
its torques lowers its expected cost and price, and fitting u to y with weights w is a Gauss-Newton step towards there.

Of a shift every move is advised on by itself, in the state that it begins in. The whole torque has no price: a student
that takes the base's torque away while the motor rests has to bring it back, and so the torque reverses more often.

D. Jacobson, D. Mayne: Differential Dynamic Programming, 1970; S. Levine, V. Koltun: Guided Policy Search, ICML 2013;
W. Sun et al.: Deeply AggreVaTeD: Differentiable Imitation Learning for Sequential Prediction, ICML 2017.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import torch

from agents.observer.quantities import NAMES, missed
from agents.residual.controller import ResidualSettings
from baselines.planning.norm_optimal import Linearisation, norm_weights, optimal_change
from beltarm_env import EPISODE_STEPS, design_model
from beltarm_env import observation as layout
from beltarm_env.arm import COLUMN
from beltarm_env.arrays import Flags, Floats, Singles
from beltarm_env.rollout import Controller, Recording
from beltarm_env.simulation import ArmSimulation
from beltarm_env.task.reference import sampled_moves
from beltarm_env.timing import CONTROL_PERIOD

TORQUE_PRICE = 5.0
"""Price of a change of the torque from sample to sample, over what the task charges."""
_EFFORT = 5.0  # R of a change [1/(N m)^2]: what keeps the advice finite where the motor sticks
_SOFT = (0.05, 0.1)  # shares of their scales below which errors, and changes of the torque, weigh no more
_ELAPSED = layout.index("elapsed_time")
_SCALE_OF_TIME = layout.scales()[_ELAPSED] / CONTROL_PERIOD  # to samples


class Advice(NamedTuple):
    """Inputs of a student through its episodes, what it should have answered, and how much it matters."""

    inputs: torch.Tensor  # shape (holds of all moves, arms, inputs), half precision
    labels: torch.Tensor  # best residuals, shape (holds of all moves, arms)
    weights: torch.Tensor  # of mean 1, shape (holds, arms)
    missed: torch.Tensor  # by what the filter is wrong, see `agents.observer.quantities`, (holds, arms, quantities)


class Recorder:
    """Policy whose inputs and residuals are kept, of each call; `pause` is called before each."""

    def __init__(self, policy: Controller, pause: Callable[[int], object] = lambda _: None) -> None:
        self._policy = policy
        self.pause = pause
        self.inputs: list[Singles] = []
        self.residuals: list[Singles] = []

    def predict(
        self, observation: Singles, state: Any = None, episode_start: Flags | None = None, deterministic: bool = True
    ) -> tuple[Singles, Any]:
        """Call the policy's `predict`, and keep what it sees and chooses."""
        self.pause(len(observation))
        residual, memory = self._policy.predict(observation, state, episode_start, deterministic)
        self.inputs.append(observation)
        self.residuals.append(residual)
        return residual, memory

    def held(self, arm: int, hold: int) -> tuple[Singles, Floats]:
        """Inputs and residuals as each hold of this arm began, shape (holds, arms, inputs) and (holds, arms).

        An arm that left its workspace and began anew was asked for at other samples.
        """
        inputs = np.stack(self.inputs)
        began = np.rint(inputs[:, arm, _ELAPSED] * _SCALE_OF_TIME).astype(int) % hold == 0
        return inputs[began], np.stack(self.residuals)[began, :, 0].astype(np.float64)


def advise(recording: Recording, recorder: Recorder, settings: ResidualSettings, price: float) -> Advice:
    """Say for every hold of every arm what a student should have done; only of arms that stayed in their workspace.

    Args:
        recording: Episodes under the student.
        recorder: The student's inputs and residuals in them; its `pause` is called before each arm, with zero.
        settings: Of the student's residual.
        price: p of the residual, over the torque limit squared; h is about 5.
    """
    hold, limit, moves = settings.hold, settings.limit, recording.num_moves
    stayed = np.flatnonzero(recording.stayed)
    if not len(stayed):  # and so the episodes broke off
        nothing = torch.zeros(moves * -(-EPISODE_STEPS // hold), 0)
        inputs = torch.zeros(*nothing.shape, recorder.inputs[0].shape[1]).half()
        return Advice(inputs, nothing, nothing, torch.zeros(*nothing.shape, len(NAMES)))
    changes, curvatures = best_changes(recording, pause=recorder.pause)

    def sums(samples: Floats) -> Floats:
        """Sums over holds, the last of a move may be shorter, of arms that stayed: shape (holds of all moves, arms)."""
        of_holds = np.add.reduceat(samples, np.arange(0, EPISODE_STEPS, hold), axis=0)
        return recording.in_turn(of_holds)[:, stayed]

    seen, residuals = recorder.held(stayed[0], hold)
    by_move = np.concatenate(np.split(residuals, moves), axis=1)  # with columns as the recording's
    own = np.repeat(by_move * limit, hold, axis=0)[:EPISODE_STEPS]
    slopes, weights = sums(changes * curvatures - price * own), sums(curvatures + price)
    best = np.clip(residuals[:, stayed] + slopes / weights / limit, -1.0, 1.0)
    arrays = best, weights / weights.mean(), missed(recording, seen, hold, settings.knowledge)[:, stayed]
    labels, weights, errors = (torch.from_numpy(array.astype(np.float32)) for array in arrays)
    return Advice(torch.from_numpy(seen[:, stayed]).half(), labels, weights, errors)


def best_changes(
    recording: Recording, torque_price: float = TORQUE_PRICE, pause: Callable[[int], object] = lambda _: None
) -> tuple[Floats, Floats]:
    """Best changes c of every commanded torque, and half the curvatures h of the cost to go.

    Args:
        recording: Moves, n in all, on the trapezoid reference.
        torque_price: What a change of the torque from sample to sample costs, over what the task charges.
        pause: Called before each arm, with zero.

    Returns:
        c over the torque limit and h times its square, of shape (1200, n); 0 and 1 of arms that have left.
    """
    states, tasks, count = _motion(recording), sampled_moves(recording.moves), len(recording.cost)
    linearisation = Linearisation(design_model(), EPISODE_STEPS)
    before = np.broadcast_to(recording.torque_before, count)
    changes, curvatures = np.zeros((EPISODE_STEPS, count)), np.ones((EPISODE_STEPS, count))
    for i in np.flatnonzero(recording.finished):
        pause(0)
        row, torque = recording.params[i], np.ascontiguousarray(recording.torque[:, i])
        limit, task = float(row[COLUMN.torque_limit]), np.ascontiguousarray(tasks[i, 1:, :2])
        about = linearisation.about(np.ascontiguousarray(states[:, i]), torque, task, row)
        changed = np.diff(torque, prepend=before[i])
        weights = norm_weights(about.errors, changed, limit, _EFFORT, _SOFT)
        weights = weights._replace(smoothness=torque_price * weights.smoothness)
        change, _, curvature = optimal_change(about, weights, torque, before=float(before[i]))
        changes[:, i], curvatures[:, i] = change / limit, curvature * limit**2
    return changes, curvatures


def _motion(recording: Recording) -> Floats:
    """States of arms and drives before each sample of n moves, as `ArmSimulation` has them, shape (1200, n, size).

    A move begins in the state that the last one has left.
    """
    count = recording.num_arms
    arms = ArmSimulation(design_model(), count)
    arms.set_table(recording.params[:count], np.zeros(count))
    now = arms.at_rest(recording.params[:count, COLUMN.gear_ratio] * recording.moves[:count, 0])
    states = np.empty((EPISODE_STEPS, len(recording.cost), now.shape[1]))
    for move in range(recording.num_moves):
        columns = slice(move * count, (move + 1) * count)
        for k in range(EPISODE_STEPS):
            states[k, columns] = now
            arms.set_table(recording.params[columns], np.full(count, float(k)))
            now = arms.advance(now, recording.torque[k, columns])
    return states
