"""Train a residual policy with TD3, twin delayed deterministic policy gradient: `python train/td3.py`.

What a run writes is as in `train/ppo.py`; how it differs from the textbook's is said in
`agents/learners/off_policy.py`.

S. Fujimoto et al.: Addressing Function Approximation Error in Actor-Critic Methods, 2018.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import torch
from stable_baselines3 import TD3
from torch import nn

from agents.learners.off_policy import ExploringFromTheBase, OffPolicyConfig, begin_near_zero
from agents.learners.reinforcement import ModelLearner
from agents.residual.env import ResidualVecEnv
from agents.runs.command_line import main


@dataclass(frozen=True)
class Config(OffPolicyConfig):
    """Train a residual TD3 policy."""

    algorithm: ClassVar[str] = "td3"

    out: Path = Path("runs/td3")
    """Folder of the run; of several seeds' runs, the folder of their folders seed0, seed1, ..."""
    noise: float = 0.3
    """Standard deviation of the noise added to actions, all the exploration that there is."""
    policy_delay: int = 2
    """Gradient steps of the critics for each of the actor."""
    target_noise: float = 0.2
    """Standard deviation of the noise on the target's action, which smooths the critics."""
    target_noise_limit: float = 0.5
    """Largest noise on the target's action."""
    restraint: float = 0.2
    """Weight of the squared output before its tanh, in the actor's loss: a tanh that saturates learns no more."""

    def check(self) -> None:
        """Check the options, see `RunConfig.check`."""
        super().check()
        self.at_least(1, "policy_delay")
        self.at_least(0, "target_noise", "target_noise_limit", "restraint")


class Restraint(nn.Module):
    """Hands on its input u; backwards it adds the gradient of weight / 2 times the batch's mean of u^2."""

    def __init__(self, weight: float) -> None:
        super().__init__()
        self.weight = weight

    def forward(self, output: torch.Tensor) -> torch.Tensor:
        """The input, shape (n, 1)."""
        if output.requires_grad:
            push = self.weight * output.detach() / len(output)
            output.register_hook(lambda gradient: gradient + push)
        return output


class ResidualTD3(ExploringFromTheBase, TD3):
    """TD3 that begins with its base."""


def make_model(config: Config, env: ResidualVecEnv) -> TD3:
    """An untrained model whose residual is near zero."""
    model = ResidualTD3(
        "MlpPolicy",
        env,
        policy_delay=config.policy_delay,
        target_policy_noise=config.target_noise,
        target_noise_clip=config.target_noise_limit,
        **config.arguments(),
    )
    begin_near_zero(model)
    model.actor.mu.insert(len(model.actor.mu) - 1, Restraint(config.restraint))
    return model


def make_learner(config: Config) -> ModelLearner:
    """An untrained learner."""
    return ModelLearner(config, make_model)


if __name__ == "__main__":
    main(Config, make_learner, __doc__)
