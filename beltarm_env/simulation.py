"""Plant alone, without sensors, reference and episodes: for controllers and observers that simulate their arm.

The state of an arm whose drive is ideal is x = [theta_a, omega_a, theta_s, omega_s], and its commands act at once. Of a
real drive, the motor's torque, the torques commanded in the last three samples, and how far a motor that
sticks has given are states too, which stand beside x:

    [theta_a, omega_a, theta_s, omega_s, tau, (1 + k) u[k-1], (1 + k) u[k-2], (1 + k) u[k-3], z]

Where the motor slides, z is 1 or -1 (`physics.friction.SLIPS`).

States are given and returned, and nothing else is kept from call to call. So friction does not drift here, unless
`set_table` is told at which sample of its move each arm is.

Kernels that have one arm simulate it by `beltarm_env.kernels.simulate`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from beltarm_env.arm import COLUMN, ArmParams, params_table
from beltarm_env.arrays import Floats
from beltarm_env.kernels.layout import LANES
from beltarm_env.kernels.simulate import (
    DRIVE_STATES,
    X,
    advance_arms,
    load_arms,
    look_ahead_arms,
    rest_arms,
    room_for,
    state_size,
)
from beltarm_env.physics.models import OWN_MODELS, model_of
from beltarm_env.physics.substeps import check_integrable

__all__ = ["DRIVE_STATES", "ArmSimulation", "X"]


class ArmSimulation:
    """Simulation of any number of arms by one control period, by the environment's own kernels.

    States have 4 entries, or 9 where an arm among them has a real drive; see above.

    Args:
        params: One set of constants for each arm, or one for all.
        num_arms: How many arms, if `params` is one set.
        model: "lumped" or "lagrangian".

    Raises:
        ValueError: If the model is unknown, or an arm is too stiff to integrate.
    """

    def __init__(self, params: ArmParams | Sequence[ArmParams], num_arms: int = 1, model: str = "lumped") -> None:
        self.model = model_of(model, OWN_MODELS)
        arms = [params] if isinstance(params, ArmParams) else list(params)
        table = params_table(arms)
        check_integrable(table, self.model)
        table = np.repeat(table, num_arms, axis=0) if isinstance(params, ArmParams) else table
        self.room = room_for(len(table))
        self._load(table)

    def set_table(self, table: Floats, steps: Floats | None = None) -> None:
        """Replace the constants by others near those before.

        Args:
            table: Columns as `ArmParams`, shape (n, len(FIELDS)).
            steps: Sample of its move that each arm is at, by which its friction has drifted, shape (n,); None for
                friction as it is at the beginning.

        Raises:
            ValueError: If these are more arms than there is room for, which is as many as at the beginning, or `steps`
                has another shape, or is not finite.
        """
        most = len(self.room.blocks) * LANES
        if len(table) > most:
            raise ValueError(f"there is room for {most} arms, got {len(table)}")
        if steps is not None:
            _require(len(table), steps=steps)
        self._load(table, steps)

    def _load(self, table: Floats, steps: Floats | None = None) -> None:
        self.limits = table[:, COLUMN.torque_limit].copy()
        self.size = state_size(table)
        """Entries of an arm's state."""
        load_arms(self.room.blocks, table, np.empty(0) if steps is None else steps, self.model)

    def at_rest(self, motor_angles: Floats) -> Floats:
        """Return the states of arms at rest at motor angles [rad], without torque in motor or belt.

        Args:
            motor_angles: Shape (n,).

        Raises:
            ValueError: If there are not as many as arms, or a number is not finite.
        """
        _require(len(self.limits), motor_angles=motor_angles)
        states = np.zeros((len(motor_angles), self.size))
        rest_arms(self.room.blocks, np.ascontiguousarray(motor_angles, np.float64), states)
        return states

    def advance(self, states: Floats, torques: Floats) -> Floats:
        """Compute the states one control period later.

        Args:
            states: x (rad, rad/s), and the drive's states [N m] beside it; shape (n, size).
            torques: Commanded for the period [N m], shape (n,); cut at the torque limit.

        Raises:
            ValueError: If there are not as many as arms, or a torque is not finite.
        """
        _require(len(self.limits), self.size, states=states, torques=torques)
        states = np.ascontiguousarray(states, np.float64)
        result = np.empty_like(states)
        advance_arms(self.room, states, self._actions(torques), self.model, result)
        return result

    def ahead(self, states: Floats, torques: Floats, samples: Floats) -> Floats:
        """Compute x at a time to come with the commands held until then, between samples by linear interpolation.

        Args:
            states: Shape (n, size).
            torques: Commands [N m], shape (n,).
            samples: How far ahead, in control periods, shape (n,).

        Raises:
            ValueError: If there are not as many as arms, a torque or time is not finite, or a time is negative.
        """
        _require(len(self.limits), self.size, states=states, torques=torques, samples=samples)
        if np.min(samples, initial=0.0) < 0:
            raise ValueError(f"samples must not be negative, got {np.min(samples)}: states are simulated forwards")
        states, result = np.ascontiguousarray(states, np.float64), np.empty((len(states), X))
        actions, samples = self._actions(torques), np.ascontiguousarray(samples, np.float64)
        look_ahead_arms(self.room, states, actions, samples, self.model, result)
        return result

    def _actions(self, torques: Floats) -> Floats:
        """Commanded torques over their limits, cut to [-1, 1]."""
        return np.clip(np.asarray(torques, np.float64) / self.limits, -1.0, 1.0)


def _require(count: int, size: int = 0, **arrays: Floats) -> None:
    """Refuse, by ValueError, arrays not of shape (count,) or not finite, and states not of (count, size).

    Kernels do not look. The state of an arm that is lost is no number.
    """
    for name, array in arrays.items():
        shape = (count, size) if name == "states" else (count,)
        if np.shape(array) != shape:
            raise ValueError(f"{name} must have shape {shape}, got {np.shape(array)}")
        if name != "states" and not np.isfinite(array).all():
            raise ValueError(f"{name} must be finite, got {np.asarray(array)[~np.isfinite(array)][0]}")
