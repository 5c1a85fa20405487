"""SAC, soft actor-critic, as learner, with hundreds of arms side by side: its options, defaults and model.

Three things differ from what the algorithm does by default, see docs/science/training.md: the actor's last layer begins
near zero, exploration is the actor's own from the first step on, and gradients are clipped.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, log
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.type_aliases import RolloutReturn

from agents.learners.reinforcement import ReinforcementConfig
from agents.residual.env import ResidualVecEnv
from baselines.tools.command import require_bounds
from beltarm_env.task.cost import MAX_COST

_NEAR_ZERO = 0.01
_MAX_GRADIENT = 1.0
# Options that the library calls the same:
_SHARED = ("learning_rate", "buffer_size", "learning_starts", "batch_size", "gradient_steps", "tau", "target_entropy")


@dataclass(frozen=True)
class SacConfig(ReinforcementConfig):
    """Options of `train/sac.py`."""

    algorithm: ClassVar[str] = "sac"
    log_interval: ClassVar[int] = 1000

    out: Path = Path("runs/sac")
    total_steps: int = 2_000_000
    residual_limit: float = 0.5
    gamma: float = 0.9
    """Discount per agent step. 0.9 looks about 180 ms ahead."""
    reward_scale: float = 0.1
    validation_every: int = 250_000
    learning_rate: float = 3e-4
    hidden: tuple[int, ...] = (128, 128)
    buffer_size: int = 400_000
    """Agent steps that the replay buffer holds."""
    batch_size: int = 1024
    """Agent steps in each gradient step."""
    gradient_steps: int = 4
    """Gradient steps after each agent step of all arms."""
    learning_starts: int | None = None
    """Agent steps before the first gradient step. Default: 25000, which are half an episode of each arm, or half of
    --total-steps if that is less."""
    noise: float = 0.0
    """Standard deviation of noise on the actions, on top of the policy's own exploration."""
    exploration: float = 0.4
    """Standard deviation of the policy at the start. Residuals lie between -1 and 1."""
    initial_entropy_weight: float = 0.01
    """Weight of the entropy at the start. It is learned from then on."""
    target_entropy: float = -2.0
    """Entropy that the learned weight aims at. -2 is a standard deviation of 0.03."""
    tau: float = 0.01
    """How far target networks follow in each gradient step, from 0 to 1."""

    def __post_init__(self) -> None:
        """Fill in the steps before learning starts that stand where none are given."""
        self.fill_in(learning_starts=min(25_000, self.total_steps // 2))

    @property
    def worst_reward(self) -> float:
        """Reward floor: discounted value of the maximum cost forever, which leaving the workspace is charged with."""
        return MAX_COST * self.reward_scale / (1 - self.gamma) if self.gamma < 1 else inf

    def check(self) -> None:
        """Check the options, see `RunConfig.check`."""
        super().check()
        # A run that learned from its last step on would end before it learns.
        require_bounds(self, batch_size=(1, None), gradient_steps=(1, None), learning_starts=(0, self.total_steps - 1))
        require_bounds(self, noise=(0, None), tau=(0, 1), buffer_size=(max(self.arms, self.batch_size), None))
        self.positive("tau", "exploration", "initial_entropy_weight")

    def make_model(self, env: ResidualVecEnv) -> ResidualSAC:
        """Make an untrained model whose mean residual is near zero."""
        model = ResidualSAC(
            "MlpPolicy",
            env,
            **self.arguments(optimizer_class=ClippedAdam),
            **{name: getattr(self, name) for name in _SHARED},
            train_freq=(1, "step"),
            action_noise=NormalActionNoise(np.zeros(1), np.full(1, self.noise)) if self.noise else None,
            ent_coef=f"auto_{self.initial_entropy_weight}",
        )
        actor: Any = model.actor
        with torch.no_grad():
            actor.mu.weight.mul_(_NEAR_ZERO)
            actor.mu.bias.zero_()
            actor.log_std.weight.mul_(_NEAR_ZERO)
            actor.log_std.bias.fill_(log(self.exploration))
        return model


class ClippedAdam(torch.optim.Adam):
    """Adam on gradients whose norm over all weights is at most `_MAX_GRADIENT`."""

    def step(self, closure: Any = None) -> Any:
        """Clip, and step."""
        for group in self.param_groups:
            torch.nn.utils.clip_grad_norm_(group["params"], _MAX_GRADIENT)
        return super().step(closure)


class ResidualSAC(SAC):
    """SAC whose first actions come from the untrained actor, not from a uniform distribution."""

    def collect_rollouts(self, *arguments: Any, **options: Any) -> RolloutReturn:
        """Collect experiences as the library does where learning has started, whose actions are not uniform."""
        return super().collect_rollouts(*arguments, **{**options, "learning_starts": 0})
