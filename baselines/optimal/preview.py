"""Preview LQG: an optimal plan for the move, and a Kalman filter that models stiction.

    tau_m = tau_ff[k] - K[k] (x - x_ref[k]) - d + tau_c dir                 plan and gains: `baselines.optimal.plan`

with the estimates x and d of `baselines.estimation.observer`. Friction is compensated where the motor moves, and where
it rests in the direction in which the plan wants it to move: dir = sign(omega_a) above a small speed, and the sign of
the torque demanded below. All parameters are nominal. Separation of estimation and control holds for the linear arm
only; friction and parameters that differ break it, which is why the noise of the filter and the weight of the torque
are tuned.
"""

from __future__ import annotations

from dataclasses import dataclass

from baselines.controller import ClassicalController
from baselines.estimation.observer import Estimate, Noise, StickSlipObserver
from baselines.gains import Gains, tunable
from baselines.models.friction import breakaway_direction
from baselines.optimal.plan import Plans, Weights, planned_torque, replanned
from baselines.reading import Reading
from beltarm_env import ArmParams
from beltarm_env.arm import params_table
from beltarm_env.arrays import Flags, Floats


@dataclass(frozen=True)
class PreviewGains(Gains):
    """Weights of the plan and noise of the filter."""

    velocity_weight: float = tunable(0.3, 0.01, 10.0, log=True)  # w_v     of the tip's velocity error
    torque_weight: float = tunable(30.0, 1e-2, 1e4, log=True)  # rho     [1/(N m)^2]
    torque_noise: float = tunable(0.03, 1e-4, 0.1, log=True)  # [N m]      process noise at the motor
    acceleration_noise: float = tunable(5.0, 0.1, 300.0, log=True)  # [rad/s^2]  process noise of the torsion
    disturbance_noise: float = tunable(0.005, 1e-3, 10.0, log=True)  # [N m/sqrt(s)]  growth of d
    friction_share: float = tunable(1.0, 0.0, 1.3)  # [-]        of tau_c that is compensated
    friction_speed: float = tunable(0.5, 0.05, 20.0, log=True)  # [rad/s]    motor speed below which the torque decides

    def weights(self) -> Weights:
        """Weights of the tip's velocity error and of the torque."""
        return Weights(self.velocity_weight, self.torque_weight)

    def noise(self) -> Noise:
        """Process noise of the filter."""
        return Noise(self.torque_noise, self.acceleration_noise, self.disturbance_noise)


@dataclass(frozen=True)
class PreviewMemory:
    """Plan and estimate of n arms."""

    plans: Plans
    estimate: Estimate


class PreviewController(ClassicalController[PreviewMemory]):
    """Preview LQG on encoder observations.

    Args:
        gains: Weights and noise.
        params: The nominal arm.
    """

    def __init__(self, gains: PreviewGains | None = None, params: ArmParams | None = None) -> None:
        super().__init__(params)
        self.gains = gains or PreviewGains()
        self._table = params_table([self.params])
        self._weights = self.gains.weights()
        self._observer = StickSlipObserver(self.params, self.gains.noise())

    def law(self, reading: Reading, begins: Flags, memory: PreviewMemory | None) -> tuple[Floats, PreviewMemory]:
        """Torque [N m] of one sample, see `ClassicalController`."""
        estimate = self._observer.update(memory.estimate if memory else None, reading, begins)
        plans = replanned(memory.plans if memory else None, begins, reading.move, self._table, self._weights)
        torque = planned_torque(plans, reading.step, estimate.state)
        direction = breakaway_direction(estimate.state[:, 1], torque, self.gains.friction_speed)
        friction = self.gains.friction_share * self.params.coulomb_friction * direction
        return torque - estimate.disturbance + friction, PreviewMemory(plans, estimate)
