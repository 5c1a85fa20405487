"""Preview LQG: an optimal plan for the move, and a Kalman filter that models stiction.

    tau_m = tau_ff - K [x - x_ref; tau_last] - d + tau_f           plan and gains: `baselines.planning.plan`

with the plan at the time at which the command acts, and the estimates x, of the state then, and d of
`baselines.estimation.observer`. tau_last is what the plan's law asked for one sample ago, as far as the limit left room
for it. Friction tau_f is compensated as `baselines.models.friction` says, by the estimated speed at that time. All
parameters are those of the design model. Separation of estimation and control holds for the linear arm only; friction
and parameters that differ break it, which is why the noise of the filter and the weights of the torque are tuned.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from baselines.controller import ClassicalController
from baselines.estimation.observer import Estimate, Noise, StickSlipObserver
from baselines.gains import Gains, tunable
from baselines.models.actuator import dead_time
from baselines.models.friction import dry_friction, friction_level, smooth_direction
from baselines.planning.plan import Plans, Weights, planned_torque, replanned
from baselines.reading import Reading, last_share
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arm import params_table
from beltarm_env.arrays import Flags, Floats


@dataclass(frozen=True)
class PreviewGains(Gains):
    """Weights of the plan, noise of the filter and friction compensation."""

    velocity_weight: float = tunable(1.0, 0.01, 10.0, log=True)  # w_v     of the tip's velocity error
    torque_weight: float = tunable(10.0, 1e-2, 1e4, log=True)  # rho     [1/(N m)^2]
    change_weight: float = tunable(20.0, 1e-2, 1e5, log=True)  # R     [1/(N m)^2]
    torque_noise: float = tunable(5e-3, 1e-4, 0.1, log=True)  # [N m]      process noise at the motor
    acceleration_noise: float = tunable(0.3, 0.01, 300.0, log=True)  # [rad/s^2]  process noise of the torsion
    disturbance_noise: float = tunable(1e-3, 1e-4, 10.0, log=True)  # [N m/sqrt(s)]  growth of d
    friction_share: float = tunable(1.0, 0.0, 1.3)  # c         of the design model's friction that is compensated
    friction_speed: float = tunable(1.0, 0.05, 20.0, log=True)  # omega_0 [rad/s]  motor speed that decides its sign
    rest_width: float = tunable(0.02, 0.0001, 0.3, log=True)  # [N m]     torque that decides it while the motor rests

    def weights(self) -> Weights:
        """Weights of the tip's velocity error, of the torque and of its change."""
        return Weights(self.velocity_weight, self.torque_weight, self.change_weight)

    def noise(self) -> Noise:
        """Process noise of the filter."""
        return Noise(self.torque_noise, self.acceleration_noise, self.disturbance_noise)

    def friction(self, constants: Floats, motor_speed: Floats, torque: Floats) -> Floats:
        """Compute tau_f [N m] of n arms at motor speeds [rad/s], given the torques asked of the motors [N m].

        `constants` as for `friction_level`.
        """
        direction = smooth_direction(motor_speed, torque, self.friction_speed, self.rest_width)
        return self.friction_share * friction_level(dry_friction(constants.T), motor_speed) * direction


@dataclass(frozen=True)
class PreviewMemory:
    """Plan and estimate of n arms."""

    plans: Plans
    estimate: Estimate
    added: Floats  # torque beside the plan's [N m], shape (n,)


class PreviewController(ClassicalController[PreviewMemory]):
    """Preview LQG on encoder observations.

    Args:
        gains: Weights and noise.
        params: The design model.
    """

    observer: ClassVar[type[StickSlipObserver]] = StickSlipObserver

    def __init__(self, gains: PreviewGains | None = None, params: ArmParams | None = None) -> None:
        super().__init__(params)
        self.gains = gains or PreviewGains()
        self._table = params_table([self.params])
        self._delay = dead_time(self.params) / CONTROL_PERIOD
        self._weights = self.gains.weights()
        self._observer = self.observer(self.params, self.gains.noise())

    def law(self, reading: Reading, begins: Flags, memory: PreviewMemory | None) -> tuple[Floats, PreviewMemory]:
        """Torque [N m] of one sample, see `ClassicalController`."""
        estimate = self._observer.update(memory.estimate if memory else None, reading, begins)
        plans = replanned(memory.plans if memory else None, begins, reading.move, self._table, self._weights)
        last = last_share(reading, memory.added if memory else None, begins)
        torque = planned_torque(plans, reading.step.astype(np.float64) + self._delay, estimate.ahead, last)
        added = self.gains.friction(self._table[0], estimate.ahead[:, 1], torque) - estimate.disturbance
        return torque + added, PreviewMemory(plans, estimate, added)
