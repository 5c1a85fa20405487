"""PPO, proximal policy optimisation, as learner: its options, defaults and model.

The defaults are what `python train/tune.py ppo --trials 24 --samples 12000000` found, see docs/science/training.md; the
budget is twice a trial's.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from stable_baselines3 import PPO

from agents.learners.on_policy import OnPolicyConfig
from agents.learners.reinforcement import ModelLearner
from agents.residual.env import ResidualVecEnv
from beltarm_env.task.cost import MAX_COST


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


def make_model(config: PpoConfig, env: ResidualVecEnv) -> PPO:
    """Make an untrained model, whose learning rate will fall linearly to zero."""
    with warnings.catch_warnings():  # of a last batch that is smaller, as --batch-size says that it may be
        warnings.filterwarnings("ignore", "You have specified a mini-batch size", UserWarning)
        return PPO("MlpPolicy", env, **config.arguments())


def make_learner(config: PpoConfig) -> ModelLearner:
    """Make an untrained learner."""
    return ModelLearner(config, make_model)
