"""Run a controller over a batch of arms and record what happened.

Every controller, classical or learned, is called as Stable-Baselines3 calls a policy, so one function runs them all:
it sees the observation and nothing else, and keeps its memory in the state that it returns.
"""

from __future__ import annotations

import reprlib
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from gymnasium.vector import AutoresetMode

from beltarm_env.arm import COLUMN, FIELDS, ArmParams
from beltarm_env.arrays import Flags, Floats, Singles
from beltarm_env.observation import ENTRIES, index
from beltarm_env.physics.kinematics import HIGHEST
from beltarm_env.recording import Recording
from beltarm_env.task.cost import MAX_COST
from beltarm_env.task.reference import PROFILES
from beltarm_env.timing import EPISODE_STEPS
from beltarm_env.vector_env import BeltArmVectorEnv

__all__ = [
    "DATA_SHEET",
    "Controller",
    "Recording",
    "check_data_sheet",
    "check_profile",
    "check_sensors",
    "nominal_params",
    "nominal_profile",
    "record",
    "require_controller",
    "rollout",
]


class Controller(Protocol):
    """Protocol of everything that turns observations into torques.

    Observations and actions are relative to constants of the arm's data sheet, which nobody identifies: `gear_ratio`
    and `torque_limit`. A controller that relies on them has an attribute `params`, the `ArmParams` that it is made for,
    and is refused arms with others. One without `params` is not checked. The `profile` of the reference is not observed
    either: a controller that rebuilds the reference from the move has an attribute `profile`, the one that it rebuilds.
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


def nominal_profile(controller: object) -> str | None:
    """The shape of the reference that a controller rebuilds, if it says so in an attribute `profile`.

    Raises:
        ValueError: If there is no such shape.
    """
    profile = getattr(controller, "profile", None)
    if isinstance(profile, str) and profile not in PROFILES:
        known = ", ".join(PROFILES)
        raise ValueError(f"{type(controller).__name__}.profile must be None or one of {known}, got {profile!r}")
    return profile if isinstance(profile, str) else None


def check_profile(controller: object, profile: str | None) -> None:
    """Check that a controller that rebuilds the reference rebuilds this one, or raise ValueError."""
    if nominal_profile(controller) not in (None, profile):
        raise ValueError(
            f"{type(controller).__name__} rebuilds a reference with profile={nominal_profile(controller)!r} and would "
            f"follow that, where the reference has profile={profile!r}"
        )


def check_sensors(controller: object, given: str) -> None:
    """Check that a controller that says what it reads beside the encoder gets that, or raise ValueError."""
    own = getattr(controller, "sensors", None)
    if isinstance(own, str) and own in ENTRIES and own not in ("encoder", given):
        name = type(controller).__name__
        raise ValueError(f"{name} reads sensors={own!r}, got {given!r}: use an environment with sensors={own!r}")


def check_data_sheet(params: ArmParams | None, table: Floats, name: str) -> None:
    """Check that arms have the gear ratio and the torque limit that a controller is made for.

    Args:
        params: What the controller is made for; None for any arm.
        table: Constants of the arms, columns as `ArmParams`, shape (n, len(FIELDS)).
        name: Of the controller.

    Raises:
        ValueError: If an arm has another one, or its motor turns beyond what observations show.
    """
    if params is None:
        return
    seen = ENTRIES["encoder"][index("motor_angle")].bound
    if params.gear_ratio * HIGHEST > seen:
        most = f"observations show {seen:g} rad of the motor, enough for a gear ratio of {int(seen / HIGHEST)}"
        raise ValueError(f"{name} has gear_ratio {params.gear_ratio!r}, and would not see where the arm is: {most}")
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

    An episode of several moves, `moves=8` for example, is one `Recording` with a column for each arm and move.

    Args:
        controller: What to run; sees observations only.
        num_arms: Number of arms, run side by side.
        seed: Arm i is seeded with `seed + i`.
        options: What to fix, see `BeltArmVectorEnv.reset`.
        **settings: Arguments of `BeltArmVectorEnv`: sensors, profile, randomization, moves, ...

    Raises:
        ValueError: If a setting or option is not allowed, the controller is made for arms with another gear ratio or
            torque limit or another reference, or it returns another shape or NaN.
        TypeError: If the controller has no `predict`.
    """
    require_controller(controller)
    env = BeltArmVectorEnv(num_arms, autoreset_mode=AutoresetMode.DISABLED, **settings)
    return record(controller, env, seed=seed, options=options)


def require_controller(controller: object) -> None:
    """Check that an object is a controller.

    Raises:
        TypeError: If it is none, saying how to make one.
        ValueError: If it is a model of Stable-Baselines3 that learned on observations changed by `VecNormalize`.
    """
    if isinstance(controller, str):
        found = f"the name {controller!r}: baselines.CONTROLLERS[{controller!r}]() makes a classical one of that name"
    elif isinstance(controller, type):
        found = f"the class {controller.__name__}: {controller.__name__}() makes one"
    elif callable(getattr(controller, "predict", None)):
        find: Any = getattr(type(controller), "get_vec_normalize_env", lambda _: None)
        if getattr(find(controller), "norm_obs", False):
            raise ValueError(
                f"{type(controller).__name__} learned on observations that VecNormalize had changed, and would see "
                "others: give it `norm.normalize_obs(observation)` in a class of your own, see docs/guide/faq.md"
            )
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
        ValueError: As `rollout`, and if the environment's episodes are shorter than 1200 steps for each move, or its
            arms begin anew within the step in which they end.
    """
    num_arms, num_moves = env.num_envs, env.num_moves
    steps = EPISODE_STEPS * num_moves
    if env.max_episode_steps != steps:
        raise ValueError(f"a rollout has {steps} steps, got max_episode_steps={env.max_episode_steps}: leave it out")
    if env.autoreset_mode is AutoresetMode.SAME_STEP:
        raise ValueError("a rollout would record the next episodes of arms: make it with autoreset_mode='Disabled'")
    check_profile(controller, env.profile)
    check_sensors(controller, env.sensors)
    observation, _ = env.reset(seed=seed, options=None if options is None else dict(options))
    check_data_sheet(nominal_params(controller), env.params_table, type(controller).__name__)
    made = _Made.empty(num_moves, num_arms)
    left: dict[int, tuple[int, int]] = {}  # move and sample in which an arm left the workspace
    staying = np.ones(num_arms, np.bool_)
    memory: Any = None
    start = np.ones(num_arms, np.bool_)
    for move in range(num_moves):
        made.params[move], made.moves[move] = env.params_table, env.moves
        for k in range(EPISODE_STEPS):
            answer = controller.predict(observation, memory, start, deterministic=True)
            if not isinstance(answer, tuple | list) or len(answer) != 2:
                raise ValueError(
                    f"{type(controller).__name__}.predict must return (action, state), got {type(answer).__name__}"
                )
            action, memory = answer
            observation, reward, terminated, truncated, _ = env.step(action)
            made.torque[k, move], made.states[k, move], made.errors[k, move] = action[:, 0], env.state, env.tip_errors()
            made.cost[move] -= reward * staying
            start = terminated
            if terminated.any():
                left |= {int(arm): (move, k) for arm in np.flatnonzero(terminated & staying)}
                staying &= ~terminated
                if not truncated.any():  # keep the batch going; what these arms do from now on is not recorded
                    observation, _ = env.reset(options={"reset_mask": terminated})
    for arm, (move, k) in left.items():
        made.stop(arm, move, k)
    return made.recording()


class _Made(NamedTuple):
    """Recording in the making; axes are samples, moves and arms."""

    states: Floats  # (T, moves, n, 4)
    errors: Floats  # (T, moves, n, 4)
    torque: Floats  # over the limit    (T, moves, n)
    cost: Floats  # (moves, n)
    finished: Flags  # (moves, n)
    params: Floats  # (moves, n, len(FIELDS))
    moves: Floats  # (moves, n, 4)

    @classmethod
    def empty(cls, num_moves: int, num_arms: int) -> _Made:
        each = num_moves, num_arms
        samples = EPISODE_STEPS, *each
        motion = np.empty((*samples, 4)), np.empty((*samples, 4)), np.empty(samples)
        constants = np.empty((*each, len(FIELDS))), np.empty((*each, 4))
        return cls(*motion, np.zeros(each), np.ones(each, np.bool_), *constants)

    def stop(self, arm: int, move: int, k: int) -> None:
        """Let an arm stay where it left the workspace, in sample k of a move, and charge it for all later moves."""
        last_state, last_error = self.states[k, move, arm].copy(), self.errors[k, move, arm].copy()
        rest = (slice(k + 1, None), move, arm), (slice(None), slice(move + 1, None), arm)
        for part in rest:
            self.states[part], self.errors[part], self.torque[part] = last_state, last_error, 0.0
        later, whole = len(self.cost) - move - 1, MAX_COST * EPISODE_STEPS
        self.finished[move:, arm] = False
        self.cost[move, arm] -= later * whole
        self.cost[move + 1 :, arm] = whole
        self.params[move + 1 :, arm], self.moves[move + 1 :, arm] = self.params[move, arm], self.moves[move, arm]

    def recording(self) -> Recording:
        states, errors, torque, cost, finished, params, moves = self
        torque = np.clip(torque, -1, 1, out=torque) * params[..., COLUMN.torque_limit]
        before = np.concatenate([np.zeros((1, cost.shape[1])), torque[-1, :-1]])
        columns = cost.size
        motion = states.reshape(EPISODE_STEPS, columns, 4), torque.reshape(EPISODE_STEPS, columns)
        errors = errors.reshape(EPISODE_STEPS, columns, 4)
        constants = params.reshape(columns, -1), moves.reshape(columns, 4)
        outcome = cost.ravel(), finished.ravel(), *constants
        return Recording(*motion, errors[:, :, :2], errors[:, :, 2:], *outcome, len(cost), before.ravel())
