"""Flatness feed-forward and gain-scheduled LQG: the link along a smoothed move, and feedback about it.

    tau_m = tau_flat(t + h/2) + v - d + tau_f,    v = -K(theta_1,ref) [x - x_flat(t); v_last]

at the time t at which the command acts. State and torque of the smoothed move come from the flat output, see
`baselines.models.flatness`; the torque is the one in the middle of the sample over which it is held. Estimates x, of
the state at t, and d are those of `baselines.estimation.observer`, a Kalman filter on the encoder that models stiction.
The gain is the steady-state optimum (LQR) of the linear arm at each of 46 joint angles, interpolated at the angle of
the reference. It minimises

    sum of |e_p / 10 mm|^2 + w_v |e_v / 200 mm/s|^2 + rho v^2 + R (v - v_last)^2

with the tip's errors about an arm at rest at the angle, linear in z = x - x_flat (`baselines.planning.tip_error`).

`baselines.optimal.preview` weighs the same errors over the whole move at once. Here the move is first made one that the
arm can follow; how smooth it is, in periods of the belt's mode, is tuned. Friction is compensated as in preview.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve, solve_discrete_are

from baselines.controller import LawKernel
from baselines.estimation.observer import AHEAD, DISTURBANCE, ObservedArm, ObserverDesign, observe_arm, observer_design
from baselines.models.flatness import CORNERS, SpreadGains, flat_point, write_corners
from baselines.models.friction import SmoothCompensation, smooth_friction
from baselines.models.linear import ANGLES, between, linear_arm, place
from baselines.optimal.preview import ADDED, OWN, ObserverController, PreviewGains
from baselines.planning.plan import Weights
from baselines.planning.tip_error import add_tip_cost, bounded_sine, error_weights, write_tip_errors
from baselines.reading import Sample, move_of
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arm import Plant
from beltarm_env.arrays import Floats
from beltarm_env.engine import compiled
from beltarm_env.kernels.simulate import room_for

_MOVE = slice(OWN, OWN + CORNERS)  # of the memory: the smoothed move


@dataclass(frozen=True)
class LqgGains(PreviewGains, SpreadGains):
    """Smoothness of the move; weights of the feedback, noise of the filter and friction compensation as in preview."""


@lru_cache(maxsize=64)
def feedback_gains(params: ArmParams, weights: Weights) -> Floats:
    """Steady-state gains K of the torque on [x - x_ref; tau_last] at each of `ANGLES`, shape (46, 5)."""
    arm = linear_arm(params)
    gains = np.empty((len(ANGLES), 5))
    weigh, plant, errors = error_weights(weights.velocity), params.plant(), np.empty((4, 4))
    transition, state_cost, price = np.zeros((5, 5)), np.zeros((5, 5)), np.array([[weights.change]])
    transition[4, 4] = 1.0
    for k, angle in enumerate(ANGLES):
        state_cost[:] = 0.0
        write_tip_errors(float(angle), 0.0, bounded_sine(float(angle)), plant, errors)
        add_tip_cost(state_cost, errors, weigh)
        state_cost[4, 4] = weights.torque
        transition[:4, :4], transition[:4, 4] = arm.transition[k], arm.by_torque[k]
        by_change = transition[:, 4:]
        to_go = solve_discrete_are(transition, by_change, state_cost, price)
        gains[k] = solve(by_change.T @ to_go @ by_change + price, by_change.T @ to_go @ transition)[0]
        gains[k, 4] -= 1.0  # from a law for the change to one for the torque
    return gains


class LqgDesign(NamedTuple):
    """What the law for one arm knows."""

    observer: ObserverDesign
    plant: Plant
    first_spread: float  # of the move's corners, see `write_corners`
    spread: float
    feedback: Floats  # K at each of `ANGLES`, shape (46, 5)
    friction: SmoothCompensation


@compiled
def _torque(design: LqgDesign, now: Sample, begins: bool, row: Floats) -> float:
    """Motor torque [N m], see `ObserverController`."""
    corners, ahead, last = row[_MOVE], row[AHEAD], now.last_command - row[ADDED]
    if begins:
        write_corners(move_of(now), design.plant, design.first_spread, design.spread, corners)
        last = 0.0
    time = CONTROL_PERIOD * now.step + CONTROL_PERIOD * design.observer.delay
    wanted = flat_point(corners, time, design.plant)
    held = flat_point(corners, time + 0.5 * CONTROL_PERIOD, design.plant)
    at, weight = place(wanted.motor_angle / design.plant.gear)
    low, high = design.feedback[at], design.feedback[at + 1]
    feedback = between(low[0], high[0], weight) * (ahead[0] - wanted.motor_angle)
    feedback += between(low[1], high[1], weight) * (ahead[1] - wanted.motor_speed)
    feedback += between(low[2], high[2], weight) * (ahead[2] - wanted.torsion)
    feedback += between(low[3], high[3], weight) * (ahead[3] - wanted.torsion_speed)
    deviation = -feedback - between(low[4], high[4], weight) * last
    friction = smooth_friction(design.friction, ahead[1], held.torque + deviation)
    row[ADDED] = held.torque + friction - row[DISTURBANCE]
    return deviation + row[ADDED]


@compiled
def lqg_law(design: LqgDesign, now: Sample, begins: bool, memory: ObservedArm) -> float:
    """Torque [N m] of one sample of one arm, see `LawKernel`."""
    observe_arm(design.observer, now, begins, memory.rows, memory.room)
    return _torque(design, now, begins, memory.rows[0])


class LqgController(ObserverController):
    """Flatness feed-forward and gain-scheduled LQG on encoder observations."""

    gains_type = LqgGains
    needs_vibration = True
    feedback_law = staticmethod(_torque)
    memory_size = OWN + CORNERS

    def _known(self) -> LqgDesign:
        p, g = self.params, self.gains
        observer, spreads = observer_design(p, g.noise()), (g.first_spread, g.spread)
        return LqgDesign(observer, p.plant(), *spreads, self.feedback(), g.compensation(p))

    def feedback(self) -> Floats:
        """Gains K at each of `ANGLES`, shape (46, 5)."""
        return feedback_gains(self.params, self.gains.weights())

    def kernel(self) -> LawKernel:
        """The law for one arm, with its observer."""
        return LawKernel(lqg_law, self._design, ObservedArm(np.zeros((1, self.memory_size)), room_for(1)))
