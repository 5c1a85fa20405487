"""Speed of PPO's loop, rollout and update, beside one over single arms; the model is that of `train/ppo.py`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import gymnasium as gym
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv

from agents.learners.ppo import PpoConfig, make_model
from agents.learners.reinforcement import make_env
from agents.residual.bases import make_base
from agents.residual.env import ResidualEnv
from baselines.engines.parallel import default_jobs
from beltarm_env.task.seeds import training_arms
from eval.speed.timing import Row, speed, times_in_turns

_SINGLE_ARMS = 64
_MOST_REPETITIONS = 3


def loop_row(repetitions: int, config: PpoConfig | None = None) -> Row:
    """Speed of the loop on the batch, beside the same on single arms in a `DummyVecEnv`."""
    config = config or PpoConfig(threads=default_jobs())  # a thread for each core, as PyTorch has by default
    runs = [_on_batch(config), _on_single_arms(config)]
    times = times_in_turns(runs, min(repetitions, _MOST_REPETITIONS)).T
    steps = config.arms * config.rollout_steps * config.hold
    peer = f"PPO on {_SINGLE_ARMS} single arms in a DummyVecEnv"
    return speed(f"PPO, rollout and update, {config.arms} arms", steps, times[0], peer, steps, times[1])


def _on_batch(config: PpoConfig) -> Callable[[], object]:
    env = make_env(config)
    env.seed(training_arms(config.seed).first)
    return _iteration(make_model(config, env), config)


def _on_single_arms(config: PpoConfig) -> Callable[[], object]:
    """One iteration with as many samples per update."""
    count = min(_SINGLE_ARMS, config.arms)

    def make() -> ResidualEnv:
        arm = gym.make("BeltArm-v0", sensors=config.sensors, randomization="train")
        return ResidualEnv(arm, make_base(config.base), config.residual)

    env = DummyVecEnv([make] * count)
    env.seed(training_arms(config.seed).first)
    longer = replace(config, rollout_steps=config.arms * config.rollout_steps // count)
    return _iteration(PPO("MlpPolicy", env, **longer.arguments()), config)


def _iteration(model: PPO, config: PpoConfig) -> Callable[[], object]:
    torch.set_num_threads(config.threads)
    return lambda: model.learn(config.arms * config.rollout_steps, reset_num_timesteps=False)
