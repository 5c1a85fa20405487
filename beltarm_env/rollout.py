"""Run a controller over a batch of arms and record what happened.

Every controller, classical or learned, is called as Stable-Baselines3 calls a policy, so one function runs them all:
it sees the observation and nothing else, and keeps its memory in the state that it returns.
"""

from __future__ import annotations

import reprlib
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from gymnasium.vector import AutoresetMode

from beltarm_env.arm import COLUMN, FIELDS, ArmParams
from beltarm_env.arrays import Flags, Floats, Singles
from beltarm_env.recording import Recording
from beltarm_env.timing import EPISODE_STEPS
from beltarm_env.vector_env import BeltArmVectorEnv

__all__ = ["DATA_SHEET", "Controller", "Recording", "check_data_sheet", "nominal_params", "record", "rollout"]


class Controller(Protocol):
    """Protocol of everything that turns observations into torques.

    Observations and actions are relative to constants of the arm's data sheet, which nobody identifies: `gear_ratio`
    and `torque_limit`. A controller that relies on them has an attribute `params`, the `ArmParams` that it is made for,
    and is refused arms with others. One without `params` is not checked.
    """

    def predict(
        self, observation: Singles, state: Any = None, episode_start: Flags | None = None, deterministic: bool = True
    ) -> tuple[Singles, Any]:
        """Compute actions for a batch of observations.

        Args:
            observation: Shape (n, size).
            state: What the last call returned; None at the beginning.
            episode_start: Which rows begin a new episode, shape (n,); None means none but where `state` is None.
            deterministic: Whether to leave out exploration.

        Returns:
            Torque over its limit, shape (n, 1), float32, and the memory for the next call.
        """
        ...


DATA_SHEET = ("gear_ratio", "torque_limit")
"""Fields of `ArmParams` that controllers decode their observations with."""


def nominal_params(controller: Controller) -> ArmParams | None:
    """The arm that a controller is made for, if it says so in an attribute `params`."""
    params = getattr(controller, "params", None)
    return params if isinstance(params, ArmParams) else None


def check_data_sheet(params: ArmParams | None, table: Floats, name: str) -> None:
    """Check that arms have the gear ratio and the torque limit that a controller is made for.

    Args:
        params: What the controller is made for; None for any arm.
        table: Constants of the arms, columns as `ArmParams`, shape (n, len(FIELDS)).
        name: Of the controller.

    Raises:
        ValueError: If an arm has another one.
    """
    if params is None:
        return
    for field in DATA_SHEET:
        column, expected = table[:, FIELDS.index(field)], getattr(params, field)
        others = np.flatnonzero(column != expected)
        if len(others):
            value = float(column[others[0]])
            raise ValueError(
                f"arm {others[0]} has {field} {value!r}, but {name} is made for {expected!r} and would decode its "
                f"observations wrongly: make it with params=ArmParams({field}={value!r})"
            )


def rollout(
    controller: Controller,
    num_arms: int,
    *,
    seed: int | None = None,
    options: Mapping[str, Any] | None = None,
    **settings: Any,
) -> Recording:
    """Run one episode on each of `num_arms` arms.

    Args:
        controller: What to run; sees observations only.
        num_arms: Number of arms, run side by side.
        seed: Arm i is seeded with `seed + i`.
        options: What to fix, see `BeltArmVectorEnv.reset`.
        **settings: Arguments of `BeltArmVectorEnv`: sensors, profile, randomization, ...

    Raises:
        ValueError: If a setting or option is not allowed, the controller is made for arms with another gear ratio or
            torque limit, or it returns another shape or NaN.
        TypeError: If the controller has no `predict`.
    """
    _require_controller(controller)
    env = BeltArmVectorEnv(num_arms, autoreset_mode=AutoresetMode.DISABLED, **settings)
    return record(controller, env, seed=seed, options=options)


def _require_controller(controller: object) -> None:
    """Raise TypeError, saying how to make one, unless it is a controller."""
    if isinstance(controller, str):
        found = f"the name {controller!r}: baselines.CONTROLLERS[{controller!r}]() makes a classical one of that name"
    elif isinstance(controller, type):
        found = f"the class {controller.__name__}: {controller.__name__}() makes one"
    elif callable(getattr(controller, "predict", None)):
        return
    else:
        found = reprlib.repr(controller)
    raise TypeError(
        f"a controller is an object with a method predict (see beltarm_env.rollout.Controller), got {found}"
    )


def record(
    controller: Controller,
    env: BeltArmVectorEnv,
    *,
    seed: int | Sequence[int | None] | None = None,
    options: Mapping[str, Any] | None = None,
) -> Recording:
    """Run one episode on each arm of an environment, whose autoreset is disabled; otherwise as `rollout`.

    `seed` may also be one number per arm.

    Raises:
        ValueError: As `rollout`, and if the environment's episodes are shorter than 1200 steps.
    """
    if env.max_episode_steps != EPISODE_STEPS:
        raise ValueError(
            f"a rollout has {EPISODE_STEPS} steps, got max_episode_steps={env.max_episode_steps}: leave it out"
        )
    num_arms = env.num_envs
    observation, _ = env.reset(seed=seed, options=None if options is None else dict(options))
    params, moves = env.params_table, env.moves
    check_data_sheet(nominal_params(controller), params, type(controller).__name__)
    states = np.empty((EPISODE_STEPS, num_arms, 4))
    errors = np.empty((EPISODE_STEPS, num_arms, 4))
    torque = np.empty((EPISODE_STEPS, num_arms))
    steps = np.full(num_arms, EPISODE_STEPS)  # until the arm left the workspace
    finished = np.ones(num_arms, np.bool_)
    cost = np.zeros(num_arms)
    memory: Any = None
    start = np.ones(num_arms, np.bool_)
    for k in range(EPISODE_STEPS):
        action, memory = controller.predict(observation, memory, start, deterministic=True)
        observation, reward, terminated, truncated, _ = env.step(action)
        torque[k], states[k], errors[k] = action[:, 0], env.state, env.tip_errors()
        cost -= reward * finished
        start = terminated
        if terminated.any():
            steps[terminated & finished] = k + 1
            finished &= ~terminated
            if not truncated.any():  # keep the batch going; what these arms do from now on is not recorded
                observation, _ = env.reset(options={"reset_mask": terminated})
    for arm in np.flatnonzero(~finished):
        end = steps[arm]
        states[end:, arm], errors[end:, arm], torque[end:, arm] = states[end - 1, arm], errors[end - 1, arm], 0.0
    torque = np.clip(torque, -1, 1, out=torque) * params[:, COLUMN.torque_limit]
    return Recording(states, torque, errors[:, :, :2], errors[:, :, 2:], cost, finished, params, moves)
