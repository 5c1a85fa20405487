"""The residual task as environments: for one arm (Gymnasium) and for a batch (Stable-Baselines3)."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv

from agents.residual.controller import ResidualSettings, checked_residual, combine
from agents.residual.knowledge import InformedBase, InformedMemory, residual_observation_space
from beltarm_env import EPISODE_STEPS, BeltArmEnv, BeltArmVectorEnv
from beltarm_env.arm import params_table
from beltarm_env.arrays import Flags, Singles
from beltarm_env.rollout import Controller, check_data_sheet, check_profile, check_sensors


class ResidualEnv(gym.Wrapper[Singles, Singles, Singles, Singles], RecordConstructorArgs):
    """One arm whose action is a residual on a base controller; a step is `hold` samples, its reward their sum.

    Raises:
        TypeError: If it is no arm, or the base is no controller.
        ValueError: If a wrapper has changed what the arm shows or is told: the base would read and command other units.
            If a hold lasts into the next move, see `ResidualSettings.check_moves`.
    """

    def __init__(self, env: gym.Env[Singles, Singles], base: Controller, settings: ResidualSettings) -> None:
        RecordConstructorArgs.__init__(self, _disable_deepcopy=True, base=base, settings=settings)
        super().__init__(env)
        if not isinstance(env.unwrapped, BeltArmEnv):
            raise TypeError(f"ResidualEnv wraps a BeltArmEnv, got {env.unwrapped!r}")
        self._arm = env.unwrapped
        own = self._arm.observation_space, self._arm.action_space
        layer, changed = env, (env.observation_space, env.action_space) != own
        while isinstance(layer, gym.Wrapper):
            layer, changed = layer.env, changed or isinstance(layer, gym.ObservationWrapper | gym.ActionWrapper)
        if changed:
            raise ValueError(f"the base needs the arm's own observations and actions, got {env}: put ResidualEnv first")
        check_profile(base, self._arm.profile)
        check_sensors(base, self._arm.sensors)
        settings.check_moves(self._arm.num_moves)
        self.informed = InformedBase(base, settings.knowledge)
        self.settings = settings
        self.action_space: spaces.Space[Any] = spaces.Box(-1.0, 1.0, (1,), np.float32)
        self.observation_space: spaces.Space[Any] = residual_observation_space(self._arm.sensors, settings.knowledge)
        self._memory: InformedMemory | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Singles, dict[str, Any]]:
        """Begin an episode, see `BeltArmEnv.reset`."""
        observation, info = self.env.reset(seed=seed, options=options)
        check_data_sheet(self.informed.params, params_table([self._arm.params]), type(self.informed.base).__name__)
        self._memory = self.informed.advance(observation[None], None, None)
        return self.informed.seen(observation[None], self._memory)[0], info

    def step(self, action: Singles) -> tuple[Singles, float, bool, bool, dict[str, Any]]:
        """Hold a residual for `hold` samples, or until the episode ends."""
        if self._memory is None:
            raise ResetNeeded("no episode is running: call reset() before step()")
        residual = checked_residual(np.asarray(action)[None], 1)
        total, samples = 0.0, 0
        while True:
            command = combine(self._memory.action, residual, self.settings.limit)
            observation, reward, terminated, truncated, info = self.env.step(command[0])
            total += float(reward)
            samples += 1
            self._memory = self.informed.advance(observation[None], self._memory, None)
            if terminated or truncated or samples == self.settings.hold:
                seen = self.informed.seen(observation[None], self._memory)[0]
                return seen, total, terminated, truncated, info


class ResidualVecEnv(VecEnv):
    """A batch of arms for Stable-Baselines3, whose actions are residuals on a base controller, cut to [-1, 1].

    Rollouts for learning may begin amid episodes, of which the base alone has moved the beginning (`stagger`). To
    evaluate an agent, use `beltarm_env.rollout.rollout` with a `ResidualController`, or another batch without it.

    Same-step reset with `terminal_observation` and `TimeLimit.truncated`. An arm that ends within a hold goes on in its
    new episode under the base alone until the hold is over.

    Args:
        env: The arms, with same-step autoreset.
        base: The base controller.
        settings: How the residual acts.
        reward_scale: Factor on the reward, the sum over the samples of a hold.
        torque_price: What a change of the torque from sample to sample is charged, over what the task charges.
        worst_reward: Scaled rewards are cut to at least minus this, for learners that a rare huge charge throws off.
        stagger: Spread the arms over the phases of the episode, so that a rollout sees all of them.
    """

    def __init__(  # noqa: PLR0913  options by keyword
        self,
        env: BeltArmVectorEnv,
        base: Controller,
        settings: ResidualSettings,
        *,
        reward_scale: float = 1.0,
        torque_price: float = 1.0,
        worst_reward: float = np.inf,
        stagger: bool = True,
    ) -> None:
        if not isinstance(env, BeltArmVectorEnv):
            raise TypeError(f"ResidualVecEnv takes a BeltArmVectorEnv, unwrapped, got {env!r}")
        if env.autoreset_mode is not AutoresetMode.SAME_STEP:
            raise ValueError(f"ResidualVecEnv needs autoreset_mode='SameStep', got {env.autoreset_mode.value!r}")
        check_profile(base, env.profile)
        check_sensors(base, env.sensors)
        settings.check_moves(env.num_moves)
        self.env = env
        self.informed = InformedBase(base, settings.knowledge)
        self.settings = settings
        self.reward_scale = reward_scale
        self.torque_price = torque_price
        self.worst_reward = worst_reward
        self.stagger = stagger
        self._memory: InformedMemory | None = None
        self._residual = np.zeros((env.num_envs, 1), np.float32)
        space = residual_observation_space(env.sensors, settings.knowledge)
        super().__init__(env.num_envs, space, spaces.Box(-1.0, 1.0, (1,), np.float32))

    def reset(self) -> Singles:
        """Begin new episodes in all arms."""
        seeds = None if self._seeds[0] is None else [int(seed) for seed in self._seeds if seed is not None]
        observation, _ = self.env.reset(seed=seeds)
        check_data_sheet(self.informed.params, self.env.params_table, type(self.informed.base).__name__)
        self._reset_seeds()
        self._reset_options()
        self._memory = None
        start = np.ones(self.num_envs, np.bool_)
        if self.stagger:
            observation, start = self._spread(observation, start)
        self._memory = self.informed.advance(observation, self._memory, start)
        return self.informed.seen(observation, self._memory)

    def _spread(self, observation: Singles, start: Flags) -> tuple[Singles, Flags]:
        """Run the arms under the base for one episode, restarting one group after another."""
        hold, steps = self.settings.hold, EPISODE_STEPS * self.env.num_moves
        turn = (np.arange(self.num_envs) * (steps // hold) // self.num_envs + 1) * hold
        for step in range(1, steps + 1):
            self._memory = self.informed.advance(observation, self._memory, start)
            observation, _, terminated, truncated, _ = self.env.step(self._memory.action)
            start = terminated | truncated
            if (mask := turn == step).any():
                observation, _ = self.env.reset(options={"reset_mask": mask})
                start |= mask
        return observation, start

    def snapshot(self) -> dict[str, Any]:
        """State that determines the next step: arms, moves, random generators, sensor histories, the base's memory."""
        return {"arms": self.env, "memory": self._memory}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restore a snapshot of a batch with the same settings; takes over its arms, which are not copied."""
        self.env, self._memory = snapshot["arms"], snapshot["memory"]
        self._reset_seeds()

    def set_options(self, options: list[dict[str, Any]] | dict[str, Any] | None = None) -> None:
        """Refuse options: arms and moves are drawn at random here."""
        if options:
            raise NotImplementedError(f"ResidualVecEnv draws its episodes at random; options {options!r} are not used")

    def step_async(self, actions: Singles) -> None:
        """Take the residuals, shape (n, 1)."""
        self._residual = checked_residual(actions, self.num_envs)

    def step_wait(self) -> tuple[Singles, Singles, Flags, list[dict[str, Any]]]:
        """Hold the residuals for `hold` samples."""
        rewards = np.zeros(self.num_envs)
        done = np.zeros(self.num_envs, np.bool_)
        infos: list[dict[str, Any]] = [{}] * self.num_envs  # one for all: one per arm and step would cost more
        residual, observation = self._residual, np.empty(0, np.float32)
        assert self._memory is not None, "Stable-Baselines3 resets before it steps"
        for _ in range(self.settings.hold):
            command = combine(self._memory.action, residual, self.settings.limit)
            observation, reward, terminated, truncated, info = self.env.step(command)
            ended, charge = terminated | truncated, info["cost_torque_rate"]
            if ended.any():
                charge = np.where(ended, info["final_info"]["cost_torque_rate"], charge)
            reward = reward - (self.torque_price - 1.0) * charge
            rewards += reward if not done.any() else np.where(done, 0.0, reward)
            if ended.any():
                last = observation.copy()
                last[ended] = np.stack(info["final_obs"][ended])
                final = self.informed.advance(last, self._memory, None)
                self._memory = self.informed.advance(observation, self._memory, ended, final.belief)
                seen, summary = self.informed.seen(last, final), info["final_info"]
                for arm in np.flatnonzero(ended & ~done):
                    cost, steps = float(summary["total_cost"][arm]), int(summary["episode_steps"][arm])
                    infos[arm] = {
                        "terminal_observation": seen[arm],
                        "TimeLimit.truncated": bool(truncated[arm] and not terminated[arm]),
                        "episode": {"r": -cost, "l": steps, "t": 0.0},
                    }
                done |= ended
                residual = np.where(done[:, None], np.float32(0), residual)
            else:
                self._memory = self.informed.advance(observation, self._memory, None)
        seen = self.informed.seen(observation, self._memory)
        scaled = np.maximum(self.reward_scale * rewards, -self.worst_reward)
        return seen, scaled.astype(np.float32), done, infos

    def close(self) -> None:
        """Close the arms."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute of the batch, once per arm asked for."""
        value = getattr(self.env if hasattr(self.env, attr_name) else self, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refuse: the arms of a batch share their settings."""
        raise NotImplementedError(f"the arms of a batch share their settings; cannot set {attr_name!r} for some")

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Refuse: the arms of a batch are not environments of their own."""
        raise NotImplementedError(f"the arms of a batch are not environments of their own; cannot call {method_name!r}")

    def env_is_wrapped(self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: Any = None) -> list[bool]:
        """Return whether the arms asked for do what a wrapper does: they monitor their episodes."""
        return [wrapper_class is Monitor for _ in self._get_indices(indices)]
