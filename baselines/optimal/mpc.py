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
from typing import NamedTuple

import numpy as np

from baselines.models.actuator import dead_time
from baselines.models.friction import SmoothCompensation, smooth_friction
from baselines.models.ramps import move_of
from baselines.optimal.horizon import Horizon, horizon, plan
from baselines.optimal.observer_feedback import ADDED, FeedbackLaw, ObserverController
from baselines.optimal.preview import PreviewGains
from baselines.reading import Sample
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arrays import Floats
from beltarm_env.engine import compiled


@dataclass(frozen=True)
class MpcGains(PreviewGains):
    """Weights of the predicted cost, noise of the filter and friction compensation, as in preview."""


class MpcDesign(NamedTuple):
    """What the law for one arm knows."""

    ahead: Horizon
    lead: float  # T [s]
    opposing: float  # friction that the plan leaves room for [N m]
    friction: SmoothCompensation


@compiled
def _torque(design: MpcDesign, now: Sample, begins: bool, ahead: Floats, disturbance: float, row: Floats) -> float:
    """Motor torque [N m], see `FeedbackLaw`."""
    last = 0.0 if begins else now.last_command - row[ADDED]
    time, torques = CONTROL_PERIOD * now.step + design.lead, np.empty(len(design.ahead.lengths))
    plan(design.ahead, move_of(now), time, ahead, last, design.opposing, torques)
    row[ADDED] = smooth_friction(design.friction, ahead[1], torques[0]) - disturbance
    return torques[0] + row[ADDED]


class MpcController(ObserverController):
    """Model predictive control on encoder observations.

    Args:
        gains: Weights and noise.
        params: The design model.
    """

    def __init__(self, gains: MpcGains | None = None, params: ArmParams | None = None) -> None:
        self.gains = g = gains or MpcGains()
        super().__init__(g.noise(), params)
        p = self.params
        opposing = g.friction_share * p.coulomb_friction
        self._design = MpcDesign(horizon(p, g.weights()), dead_time(p), opposing, g.compensation(p))

    def feedback_law(self) -> FeedbackLaw:
        """The law for one arm."""
        return FeedbackLaw(_torque, self._design)
