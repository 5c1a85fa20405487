"""Speed of PPO's loop, rollout and update, beside one over single arms; the model is that of `train/ppo.py`."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

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
    """Speed of the loop on the batch, beside the same on single arms, with as many samples per update."""
    config = config or PpoConfig(threads=default_jobs())  # a thread for each core, as PyTorch has by default
    count, samples = min(_SINGLE_ARMS, config.arms), config.arms * config.rollout_steps
    batch, single_arms = make_env(config), DummyVecEnv([partial(_single_arm, config)] * count)
    for env in (batch, single_arms):
        env.seed(training_arms(config.seed).first)
    beside = PPO("MlpPolicy", single_arms, **replace(config, rollout_steps=samples // count).arguments())
    torch.set_num_threads(config.threads)
    runs = [partial(each.learn, samples, reset_num_timesteps=False) for each in (make_model(config, batch), beside)]
    times, of_peer = times_in_turns(runs, min(repetitions, _MOST_REPETITIONS)).T
    steps, peer = samples * config.hold, f"PPO on {_SINGLE_ARMS} single arms in a DummyVecEnv"
    return speed(f"PPO, rollout and update, {config.arms} arms", steps, times, peer, steps, of_peer)


def _single_arm(config: PpoConfig) -> ResidualEnv:
    arm = gym.make("BeltArm-v0", sensors=config.sensors, randomization="train")
    return ResidualEnv(arm, make_base(config.base), config.residual)
