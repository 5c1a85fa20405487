"""Privileged preview LQG: true constants and true state. A yardstick; never ranked among the controllers.

The law of `baselines.optimal.preview` without an observer: the plan is that of the true arm, and its state is read from
the environment's full observation (motor angle and speed by the encoder, torsion exactly).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from baselines.models.friction import breakaway_direction
from baselines.optimal.plan import Plans, Weights, planned_torque, replanned
from baselines.optimal.preview import PreviewGains
from baselines.reading import as_action, beginning, read
from beltarm_env import ArmParams, observation
from beltarm_env.arm import FIELDS, params_table

Floats = NDArray[np.float64]

_TORSION = slice(observation.index("torsion", "full"), observation.index("torsion_speed", "full") + 1)
_SCALES = observation.scales("full")[_TORSION]


@dataclass(frozen=True)
class PrivilegedMemory:
    """Plans of n arms."""

    plans: Plans


class PrivilegedController:
    """Preview LQG that knows its arms, on observations with `sensors="full"`.

    Args:
        arms: The true constants, one for each row of the observations.
        gains: Weights of the plan and of the friction compensation.
    """

    def __init__(self, arms: Sequence[ArmParams], gains: PreviewGains | None = None) -> None:
        self.gains = gains or PreviewGains()
        self.params = ArmParams()
        self._table = params_table(arms)
        self._friction = self._table[:, FIELDS.index("coulomb_friction")]
        self._weights = Weights(self.gains.velocity_weight, self.gains.torque_weight)

    def predict(
        self,
        observation: NDArray[np.float32],
        state: PrivilegedMemory | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], PrivilegedMemory]:
        """Torque over its limit, shape (n, 1), for observations of shape (n, 24).

        Raises:
            ValueError: If there are not as many rows as arms, or they lack the torsion.
        """
        if observation.shape != (len(self._table), _TORSION.stop):
            raise ValueError(
                f'observations must have shape ({len(self._table)}, {_TORSION.stop}), sensors="full" and one row for '
                f"each arm, got {observation.shape}"
            )
        reading = read(observation, self.params)
        begins = beginning(state, episode_start, len(observation))
        plans = replanned(state.plans if state else None, begins, reading.move, self._table, self._weights)
        torsion = observation[:, _TORSION].astype(np.float64) * _SCALES
        x = np.column_stack([reading.motor_angle, reading.motor_speed, torsion])
        torque = planned_torque(plans, reading.step, x)
        direction = breakaway_direction(reading.motor_speed, torque, self.gains.friction_speed)
        return as_action(
            torque + self.gains.friction_share * self._friction * direction, self.params
        ), PrivilegedMemory(plans)
