"""PPO of RLlib, its new API stack: `python docs/examples/rllib_ppo.py`.

It learns a torque on top of the paper's controller, as `train/ppo.py --base paper` does, on one `ResidualEnv` per arm.
RLlib takes one release of Gymnasium and no other. The environment works with it, but `constraints.txt` has a later one,
so RLlib gets a virtual environment of its own:

    python3.11 -m venv build/rllib
    build/rllib/bin/pip install -c docs/examples/rllib-constraints.txt "ray[rllib]" -e ".[checkout]"
    build/rllib/bin/python docs/examples/rllib_ppo.py
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
import ray
import torch
import tyro
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig
from ray.tune.registry import register_env

import beltarm_env  # noqa: F401  registers BeltArm-v0
from agents.residual.bases import make_base
from agents.residual.controller import ResidualController, ResidualSettings
from agents.residual.env import ResidualEnv
from agents.runs.training import validate
from beltarm_env.task.seeds import MAX_TRAINING_SEED, training_arms

SETTINGS = ResidualSettings(limit=1.0, hold=4)
REWARD_SCALE = 0.009  # brings values to order 1
WORST_REWARD = -240.0  # an arm that leaves its workspace is charged for all its remaining samples at once


@dataclass
class Args:
    """Options of the run."""

    seed: int = 0
    """Random seed, 0 to 99."""
    iterations: int = 20
    """Rollouts, each followed by an update."""
    train_batch_size: int = 16384
    """Agent steps in each rollout, of 4 samples each."""
    num_envs: int = 32
    """Arms in each process."""
    num_env_runners: int = 0
    """Processes that simulate arms; 0 simulates in this one."""
    validation_arms: int = 128
    """Arms on which the policy is compared with the paper's controller in the end."""


def make_env(_: Any) -> gym.Env[Any, Any]:
    """One arm, drawn anew for each episode, under the paper's controller; the action is a residual."""
    env = ResidualEnv(gym.make("BeltArm-v0", randomization="train"), make_base("paper"), SETTINGS)
    return gym.wrappers.TransformReward(env, lambda reward: REWARD_SCALE * max(float(reward), WORST_REWARD))


class LearnedResidual:
    """The module as a policy: the mean of its distribution."""

    def __init__(self, module: Any) -> None:
        self.module = module

    def predict(self, observation: Any, *_: Any, **__: Any) -> tuple[Any, None]:
        """Residuals of shape (n, 1)."""
        with torch.no_grad():
            outputs = self.module.forward_inference({"obs": torch.from_numpy(observation)})
        return outputs["action_dist_inputs"][:, :1].clamp(-1, 1).numpy(), None


if __name__ == "__main__":
    args = tyro.cli(Args, description=__doc__)
    if not 0 <= args.seed <= MAX_TRAINING_SEED:
        raise SystemExit(f"--seed must lie within 0 and {MAX_TRAINING_SEED}, got {args.seed}")
    ray.init(num_cpus=1 + args.num_env_runners, include_dashboard=False, log_to_driver=False)
    register_env("residual-arm", make_env)
    config = (
        PPOConfig()
        .environment("residual-arm")
        .env_runners(num_env_runners=args.num_env_runners, num_envs_per_env_runner=args.num_envs)
        .training(
            train_batch_size_per_learner=args.train_batch_size,
            minibatch_size=min(1024, args.train_batch_size),
            num_epochs=4,
            lr=3.5e-4,
            gamma=0.988,
            lambda_=0.962,
            clip_param=0.2,
            use_kl_loss=False,
            vf_clip_param=float("inf"),
            vf_loss_coeff=0.5,
            entropy_coeff=0.0,
            grad_clip=0.5,
        )
        .rl_module(model_config=DefaultModelConfig(fcnet_hiddens=[256, 256], fcnet_activation="relu"))
        .debugging(seed=training_arms(args.seed).first)  # arm i is seeded with this number plus i
    )
    algorithm = config.build_algo()
    for iteration in range(1, args.iterations + 1):
        result = algorithm.train()["env_runners"]
        episodic_return = result.get("episode_return_mean", np.nan) / REWARD_SCALE
        steps = int(result["num_env_steps_sampled_lifetime"])
        print(f"iteration {iteration}: {steps} agent steps, mean return {episodic_return:.0f}", flush=True)

    policy = LearnedResidual(algorithm.get_module())
    before = validate(make_base("paper"), args.validation_arms)["cost"]
    after = validate(ResidualController(make_base("paper"), policy, SETTINGS), args.validation_arms)["cost"]
    print(f"cost on {args.validation_arms} validation arms: {before:.1f} of paper alone, {after:.1f} with the residual")
    algorithm.stop()
    ray.shutdown()
