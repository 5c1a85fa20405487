"""Batches of full arms moved by MuJoCo instead of by the kernels, as the engine of an `ArmBatch`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from beltarm_env.arm import ArmParams, plant_of
from beltarm_env.arrays import Floats, Integers
from beltarm_env.mujoco.model import load_model, mujoco, read_state, write_state
from beltarm_env.physics.models import FULL_ARM
from beltarm_env.physics.substeps import integration_substeps
from beltarm_env.timing import CONTROL_PERIOD

STEPS = 2
"""MuJoCo steps for each step that the kernels would take; what is left of friction's softness shrinks with them."""


@dataclass(frozen=True, slots=True)
class _Arm:
    params: ArmParams
    steps: int  # of MuJoCo per control period
    model: Any
    data: Any


class MuJoCoArms:
    """Engine of `num_arms` arms, each with a MuJoCo model and state of its own."""

    def __init__(self, num_arms: int) -> None:
        self._arms: dict[int, _Arm] = {}
        self._num_arms = num_arms

    def begin(self, arms: Integers, table: Floats, states: Floats) -> None:
        """Begin new episodes for arms with parameters (n, fields) from states (n, 4)."""
        for arm, row, state in zip(arms.tolist(), table, states, strict=True):
            params = ArmParams.from_row(row)
            if arm not in self._arms or params != self._arms[arm].params:
                steps = STEPS * int(integration_substeps(plant_of(row), FULL_ARM))
                model = load_model(params, CONTROL_PERIOD / steps)
                self._arms[arm] = _Arm(params, steps, model, mujoco.MjData(model))
            mujoco.mj_resetData(self._arms[arm].model, self._arms[arm].data)
            write_state(self._arms[arm].data, params, state)

    def advance(self, actions: Floats) -> Floats:
        """Hold torques over their limits, shape (num_arms,), for one control period; states, shape (num_arms, 4)."""
        states = np.empty((self._num_arms, 4))
        for arm in range(self._num_arms):
            own = self._arms[arm]
            own.data.ctrl[0] = actions[arm] * own.params.torque_limit
            mujoco.mj_step(own.model, own.data, own.steps)
            states[arm] = read_state(own.data, own.params)
        return states
