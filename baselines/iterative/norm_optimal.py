"""Norm-optimal iterative learning: changes of the torque that bring the next trial nearer to the task.

About the motion x_k of a trial under torques tau_k the arm is linear,

    dx[k+1] = A_k dx[k] + b_k v[k]

with v the change of the torque, and A_k, b_k by differences of the arm's own simulation, friction included: where the
motor sticks, b_k = 0. Errors follow as e_k + C_k dx_k. Of the next trial is asked

    min  sum_k (e_k + C_k dx_k)' W_k (e_k + C_k dx_k) + R v[k]^2 + r_k (D_k + v[k] - v[k-1])^2

with D_k = tau_k - tau_(k-1), over all v at once: the lifted least squares of a whole trial. It is solved exactly,
backwards over z_k = [dx_k; v[k-1]] (`baselines.optimal.riccati`), the input being v[k] - v[k-1], as feed-forward and
feedback v[k] = c[k] - K[k] z_k.

A benchmark that charges norms |e|, not squares, is met by weights computed for every trial, W = 1 / (2 |e|) with the
errors of the trial before (iteratively reweighted least squares): the sum then has the norms' slope at that trial.

Sources: N. Amann, D. H. Owens, E. Rogers: Iterative learning control using optimal feedback and feedforward actions,
Int. J. Control 65, 1996; S. Gunnarsson, M. Norrlof: On the design of ILC algorithms using optimization, Automatica 37,
2001; D. A. Bristow, M. Tharayil, A. G. Alleyne: A survey of iterative learning control, IEEE CSM 26, 2006.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from baselines.optimal.riccati import CostToGo, free_input, no_cost, slope_in_input, step_back
from beltarm_env import ArmParams
from beltarm_env.arm import DRIVE_EFFECTS, plant_of
from beltarm_env.arrays import Floats
from beltarm_env.jit import compiled, inlined
from beltarm_env.physics.drive import DRIVE_COLUMNS
from beltarm_env.physics.kinematics import tip_errors
from beltarm_env.simulation import ArmSimulation
from beltarm_env.task.cost import POSITION_SCALE, TORQUE_RATE_WEIGHT, VELOCITY_SCALE

_MOVES = np.array([1e-3, 1e-2, 1e-5, 1e-3, 1e-4])  # of x and of the torque, for the differences
_COPIES = 2 * len(_MOVES) + 1


class Trial(NamedTuple):
    """Linear problem about one trial of T samples; row k is of sample k, errors are of the state after it."""

    transition: Floats  # A, shape (T, 4, 4)
    by_torque: Floats  # b, shape (T, 4)
    errors: Floats  # e, shape (T, 4): tip along and across, position [m] and velocity [m/s]
    of_state: Floats  # C, shape (T, 4, 4)


class Weights(NamedTuple):
    """Weights of the next trial's cost."""

    errors: Floats  # diagonals of W, shape (T, 4)
    smoothness: Floats  # r [1/(N m)^2], shape (T,)
    effort: float  # R [1/(N m)^2]


@compiled
def optimal_change(trial: Trial, weights: Weights, torque_change: Floats) -> tuple[Floats, Floats]:
    """Minimise the cost of the next trial.

    Args:
        trial: Of one arm.
        weights: Of errors and torque.
        torque_change: D [N m], shape (T,).

    Returns:
        c [N m] of shape (T,) and K of shape (T, 5).
    """
    steps = len(torque_change)
    change, gain = np.empty(steps), np.empty((steps, 5))
    to_go, slope, nothing = no_cost(5), np.empty(7), np.zeros(5)
    f, g = np.zeros((5, 5)), np.ones(5)
    f[4, 4] = 1.0
    for k in range(steps - 1, -1, -1):
        _add_errors(to_go, trial, weights, k)
        f[:4, :4], f[:4, 4], g[:4] = trial.transition[k], trial.by_torque[k], trial.by_torque[k]
        smoothness = weights.smoothness[k]
        slope_in_input(5, to_go, f, g, nothing, (smoothness, smoothness * torque_change[k]), slope)
        change[k] = free_input(5, slope, gain[k])
        step_back(5, to_go, f, slope, gain[k], change[k])
        gain[k, 4] -= 1.0  # from a law for v[k] - v[k-1] to one for v[k]
    return change, gain


@inlined
def _add_errors(to_go: CostToGo, trial: Trial, weights: Weights, k: int) -> None:
    """Add the cost of errors and torque change after sample k."""
    for error in range(4):
        for i in range(4):
            weighted = weights.errors[k, error] * trial.of_state[k, error, i]
            to_go.vector[i] += weighted * trial.errors[k, error]
            for j in range(4):
                to_go.matrix[i, j] += weighted * trial.of_state[k, error, j]
    to_go.matrix[4, 4] += weights.effort


def _tip_errors(states: Floats, task: Floats, row: Floats) -> tuple[Floats, Floats]:
    """Errors of the tip, shape (T, 4), and their derivatives by the state, shape (T, 4, 4)."""
    plant, of_state = plant_of(row), np.empty((len(states), 4, 4))
    for j, move in enumerate(np.diag(_MOVES[:4])):
        there, back = (tip_errors(states + sign * move, task, plant) for sign in (1.0, -1.0))
        of_state[:, :, j] = (there - back) / (2 * _MOVES[j])
    return tip_errors(states, task, plant), of_state


class Linearisation:
    """Linearisation of trials of arms that are nominally `params`; torques act at once, as of an ideal drive."""

    def __init__(self, params: ArmParams, steps: int) -> None:
        ideal = replace(params, **dict.fromkeys(DRIVE_EFFECTS, 0.0))
        self._simulation = ArmSimulation(ideal, _COPIES * steps)
        self._steps = steps

    def about(self, states: Floats, torques: Floats, task: Floats, row: Floats) -> Trial:
        """Linear problem about the motion of one arm.

        Args:
            states: x before each sample, shape (T, 4).
            torques: Held over each sample [N m], shape (T,).
            task: Reference angle [rad] and speed [rad/s] of the joint after each sample, shape (T, 2).
            row: Constants of the arm, columns as `ArmParams`, shape (12,).

        Raises:
            ValueError: If there are not as many samples as this was made for.
        """
        if states.shape != (self._steps, 4) or torques.shape != (self._steps,) or task.shape != (self._steps, 2):
            raise ValueError(
                f"a trial must have {self._steps} samples, got states {states.shape}, torques {torques.shape} and "
                f"task {task.shape}"
            )
        inputs = np.repeat(np.column_stack([states, torques])[:, None], _COPIES, axis=1)
        for j, move in enumerate(_MOVES):
            inputs[:, 2 * j + 1, j] += move
            inputs[:, 2 * j + 2, j] -= move
        ideal = row.copy()
        ideal[list(DRIVE_COLUMNS)] = 0.0
        self._simulation.set_table(np.repeat(ideal[None], _COPIES * self._steps, axis=0))
        ends = self._simulation.advance(inputs[:, :, :4].reshape(-1, 4), inputs[:, :, 4].ravel())
        ends = ends.reshape(self._steps, _COPIES, 4)
        slopes = (ends[:, 1::2] - ends[:, 2::2]) / (2 * _MOVES[:, None])
        errors, of_state = _tip_errors(ends[:, 0].copy(), np.ascontiguousarray(task), row)
        transition = np.ascontiguousarray(slopes[:, :4].swapaxes(1, 2))
        return Trial(transition, np.ascontiguousarray(slopes[:, 4]), errors, of_state)


def norm_weights(
    errors: Floats, torque_change: Floats, limit: float, effort: float, soft: tuple[float, float]
) -> Weights:
    """Weights that give squares the slope of the benchmark's cost, sum |e_p| / 10 mm + |e_v| / 200 mm/s + 0.1 |u|.

    Args:
        errors: Position [m] and velocity [m/s], two of each, shape (T, 4).
        torque_change: From sample to sample [N m], shape (T,).
        limit: Torque limit [N m].
        effort: R [1/(N m)^2].
        soft: Below these the norms over their scale, and the torque's change over its limit, count as these.
    """
    position = np.maximum(np.hypot(errors[:, 0], errors[:, 1]) / POSITION_SCALE, soft[0])
    velocity = np.maximum(np.hypot(errors[:, 2], errors[:, 3]) / VELOCITY_SCALE, soft[0])
    change = np.maximum(np.abs(torque_change) / limit, soft[1])
    of_position, of_velocity = 0.5 / (position * POSITION_SCALE**2), 0.5 / (velocity * VELOCITY_SCALE**2)
    of_errors = np.column_stack([of_position, of_position, of_velocity, of_velocity])
    return Weights(of_errors, 0.5 * TORQUE_RATE_WEIGHT / (change * limit**2), effort)
