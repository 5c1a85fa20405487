"""Train a residual policy with PPO, proximal policy optimisation: `python train/ppo.py`.

Everything a run writes goes to one folder: `best/` (the policy bundle with the lowest validation cost), `last/`,
`checkpoint.pkl` (to go on with `--resume`), `config.json`, `validation.csv`, and the training log as CSV and for
TensorBoard. The checkpoint is a pickle, for this machine only; pass on `best/`, which is numbers and text.

The defaults are what `python train/tune.py ppo --trials 24 --samples 12000000` found, see docs/training.md; the budget
is twice a trial's.

J. Schulman et al.: Proximal Policy Optimization Algorithms, 2017.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from stable_baselines3 import PPO

from agents.learners.on_policy import OnPolicyConfig
from agents.learners.reinforcement import ModelLearner
from agents.residual.env import ResidualVecEnv
from agents.runs.command_line import main
from beltarm_env.task.cost import MAX_COST


@dataclass(frozen=True)
class Config(OnPolicyConfig):
    """Train a residual PPO policy."""

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
        """The cost of three holds at its bound.

        An arm that leaves is charged for all samples at once, and would drown the advantages of all others.
        """
        return 3 * MAX_COST * self.reward_scale


def make_model(config: Config, env: ResidualVecEnv) -> PPO:
    """An untrained model, whose learning rate will fall linearly to zero."""
    return PPO("MlpPolicy", env, **config.arguments())


def make_learner(config: Config) -> ModelLearner:
    """An untrained learner."""
    return ModelLearner(config, make_model)


if __name__ == "__main__":
    main(Config, make_learner, __doc__)
