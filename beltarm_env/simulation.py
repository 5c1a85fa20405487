"""Plant alone, without sensors, reference and episodes: for controllers and observers that simulate their arm.

The state of an arm whose drive is ideal is x = [theta_a, omega_a, theta_s, omega_s], and its commands act at once. Of a
drive as it is built, the motor's torque and the torques commanded in the last three samples are states too, which stand
beside x:

    [theta_a, omega_a, theta_s, omega_s, tau, (1 + k) u[k-1], (1 + k) u[k-2], (1 + k) u[k-3]]

States are given and returned, and nothing else is kept from call to call. So friction does not drift here, unless
`set_table` is told at which sample of an episode each arm is.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from beltarm_env.arm import COLUMN, ArmParams, params_table, plant_of
from beltarm_env.arrays import Floats
from beltarm_env.jit import compiled
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.advance import WORK_ROWS, advance_block
from beltarm_env.kernels.advance_driven import DRIVEN_WORK_ROWS, advance_driven_block, begin_drive
from beltarm_env.kernels.layout import LANES, load_drive, load_plant, load_state, store_plant, store_state
from beltarm_env.physics.drive import DRIVE_COLUMNS, resting
from beltarm_env.physics.models import MODELS, Model
from beltarm_env.physics.state import ArmState
from beltarm_env.physics.substeps import check_integrable, integration_substeps
from beltarm_env.timing import LATENCY_SAMPLES

X = 4
"""Entries of an arm's state x."""
DRIVE_STATES = 1 + LATENCY_SAMPLES
"""Entries beside x: torque of the motor and past commands, which are adjacent rows of a block."""


@compiled
def load_arms(block: Floats, table: Floats, model: Model) -> None:
    """Put constants, rows as the fields of `ArmParams`, shape (len(FIELDS), n), into the first n lanes of a block."""
    for j in range(table.shape[1]):
        plant = plant_of(table[:, j])
        store_plant(block, j, plant)
        block[at.SUBSTEPS * LANES + j] = integration_substeps(plant, model)


@compiled
def _load_blocks(blocks: Floats, table: Floats, steps: Floats, model: Model) -> None:
    for k in range(len(blocks)):
        arms = table[k * LANES : (k + 1) * LANES]
        load_arms(blocks[k], arms.T, model)
        for j in range(len(arms)):
            begin_drive(blocks[k], j, arms[j])
            if len(steps) == 0:
                blocks[k][at.DRIFT * LANES + j] = 0.0
            else:
                blocks[k][at.STEP * LANES + j] = steps[k * LANES + j]


@compiled
def _rest(blocks: Floats, angles: Floats, states: Floats) -> None:
    for i in range(len(angles)):
        block, lane = blocks[i // LANES], i % LANES
        x = resting(angles[i], load_plant(block, lane), load_drive(block, lane))
        states[i, 0], states[i, 1], states[i, 2], states[i, 3] = x


@compiled
def _advance(
    blocks: Floats, work: Floats, actions: Floats, states: Floats, torques: Floats, limits: Floats, model: Model
) -> Floats:
    count, size = states.shape
    result = np.empty((count, size))
    for k in range((count + LANES - 1) // LANES):
        low, high = k * LANES, min(k * LANES + LANES, count)
        for i in range(low, high):
            x = ArmState(states[i, 0], states[i, 1], states[i, 2], states[i, 3])
            store_state(blocks[k], at.STATE, i - low, x)
            for column in range(X, size):
                blocks[k][(at.TORQUE + column - X) * LANES + i - low] = states[i, column]
            actions[i - low] = min(max(torques[i] / limits[i], -1.0), 1.0)
        if size > X:
            advance_driven_block(blocks[k], work, actions, high - low, model)
        else:
            advance_block(blocks[k], work, actions, high - low, model)
        for i in range(low, high):
            x = load_state(blocks[k], at.STATE, i - low)
            result[i, 0], result[i, 1], result[i, 2], result[i, 3] = x
            for column in range(X, size):
                result[i, column] = blocks[k][(at.TORQUE + column - X) * LANES + i - low]
    return result


class ArmSimulation:
    """Simulation of any number of arms by one control period, by the environment's own kernels.

    States have 4 entries, or 8 where an arm among them has a drive as it is built; see above.

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
        self._blocks = at.empty_blocks(len(table))
        self._actions = np.zeros(LANES)
        self._load(table)

    def set_table(self, table: Floats, steps: Floats | None = None) -> None:
        """Replace the constants by others near those before.

        Args:
            table: Columns as `ArmParams`, shape (n, len(FIELDS)).
            steps: Sample of the episode that each arm is at, by which its friction has drifted, shape (n,); None for
                friction as it is at the beginning.

        Raises:
            ValueError: If these are more arms than there is room for, which is as many as at the beginning.
        """
        if len(table) > len(self._blocks) * LANES:
            raise ValueError(f"there is room for {len(self._blocks) * LANES} arms, got {len(table)}")
        self._load(table, steps)

    def _load(self, table: Floats, steps: Floats | None = None) -> None:
        self._limits = table[:, COLUMN.torque_limit].copy()
        driven = bool(table[:, DRIVE_COLUMNS].any())
        self.size = X + DRIVE_STATES if driven else X
        """Entries of an arm's state."""
        self._work = np.zeros((DRIVEN_WORK_ROWS if driven else WORK_ROWS) * LANES)
        _load_blocks(self._blocks, table, np.empty(0) if steps is None else steps, self._model)

    def at_rest(self, motor_angles: Floats) -> Floats:
        """Return the states of arms at rest at motor angles [rad] of shape (n,), without torque in motor or belt."""
        states = np.zeros((len(motor_angles), self.size))
        _rest(self._blocks, motor_angles, states)
        return states

    def advance(self, states: Floats, torques: Floats) -> Floats:
        """Compute the states one control period later.

        Args:
            states: x (rad, rad/s), and the drive's states [N m] beside it; shape (n, size).
            torques: Commanded for the period [N m], shape (n,); cut at the torque limit.

        Raises:
            ValueError: If there are not as many as arms.
        """
        if states.shape != (len(self._limits), self.size) or torques.shape != self._limits.shape:
            count, size = len(self._limits), self.size
            raise ValueError(
                f"states and torques must have shapes ({count}, {size}) and ({count},), "
                f"got {states.shape}, {torques.shape}"
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

    def ahead(self, states: Floats, torques: Floats, samples: Floats) -> Floats:
        """Compute x at a time to come with the commands held until then, between samples by linear interpolation.

        Args:
            states: Shape (n, size).
            torques: Commands [N m], shape (n,).
            samples: How far ahead, in control periods, shape (n,).
        """
        result = states[:, :X].copy()
        for k in range(int(np.ceil(samples.max()))):
            following = self.advance(states, torques)
            share = np.minimum(np.maximum(samples - k, 0.0), 1.0)[:, None]
            result += share * (following - states)[:, :X]
            states = following
        return result
