"""Train a residual policy with PPO, proximal policy optimisation: `python train/ppo.py`.

Everything a run writes goes to one folder: `best/` (the policy bundle with the lowest validation cost), `last/`,
`checkpoint.pkl` (to go on with `--resume`), `config.json`, `validation.csv`, and the training log as CSV and for
TensorBoard. The checkpoint is a pickle, for this machine only; pass on `best/`, which is numbers and text.

J. Schulman et al.: Proximal Policy Optimization Algorithms, 2017.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from stable_baselines3 import PPO

from agents.actor import ACTIVATIONS
from agents.residual_env import ResidualVecEnv
from agents.runs import main
from agents.settings import RunConfig
from beltarm_env.cost import MAX_COST


@dataclass(frozen=True)
class Config(RunConfig):
    """Train a residual PPO policy."""

    algorithm: ClassVar[str] = "ppo"

    out: Path = Path("runs/ppo")
    """Folder of the run; of several seeds' runs, the folder of their folders seed0, seed1, ..."""
    total_steps: int = 6_000_000
    """Agent steps, each of `hold` samples; the learning rate falls to zero over them."""
    gamma: float = 0.98
    """Discount per agent step: 0.3 s."""
    hidden: tuple[int, ...] = (128, 128)
    """Hidden layers of policy and critic."""
    hold: int = 4
    """Samples for which a residual is held: 6 ms."""
    rollout_steps: int = 32
    """Agent steps per arm between two updates."""
    batch_size: int = 4096
    """Samples per gradient step."""
    epochs: int = 5
    """Passes over each rollout."""
    gae_lambda: float = 0.95
    """Bias against variance of the advantage estimate."""
    clip_range: float = 0.2
    """PPO's clipping range."""
    entropy: float = 1e-4
    """Weight of the entropy bonus: hardly any, exploration is to fade."""
    initial_log_std: float = -1.0
    """Logarithm of the initial exploration noise; the residual's range is -1 to 1."""

    @property
    def worst_reward(self) -> float:
        """The cost of three holds at its bound.

        An arm that leaves is charged for all samples at once, and would drown the advantages of all others.
        """
        return 3 * MAX_COST * self.reward_scale

    def check(self) -> None:
        """Check the options, see `RunConfig.check`."""
        super().check()
        self.at_least(1, "rollout_steps", "batch_size", "epochs")
        self.at_least(0, "entropy", "gae_lambda")
        self.positive("clip_range")
        if self.arms * self.rollout_steps < 2:
            raise ValueError("--arms times --rollout-steps must be at least 2")


def make_model(config: Config, env: ResidualVecEnv) -> PPO:
    """An untrained model, whose learning rate will fall linearly to zero."""
    return PPO(
        "MlpPolicy",
        env,
        learning_rate=lambda remaining: config.learning_rate * remaining,
        n_steps=config.rollout_steps,
        batch_size=config.batch_size,
        n_epochs=config.epochs,
        gamma=config.gamma,
        gae_lambda=config.gae_lambda,
        clip_range=config.clip_range,
        ent_coef=config.entropy,
        policy_kwargs={
            "net_arch": list(config.hidden),
            "activation_fn": ACTIVATIONS[config.activation],
            "log_std_init": config.initial_log_std,
        },
        seed=config.seed,
        device=config.device,
    )


if __name__ == "__main__":
    main(Config, make_model, __doc__)
