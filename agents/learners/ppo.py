"""PPO, proximal policy optimisation, with and without an LSTM: options, defaults and models.

The defaults of PPO are what `python train/tune.py ppo --trials 24 --samples 12000000` found, see
docs/science/training.md; the budget is twice a trial's.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from sb3_contrib import RecurrentPPO
from stable_baselines3 import PPO

from agents.learners.reinforcement import ReinforcementConfig
from agents.policy.actor import MODULES
from agents.residual.env import ResidualVecEnv
from agents.residual.knowledge import Knowledge
from baselines.tools.command import require_bounds
from beltarm_env.task.cost import MAX_COST


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
        require_bounds(self, rollout_steps=(1, None), batch_size=(1, None), epochs=(1, None))
        require_bounds(self, entropy=(0, None), gae_lambda=(0, None))
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


@dataclass(frozen=True)
class PpoConfig(OnPolicyConfig):
    """Options of `train/ppo.py`."""

    algorithm: ClassVar[str] = "ppo"

    out: Path = Path("runs/ppo")
    """Folder of the run. With --seeds, each run has its own folder there: seed0, seed1, ..."""
    total_steps: int = 6_000_000
    """Agent steps of the whole run, each of --hold samples. The learning rate falls to zero over the run."""
    learning_rate: float = 3.5e-4
    """Learning rate at the start."""
    gamma: float = 0.988
    """Discount per agent step. 0.988 looks about 0.5 s ahead."""
    reward_scale: float = 0.036
    """Factor on the mean reward of a hold. It brings values to order 1."""
    hidden: tuple[int, ...] = (256, 256)
    """Widths of the hidden layers of policy and critic."""
    hold: int = 4
    """Samples for which a residual is held. 4 samples are 6 ms."""
    gae_lambda: float = 0.962
    """Lambda of the advantage estimate. A lower value has less variance and more bias."""
    initial_log_std: float = -0.66
    """Logarithm of the exploration noise at the start. Residuals lie between -1 and 1."""

    @property
    def worst_reward(self) -> float:
        """Reward floor: the cost of three holds at its bound.

        An arm that leaves is charged for all samples at once, and would drown the advantages of all others.
        """
        return 3 * MAX_COST * self.reward_scale

    def make_model(self, env: ResidualVecEnv) -> PPO:
        """Make an untrained model, whose learning rate will fall linearly to zero."""
        with warnings.catch_warnings():  # of a last batch that is smaller, as --batch-size says that it may be
            warnings.filterwarnings("ignore", "You have specified a mini-batch size", UserWarning)
            return PPO("MlpPolicy", env, **self.arguments())


@dataclass(frozen=True)
class RecurrentPpoConfig(OnPolicyConfig):
    """Options of `train/recurrent_ppo.py`."""

    algorithm: ClassVar[str] = "recurrent_ppo"

    out: Path = Path("runs/recurrent_ppo")
    """Folder of the run. With --seeds, each run has its own folder there: seed0, seed1, ..."""
    knowledge: Knowledge = "none"
    """What the agent sees besides the observation: nothing ("none"), because the LSTM is to identify the arm, or what
    the identification believes of the arm ("belief")."""
    hidden: tuple[int, ...] = (64,)
    """Widths of the hidden layers after the LSTM."""
    lstm_width: int = 64
    """Width of the LSTMs of policy and value."""
    rollout_steps: int = 50
    """Agent steps per arm between two updates. Gradients go back through all of them; 50 are half an episode."""
    batch_size: int = 5120
    """Agent steps in each gradient step."""
    epochs: int = 4
    """Passes over each rollout."""
    entropy: float = 0.001
    """Weight of the entropy bonus, which keeps exploration from dying early."""

    @property
    def layers(self) -> dict[str, Any]:
        """The actor's LSTM."""
        return {"lstm": self.lstm_width}

    def check(self) -> None:
        """Check the options, see `RunConfig.check`."""
        require_bounds(self, lstm_width=(1, None))
        super().check()

    def make_model(self, env: ResidualVecEnv) -> RecurrentPPO:
        """Make an untrained model, whose learning rate will fall linearly to zero."""
        return RecurrentPPO("MlpLstmPolicy", env, **self.arguments(lstm_hidden_size=self.lstm_width))
