"""Train a residual policy with TQC, truncated quantile critics: `python train/tqc.py`.

What a run writes is as in `train/ppo.py`; how it differs from the textbook's is said in
`agents/learners/off_policy.py`.

A. Kuznetsov et al.: Controlling Overestimation Bias with Truncated Mixture of Continuous Distributional Quantile
Critics, 2020.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from sb3_contrib import TQC

from agents.learners.off_policy import ExploringFromTheBase, SoftConfig, begin_near_zero
from agents.learners.reinforcement import ModelLearner
from agents.residual.env import ResidualVecEnv
from agents.runs.command_line import main


@dataclass(frozen=True)
class Config(SoftConfig):
    """Train a residual TQC policy."""

    algorithm: ClassVar[str] = "tqc"

    out: Path = Path("runs/tqc")
    """Folder of the run; of several seeds' runs, the folder of their folders seed0, seed1, ..."""
    quantiles: int = 25
    """Quantiles of each critic."""
    dropped_quantiles: int = 2
    """Quantiles of each critic left out of the target, the highest."""

    def check(self) -> None:
        """Check the options, see `RunConfig.check`."""
        super().check()
        if not 0 <= self.dropped_quantiles < self.quantiles:
            raise ValueError(
                f"--dropped-quantiles must lie within 0 and --quantiles less 1, got {self.dropped_quantiles}"
            )


class ResidualTQC(ExploringFromTheBase, TQC):
    """TQC that begins with its base."""


def make_model(config: Config, env: ResidualVecEnv) -> TQC:
    """An untrained model whose mean residual is near zero."""
    arguments = config.arguments()
    arguments["policy_kwargs"]["n_quantiles"] = config.quantiles
    model = ResidualTQC(
        "MlpPolicy",
        env,
        top_quantiles_to_drop_per_net=config.dropped_quantiles,
        **arguments,
    )
    begin_near_zero(model, config.exploration)
    return model


def make_learner(config: Config) -> ModelLearner:
    """An untrained learner."""
    return ModelLearner(config, make_model)


if __name__ == "__main__":
    main(Config, make_learner, __doc__)
