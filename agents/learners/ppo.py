"""PPO, proximal policy optimisation, as learner: its options, defaults and model.

The defaults are what `python train/tune.py ppo --trials 24 --samples 12000000` found, see docs/training.md; the budget
is twice a trial's.
"""

from __future__ import annotations

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
    """Folder of the run; of several seeds' runs, the folder of their folders seed0, seed1, ..."""
    total_steps: int = 6_000_000
    """Agent steps, each of `hold` samples; the learning rate falls to zero over them."""
    learning_rate: float = 3.5e-4
    """Learning rate of the optimiser at first."""
    gamma: float = 0.988
    """Discount per agent step: 0.5 s."""
    reward_scale: float = 0.036
    """Factor on the mean reward over a hold, so that values are of order 1."""
    hidden: tuple[int, ...] = (256, 256)
    """Hidden layers of policy and critic."""
    hold: int = 4
    """Samples for which a residual is held: 6 ms."""
    gae_lambda: float = 0.962
    """Bias against variance of the advantage estimate."""
    initial_log_std: float = -0.66
    """Logarithm of the initial exploration noise; the residual's range is -1 to 1."""

    @property
    def worst_reward(self) -> float:
        """Reward floor: the cost of three holds at its bound.

        An arm that leaves is charged for all samples at once, and would drown the advantages of all others.
        """
        return 3 * MAX_COST * self.reward_scale


def make_model(config: PpoConfig, env: ResidualVecEnv) -> PPO:
    """Make an untrained model, whose learning rate will fall linearly to zero."""
    return PPO("MlpPolicy", env, **config.arguments())


def make_learner(config: PpoConfig) -> ModelLearner:
    """Make an untrained learner."""
    return ModelLearner(config, make_model)
