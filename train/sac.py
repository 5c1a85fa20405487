"""Train a residual policy with SAC, soft actor-critic: `python train/sac.py`.

What a run writes is as in `train/ppo.py`; how it differs from the textbook's is said in
`agents/learners/off_policy.py`.

T. Haarnoja et al.: Soft Actor-Critic Algorithms and Applications, 2018.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from stable_baselines3 import SAC

from agents.learners.off_policy import ExploringFromTheBase, SoftConfig, begin_near_zero
from agents.learners.reinforcement import ModelLearner
from agents.residual.env import ResidualVecEnv
from agents.runs.command_line import main


@dataclass(frozen=True)
class Config(SoftConfig):
    """Train a residual SAC policy."""

    algorithm: ClassVar[str] = "sac"

    out: Path = Path("runs/sac")
    """Folder of the run; of several seeds' runs, the folder of their folders seed0, seed1, ..."""


class ResidualSAC(ExploringFromTheBase, SAC):
    """SAC that begins with its base."""


def make_model(config: Config, env: ResidualVecEnv) -> SAC:
    """An untrained model whose mean residual is near zero."""
    model = ResidualSAC("MlpPolicy", env, **config.arguments())
    begin_near_zero(model, config.exploration)
    return model


def make_learner(config: Config) -> ModelLearner:
    """An untrained learner."""
    return ModelLearner(config, make_model)


if __name__ == "__main__":
    main(Config, make_learner, __doc__)
