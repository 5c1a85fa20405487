"""Full arms moved by MuJoCo instead of by the kernels: a single one, and batches as the engine of an `ArmBatch`."""

from __future__ import annotations

from typing import Any

import numpy as np

from beltarm_env.arm import ArmParams
from beltarm_env.arrays import Floats, Integers
from beltarm_env.mujoco.drive import Actuator, check_expressible
from beltarm_env.mujoco.model import load_model, mujoco, read_state, write_state
from beltarm_env.physics.models import FULL_ARM
from beltarm_env.physics.substeps import integration_substeps
from beltarm_env.timing import CONTROL_PERIOD, EPISODE_STEPS

STEPS = 2
"""MuJoCo steps for each step that the kernels would take; what is left of friction's softness shrinks with them."""


class MuJoCoArm:
    """One arm with its drive, moved by MuJoCo.

    Args:
        params: Constants of the arm.
        steps: MuJoCo steps per control period; by default `STEPS` for each that the kernels would take. A sample in
            which a command arrives late has them, or one more, in its two pieces.
        **settings: Of `load_model`.

    Raises:
        ValueError: If a setting is out of range, or the arm has an effect of the drive that MuJoCo cannot express.
    """

    def __init__(self, params: ArmParams, steps: int | None = None, **settings: Any) -> None:
        self.params = params
        """Constants of the arm."""
        if steps is None:
            steps = STEPS * int(integration_substeps(params.plant(), FULL_ARM))
        self._step = CONTROL_PERIOD / steps
        self._model = load_model(params, self._step, **settings)
        self._data = mujoco.MjData(self._model)
        self._damping, self._friction = self._model.dof_damping[0], self._model.dof_frictionloss[0]
        self.begin(np.zeros(4))

    def begin(self, state: Floats) -> None:
        """Begin an episode at x = [theta_a, omega_a, theta_s, omega_s] (rad, rad/s)."""
        mujoco.mj_resetData(self._model, self._data)
        write_state(self._data, self.params, state)
        self._actuator = Actuator(self.params)
        self._samples = 0

    def changed(self, params: ArmParams) -> MuJoCoArm:
        """Make the arm with other constants, in the same state, with the same commands on their way."""
        arm = MuJoCoArm(params)
        arm.begin(read_state(self._data, self.params))
        arm._actuator = self._actuator
        return arm

    @property
    def torque(self) -> float:
        """Torque of the motor now [N m]."""
        return self._actuator.torque

    def advance(self, command: float) -> Floats:
        """Let one control period pass after a new command [N m]; return x at its end.

        Friction has drifted to 1 + delta (k + 1/2) / 1200 in sample k, its middle, and is held there.
        """
        drifted = 1 + self.params.friction_drift * (self._samples + 0.5) / EPISODE_STEPS
        self._model.dof_damping[0] = drifted * self._damping
        self._model.dof_frictionloss[0] = drifted * self._friction
        for dt, count, torque in self._actuator.means(command, self._step):
            self._model.opt.timestep = dt
            self._data.ctrl[0] = torque
            mujoco.mj_step(self._model, self._data, count)
        self._samples += 1
        return read_state(self._data, self.params)


class MuJoCoArms:
    """Engine of `num_arms` arms, each with a MuJoCo model and state of its own."""

    def __init__(self, num_arms: int) -> None:
        self._arms: dict[int, MuJoCoArm] = {}
        self._num_arms = num_arms

    def check(self, table: Floats) -> None:
        """Check that MuJoCo can express the drives of arms with parameters (n, fields).

        Raises:
            ValueError: If it cannot.
        """
        check_expressible(table)

    def begin(self, arms: Integers, table: Floats, states: Floats | None) -> None:
        """Begin new episodes for arms with parameters (n, fields) from states (n, 4).

        Without states further moves begin: the arms get other constants, and all else goes on.
        """
        for k, (arm, row) in enumerate(zip(arms.tolist(), table, strict=True)):
            params = ArmParams.from_row(row)
            if states is None:
                self._arms[arm] = self._arms[arm].changed(params)
                continue
            if arm not in self._arms or params != self._arms[arm].params:
                self._arms[arm] = MuJoCoArm(params)
            self._arms[arm].begin(states[k])

    def torques(self) -> Floats:
        """Torques of the motors now [N m], shape (num_arms,)."""
        return np.array([self._arms[arm].torque for arm in range(self._num_arms)])

    def advance(self, actions: Floats) -> Floats:
        """Give torques over their limits, shape (num_arms,), for one control period; states, shape (num_arms, 4)."""
        states = np.empty((self._num_arms, 4))
        for arm in range(self._num_arms):
            own = self._arms[arm]
            states[arm] = own.advance(actions[arm] * own.params.torque_limit)
        return states
