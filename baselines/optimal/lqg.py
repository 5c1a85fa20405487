"""Flatness feed-forward and gain-scheduled LQG: the link along a smoothed move, and feedback about it.

    tau_m = tau_flat(t + h/2) + v - d + tau_f,    v = -K(theta_1,ref) [x - x_flat(t); v_last]

at the time t at which the command acts. State and torque of the smoothed move come from the flat output, see
`baselines.models.flatness`; the torque is the one in the middle of the sample over which it is held. Estimates x, of
the state at t, and d are those of `baselines.estimation.observer`, a Kalman filter on the encoder that models stiction.
The gain is the steady-state optimum (LQR) of the linear arm at each of 46 joint angles, interpolated at the angle of
the reference. It minimises

    sum of |e_p / 10 mm|^2 + w_v |e_v / 200 mm/s|^2 + rho v^2 + R (v - v_last)^2

with the tip's errors about an arm at rest at the angle, linear in z = x - x_flat (`baselines.planning.tip_error`).

`baselines.optimal.preview` weighs the same errors, but over the whole move at once: its gains vary with time, and its
feed-forward is the optimum for the trapezoid itself. Here the move is first made one that the arm can follow; how
smooth it is, in periods of the belt's mode, is tuned. Friction is compensated as in preview.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import solve, solve_discrete_are

from baselines.controller import ClassicalController
from baselines.estimation.observer import Estimate, StickSlipObserver
from baselines.models.actuator import dead_time
from baselines.models.flatness import Corners, SpreadGains, flat_motion, smoothed
from baselines.models.linear import ANGLES, at_angle, linear_arm
from baselines.optimal.preview import PreviewGains
from baselines.planning.plan import Weights
from baselines.planning.tip_error import add_tip_cost, bounded_sine, error_weights, write_tip_errors
from baselines.reading import Reading, chosen, last_share
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arrays import Flags, Floats


@dataclass(frozen=True)
class LqgGains(PreviewGains, SpreadGains):
    """Smoothness of the move; weights of the feedback, noise of the filter and friction compensation as in preview."""


@dataclass(frozen=True)
class LqgMemory:
    """Smoothed move and estimate of n arms."""

    corners: Corners
    estimate: Estimate
    added: Floats  # torque beside the feedback's [N m], shape (n,)


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


class LqgController(ClassicalController[LqgMemory]):
    """Flatness feed-forward and gain-scheduled LQG on encoder observations.

    Args:
        gains: Smoothness, weights and noise.
        params: The design model.
    """

    def __init__(self, gains: LqgGains | None = None, params: ArmParams | None = None) -> None:
        super().__init__(params)
        self.gains = gains or LqgGains()
        self._row = self.params.row()
        self._lead = dead_time(self.params)
        self.feedback = feedback_gains(self.params, self.gains.weights())
        """Gains K at each of `ANGLES`, shape (46, 5)."""
        self._observer = StickSlipObserver(self.params, self.gains.noise())

    def law(self, reading: Reading, begins: Flags, memory: LqgMemory | None) -> tuple[Floats, LqgMemory]:
        """Torque [N m] of one sample, see `ClassicalController`."""
        estimate = self._observer.update(memory.estimate if memory else None, reading, begins)
        corners = self._resmoothed(memory.corners if memory else None, begins, reading.move)
        time = CONTROL_PERIOD * reading.step.astype(np.float64) + self._lead
        wanted = flat_motion(corners, time, self.params).state
        now = flat_motion(corners, time + 0.5 * CONTROL_PERIOD, self.params)
        last = last_share(reading, memory.added if memory else None, begins)
        gain = at_angle(self.feedback, wanted[:, 0] / self.params.gear_ratio)
        feedback = gain[:, :4] * (estimate.ahead - wanted)
        deviation = -(feedback[:, 0] + feedback[:, 1] + feedback[:, 2] + feedback[:, 3]) - gain[:, 4] * last
        torque = now.torque + deviation
        added = now.torque + self.gains.friction(self._row, estimate.ahead[:, 1], torque) - estimate.disturbance
        return deviation + added, LqgMemory(corners, estimate, added)

    def _resmoothed(self, corners: Corners | None, begins: Flags, moves: Floats) -> Corners:
        """Smoothed moves, with new ones for arms that begin an episode."""
        if corners is not None and not begins.any():
            return corners
        new = smoothed(moves, self.params, self.gains.first_spread, self.gains.spread)
        if corners is None:
            return new
        return Corners(*(chosen(begins, *pair) for pair in zip(new, corners, strict=True)))
