"""Model predictive control on encoder data: a new plan at every sample, within the torque limit.

At every sample the plan of `baselines.optimal.horizon` gives the net torque u that carries the *estimated* state, at
the time at which the command acts, over what is ahead of the move then. The command adds what the plan leaves out, dry
friction as in `baselines.optimal.preview` and the estimated bias d:

    tau_m = u + tau_f - d

State and bias are estimated by `baselines.estimation.observer`, a Kalman filter that models stiction.

The move is known ahead, the arm is not: its parameters are taken to be those of the design model. With the true ones
this controller costs about a third; for the least cost see `baselines/oracle.py`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baselines.controller import ClassicalController
from baselines.estimation.observer import Estimate, StickSlipObserver
from baselines.models.actuator import dead_time
from baselines.models.friction import smooth_frictions
from baselines.optimal.horizon import horizon, plan
from baselines.optimal.preview import PreviewGains
from baselines.reading import Reading, last_share
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arrays import Flags, Floats


@dataclass(frozen=True)
class MpcGains(PreviewGains):
    """Weights of the predicted cost, noise of the filter and friction compensation, as in preview."""


@dataclass(frozen=True)
class MpcMemory:
    """Estimate and last net torque of n arms."""

    estimate: Estimate
    added: Floats  # torque beside the plan's [N m], shape (n,)


class MpcController(ClassicalController[MpcMemory]):
    """Model predictive control on encoder observations.

    Args:
        gains: Weights and noise.
        params: The design model.
    """

    def __init__(self, gains: MpcGains | None = None, params: ArmParams | None = None) -> None:
        super().__init__(params)
        self.gains = gains or MpcGains()
        self._friction = self.gains.compensation(self.params)
        self._ahead = horizon(self.params, self.gains.weights())
        self._observer = StickSlipObserver(self.params, self.gains.noise())

    def law(self, reading: Reading, begins: Flags, memory: MpcMemory | None) -> tuple[Floats, MpcMemory]:
        """Torque [N m] of one sample, see `ClassicalController`."""
        estimate = self._observer.update(memory.estimate if memory else None, reading, begins)
        last = last_share(reading, memory.added if memory else None, begins)
        opposing = self.gains.friction_share * self.params.coulomb_friction
        time = CONTROL_PERIOD * reading.step.astype(np.float64) + dead_time(self.params)
        torque = plan(self._ahead, estimate.ahead, last, time, reading.move, opposing)[:, 0]
        added = smooth_frictions(self._friction, estimate.ahead[:, 1], torque) - estimate.disturbance
        return torque + added, MpcMemory(estimate, added)
