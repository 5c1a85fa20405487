"""Plant alone, without sensors, reference and episodes: for controllers and observers that simulate their arm."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from beltarm_env.arm import COLUMN, ArmParams, params_table, plant_of
from beltarm_env.arrays import Floats
from beltarm_env.jit import compiled
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.advance import WORK_ROWS, advance_block
from beltarm_env.kernels.layout import LANES, load_state, store_plant, store_state
from beltarm_env.physics.models import MODELS, Model
from beltarm_env.physics.state import ArmState
from beltarm_env.physics.substeps import check_integrable, integration_substeps


@compiled
def load_arms(block: Floats, table: Floats, model: Model) -> None:
    """Put constants, rows as the fields of `ArmParams`, shape (len(FIELDS), n), into the first n lanes of a block."""
    for j in range(table.shape[1]):
        plant = plant_of(table[:, j])
        store_plant(block, j, plant)
        block[at.SUBSTEPS * LANES + j] = integration_substeps(plant, model)


@compiled
def _load_blocks(blocks: Floats, table: Floats, model: Model) -> None:
    for k in range(len(blocks)):
        load_arms(blocks[k], table[k * LANES : (k + 1) * LANES].T, model)


@compiled
def _advance(
    blocks: Floats, work: Floats, actions: Floats, states: Floats, torques: Floats, limits: Floats, model: Model
) -> Floats:
    count = len(states)
    result = np.empty((count, 4))
    for k in range((count + LANES - 1) // LANES):
        low, high = k * LANES, min(k * LANES + LANES, count)
        for i in range(low, high):
            x = ArmState(states[i, 0], states[i, 1], states[i, 2], states[i, 3])
            store_state(blocks[k], at.STATE, i - low, x)
            actions[i - low] = min(max(torques[i] / limits[i], -1.0), 1.0)
        advance_block(blocks[k], work, actions, high - low, model)
        for i in range(low, high):
            x = load_state(blocks[k], at.STATE, i - low)
            result[i, 0], result[i, 1], result[i, 2], result[i, 3] = x
    return result


class ArmSimulation:
    """Simulation of any number of arms by one control period, with the friction and the integrator of the environment.

    The drive is ideal, whatever the arms' constants say of theirs: torques act at once, and as they are commanded.

    Args:
        params: One set of constants for each arm, or one for all.
        num_arms: How many arms, if `params` is one set.
        model: "lumped" or "lagrangian".

    Raises:
        ValueError: If the model is unknown, or an arm is too stiff to integrate.
    """

    def __init__(self, params: ArmParams | Sequence[ArmParams], num_arms: int = 1, model: str = "lumped") -> None:
        if model not in ("lumped", "lagrangian"):
            raise ValueError(f"model must be one of 'lumped', 'lagrangian', got {model!r}")
        arms = [params] if isinstance(params, ArmParams) else list(params)
        table = params_table(arms)
        self._model = MODELS[model]
        check_integrable(table, self._model)
        table = np.repeat(table, num_arms, axis=0) if isinstance(params, ArmParams) else table
        self._limits = table[:, COLUMN.torque_limit].copy()
        self._blocks = at.empty_blocks(len(table))
        self._work, self._actions = np.zeros(WORK_ROWS * LANES), np.zeros(LANES)
        _load_blocks(self._blocks, table, self._model)

    def set_table(self, table: Floats) -> None:
        """Replace the constants by others near those before: columns as `ArmParams`, shape (n, len(FIELDS)).

        Raises:
            ValueError: If these are more arms than there is room for, which is as many as at the beginning.
        """
        if len(table) > len(self._blocks) * LANES:
            raise ValueError(f"there is room for {len(self._blocks) * LANES} arms, got {len(table)}")
        self._limits = table[:, COLUMN.torque_limit].copy()
        _load_blocks(self._blocks, table, self._model)

    def advance(self, states: Floats, torques: Floats) -> Floats:
        """Compute the states one control period later.

        Args:
            states: x = [theta_a, omega_a, theta_s, omega_s] (rad, rad/s), shape (n, 4).
            torques: Motor torques held over the period [N m], shape (n,); cut at the torque limit.

        Raises:
            ValueError: If there are not as many as arms.
        """
        if states.shape != (len(self._limits), 4) or torques.shape != self._limits.shape:
            count = len(self._limits)
            raise ValueError(
                f"states and torques must have shapes ({count}, 4) and ({count},), got {states.shape}, {torques.shape}"
            )
        return _advance(
            self._blocks,
            self._work,
            self._actions,
            np.ascontiguousarray(states, np.float64),
            np.ascontiguousarray(torques, np.float64),
            self._limits,
            self._model,
        )
