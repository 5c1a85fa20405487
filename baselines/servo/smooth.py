"""PID along a smooth profile that takes as long as the task's move.

The reference is an S-curve: ramps of the speed with the shape 3u^2 - 2u^3, whose acceleration is the parabola
6u(1 - u). Of a ramp that takes t, an undamped mode w is left with the amplitude of the parabola's Fourier transform,

    3 |sin x - x cos x| / x^3,    x = w t / 2,

which is zero first at tan x = x, x = 4.493: a ramp of 1.43 periods leaves the mode at rest, one of a longer time leaves
8.6 % at most. (The quintic of minimum jerk takes the whole move, whatever the mode.) So each ramp gets at least that
many periods of the mode with the motor held, as it is at the start for the ramp up and at the goal for the ramp down:
each excites the arm where it is then, and what rings after the move rings at the goal. Ramps are not shorter than the
task's, and both together not longer than the move.

Smoothness is paid for with time. Against the task's trapezoid the S-curve lags at first and leads at last, and that
counts as tip error: the method buys a quiet end with a move that is not the one asked for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baselines.gains import tunable
from baselines.models.modes import held_modes
from baselines.models.ramps import Ramps
from baselines.servo.pid import PidGains, RampServo
from beltarm_env import ArmParams
from beltarm_env.arrays import Floats


@dataclass(frozen=True)
class SmoothGains(PidGains):
    """Gains of the servo, and the smoothness of the profile."""

    ramp: float = tunable(1.43, 0.1, 5.0)  # [periods of the mode]  least time of a ramp


class SmoothController(RampServo):
    """PID along an S-curve.

    Args:
        gains: Of servo and profile.
        params: The design model.
    """

    def __init__(self, gains: SmoothGains | None = None, params: ArmParams | None = None) -> None:
        self.gains = gains or SmoothGains()
        super().__init__(self.gains, params, smooth=True)

    def plan(self, moves: Floats) -> Ramps:
        """Ramps for moves of shape (n, 4): one up and one down."""
        start, goal, duration, ramp = moves.T
        up = np.maximum(ramp, self.gains.ramp * held_modes(self.params, start).period)
        down = np.maximum(ramp, self.gains.ramp * held_modes(self.params, goal).period)
        share = np.minimum(1.0, duration / (up + down))
        up, down = share * up, share * down
        cruise = (goal - start) / (duration - 0.5 * (up + down))
        return Ramps(
            np.column_stack([np.zeros_like(up), duration - down]),
            np.column_stack([up, down]),
            np.column_stack([cruise, -cruise]),
        )
