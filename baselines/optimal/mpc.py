"""Model predictive control on encoder data: a new plan at every sample, within the torque limit.

At every sample the plan of `baselines.optimal.horizon` gives the net torque u that carries the *estimated* state over
what is ahead of the move. The motor torque adds what the plan leaves out, Coulomb friction and the estimated bias d:

    tau_m = u + kappa tau_c sign(omega_a) - d

with the estimated speed, or, of a motor at rest, the sign of u: the way it is to break away. State and bias are
estimated by `baselines.estimation.observer`, a Kalman filter that models stiction.

The move is known ahead, the arm is not: its parameters are taken to be nominal. With the true ones this controller
costs about a third; for the least cost see `baselines/oracle.py`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baselines.controller import ClassicalController
from baselines.estimation.observer import Estimate, Noise, StickSlipObserver
from baselines.gains import Gains, tunable
from baselines.models.friction import breakaway_direction
from baselines.optimal.horizon import horizon, plan
from baselines.reading import Reading
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arrays import Flags, Floats

_RESTING = 0.5  # a motor slower than this is taken to rest [rad/s]; the encoder resolves 1 rad/s from sample to sample


@dataclass(frozen=True)
class MpcGains(Gains):
    """Weights of the predicted cost, and assumed noise of the estimator."""

    velocity_weight: float = tunable(0.3, 0.01, 10.0, log=True)  # q_v   [-]   of the tip's velocity; position has 1
    change_weight: float = tunable(800.0, 1e-3, 1e3, log=True)  # R     [1/(N m)^2]   of the torque's change
    friction_share: float = tunable(1.0, 0.0, 1.3)  # kappa [-]   of tau_c that is compensated
    torque_noise: float = tunable(0.06, 1e-4, 0.1, log=True)  # [N m]   of the motor, from sample to sample
    torsion_noise: float = tunable(10.0, 0.1, 100.0, log=True)  # [rad/s^2]   torsional acceleration, likewise
    bias_noise: float = tunable(0.005, 1e-3, 10.0, log=True)  # [N m/sqrt(s)]   random walk of the bias d


@dataclass(frozen=True)
class MpcMemory:
    """Estimate and last net torque of n arms."""

    estimate: Estimate
    net_torque: Floats  # u of the last sample [N m], shape (n,)


class MpcController(ClassicalController[MpcMemory]):
    """Model predictive control on encoder observations.

    Args:
        gains: Weights and noise.
        params: The nominal arm, all that the controller knows of the plant.
    """

    def __init__(self, gains: MpcGains | None = None, params: ArmParams | None = None) -> None:
        super().__init__(params)
        self.gains = gains or MpcGains()
        self._ahead = horizon(self.params, self.gains.velocity_weight, self.gains.change_weight)
        noise = Noise(self.gains.torque_noise, self.gains.torsion_noise, self.gains.bias_noise)
        self._observer = StickSlipObserver(self.params, noise)

    def law(self, reading: Reading, begins: Flags, memory: MpcMemory | None) -> tuple[Floats, MpcMemory]:
        """Torque [N m] of one sample, see `ClassicalController`."""
        estimate = self._observer.update(memory.estimate if memory else None, reading, begins)
        last = np.where(begins, 0.0, memory.net_torque) if memory else np.zeros(len(begins))
        friction = self.gains.friction_share * self.params.coulomb_friction
        time = reading.step.astype(np.float64) * CONTROL_PERIOD
        net = plan(self._ahead, estimate.state, last, time, reading.move, friction)[:, 0]
        direction = breakaway_direction(estimate.state[:, 1], net, _RESTING)
        return net + friction * direction - estimate.disturbance, MpcMemory(estimate, net)
