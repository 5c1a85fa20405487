"""Options shared by the on-policy algorithms: PPO and recurrent PPO."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from agents.learners.reinforcement import ReinforcementConfig
from agents.policy.actor import MODULES


@dataclass(frozen=True)
class OnPolicyConfig(ReinforcementConfig):
    """Options of on-policy algorithms."""

    rollout_steps: int = 64
    """Agent steps per arm between two updates."""
    batch_size: int = 2048
    """Agent steps in each gradient step. The last one of a rollout takes what is left, and is not warned of."""
    epochs: int = 3
    """Passes over each rollout."""
    gae_lambda: float = 0.95
    """Lambda of the advantage estimate. A lower value has less variance and more bias."""
    clip_range: float = 0.2
    """Clipping range of PPO."""
    entropy: float = 0.008
    """Weight of the entropy bonus, which keeps exploration from dying early."""
    initial_log_std: float = -1.0
    """Logarithm of the exploration noise at the start. Residuals lie between -1 and 1."""

    def check(self) -> None:
        """Check the options, see `RunConfig.check`."""
        super().check()
        self.at_least(1, "rollout_steps", "batch_size", "epochs")
        self.at_least(0, "entropy", "gae_lambda")
        self.positive("clip_range")
        if self.arms * self.rollout_steps < 2:
            raise ValueError("--arms times --rollout-steps must be at least 2")

    def arguments(self, **policy: Any) -> dict[str, Any]:
        """Arguments of the Stable-Baselines3 model; the learning rate falls linearly to zero.

        Args:
            **policy: Further arguments of the policy.
        """
        return {
            "learning_rate": self.learning_rate_left,
            "n_steps": self.rollout_steps,
            "batch_size": self.batch_size,
            "n_epochs": self.epochs,
            "gamma": self.gamma,
            "gae_lambda": self.gae_lambda,
            "clip_range": self.clip_range,
            "ent_coef": self.entropy,
            "policy_kwargs": {
                "net_arch": list(self.hidden),
                "activation_fn": MODULES[self.activation],
                "log_std_init": self.initial_log_std,
                **policy,
            },
            "seed": self.seed,
            "device": self.device,
        }
