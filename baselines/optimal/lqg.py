"""Flatness feed-forward and gain-scheduled LQG: the link along a smoothed move, and feedback about it.

    tau_m = tau_flat(t + h/2) - K(theta_1,ref) (x - x_flat(t)) - d + tau_c dir

State and torque of the smoothed move come from the flat output, see `baselines.optimal.flatness`; the torque is the one
in the middle of the sample over which it is held. Estimates x and d are those of `baselines.estimation.observer`, a
Kalman filter on the encoder that models stiction. The gain is the steady-state optimum (LQR) of the linear arm at each
of 46 joint angles, interpolated at the angle of the reference. It minimises

    sum of |e_p / 10 mm|^2 + w_v |e_v / 200 mm/s|^2 + rho tau^2

with the tip's errors about an arm at rest at the angle, linear in z = x - x_flat (`baselines.optimal.tip_error`).

`baselines.optimal.preview` weighs the same errors, but over the whole move at once: its gains vary with time, and its
feed-forward is the optimum for the trapezoid itself. Here the move is first made one that the arm can follow; how
smooth it is, in periods of the belt's mode, is tuned. Friction is compensated in the direction in which the flat motor
moves, and where it rests in that of the torque asked of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import solve, solve_discrete_are

from baselines.controller import ClassicalController
from baselines.estimation.observer import Estimate, StickSlipObserver
from baselines.gains import Gains, tunable
from baselines.models.friction import breakaway_direction
from baselines.models.linear import ANGLES, at_angle, linear_arm
from baselines.optimal.flatness import Corners, flat_motion, smoothed
from baselines.optimal.plan import Weights
from baselines.optimal.preview import PreviewGains
from baselines.optimal.tip_error import bounded_sine, error_weights, tip_error_rows
from baselines.reading import Reading, chosen
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arrays import Flags, Floats


@dataclass(frozen=True)
class SpreadGains(Gains):
    """Smoothness of the move: times over which the corners of its trapezoid are spread."""

    first_spread: float = tunable(0.3, 0.02, 2.0, log=True)  # [periods]  of the first corner
    spread: float = tunable(0.6, 0.02, 4.0, log=True)  # [periods]  of the others


@dataclass(frozen=True)
class LqgGains(PreviewGains, SpreadGains):
    """Smoothness of the move; weights of the feedback, noise of the filter and friction compensation as in preview."""


@dataclass(frozen=True)
class LqgMemory:
    """Smoothed move and estimate of n arms."""

    corners: Corners
    estimate: Estimate


@lru_cache(maxsize=64)
def feedback_gains(params: ArmParams, weights: Weights) -> Floats:
    """Steady-state gains K of the torque on x - x_ref at each of `ANGLES`, shape (46, 4)."""
    tables = linear_arm(params)
    gains = np.empty((len(ANGLES), 4))
    scales, plant = np.sqrt(np.repeat(error_weights(weights.velocity), 2)), params.plant()
    for k, angle in enumerate(ANGLES):
        scaled = scales[:, None] * np.array(tip_error_rows(float(angle), 0.0, bounded_sine(float(angle)), plant))
        state_cost = scaled.T @ scaled
        transition, by_torque = tables.transition[k], tables.by_torque[k][:, None]
        price = np.array([[weights.torque]])
        to_go = solve_discrete_are(transition, by_torque, state_cost, price)
        gains[k] = solve(by_torque.T @ to_go @ by_torque + price, by_torque.T @ to_go @ transition)[0]
    return gains


class LqgController(ClassicalController[LqgMemory]):
    """Flatness feed-forward and gain-scheduled LQG on encoder observations.

    Args:
        gains: Smoothness, weights and noise.
        params: The nominal arm.
    """

    def __init__(self, gains: LqgGains | None = None, params: ArmParams | None = None) -> None:
        super().__init__(params)
        self.gains = gains or LqgGains()
        self._feedback = feedback_gains(self.params, self.gains.weights())
        self._observer = StickSlipObserver(self.params, self.gains.noise())

    def law(self, reading: Reading, begins: Flags, memory: LqgMemory | None) -> tuple[Floats, LqgMemory]:
        """Torque [N m] of one sample, see `ClassicalController`."""
        estimate = self._observer.update(memory.estimate if memory else None, reading, begins)
        corners = self._resmoothed(memory.corners if memory else None, begins, reading.move)
        time = CONTROL_PERIOD * reading.step.astype(np.float64)
        wanted = flat_motion(corners, time, self.params).state
        ahead = flat_motion(corners, time + 0.5 * CONTROL_PERIOD, self.params)
        gain = at_angle(self._feedback, wanted[:, 0] / self.params.gear_ratio)
        feedback = gain * (estimate.state - wanted)
        torque = ahead.torque - (feedback[:, 0] + feedback[:, 1] + feedback[:, 2] + feedback[:, 3])
        direction = breakaway_direction(ahead.state[:, 1], torque, self.gains.friction_speed)
        friction = self.gains.friction_share * self.params.coulomb_friction * direction
        return torque - estimate.disturbance + friction, LqgMemory(corners, estimate)

    def _resmoothed(self, corners: Corners | None, begins: Flags, moves: Floats) -> Corners:
        """Smoothed moves, with new ones for arms that begin an episode."""
        if corners is not None and not begins.any():
            return corners
        new = smoothed(moves, self.params, self.gains.first_spread, self.gains.spread)
        if corners is None:
            return new
        return Corners(*(chosen(begins, *pair) for pair in zip(new, corners, strict=True)))
