"""Training algorithms by name, and the ranges of their options that `train/tune.py` searches.

Ranges are chosen by hand. Hidden layers are written as on the command line, "128 128".
"""

from __future__ import annotations

from typing import Literal

from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution

from agents.learners.ppo import PpoConfig, RecurrentPpoConfig
from agents.learners.sac import SacConfig
from agents.learners.student import StudentConfig
from agents.runs.settings import RunConfig

_CONFIGS: tuple[type[RunConfig], ...] = (PpoConfig, RecurrentPpoConfig, SacConfig, StudentConfig)
ALGORITHMS = {config.algorithm: config for config in _CONFIGS}
"""Options of the algorithms of `train/`, which make their learners."""
Searched = Literal["ppo", "recurrent_ppo", "sac"]

_EVERYWHERE: dict[str, BaseDistribution] = {
    "learning_rate": FloatDistribution(1e-4, 3e-3, log=True),
    "reward_scale": FloatDistribution(0.01, 0.3, log=True),
}
_ON_POLICY: dict[str, BaseDistribution] = {
    **_EVERYWHERE,
    "rollout_steps": CategoricalDistribution([16, 32, 50, 64]),
    "epochs": CategoricalDistribution([3, 4, 5, 10]),
    "entropy": FloatDistribution(1e-5, 1e-2, log=True),
    "initial_log_std": FloatDistribution(-1.5, -0.5),
    "gae_lambda": FloatDistribution(0.9, 0.99),
}
_PPO: dict[str, BaseDistribution] = {
    **_ON_POLICY,
    "gamma": FloatDistribution(0.95, 0.99),
    "hold": CategoricalDistribution([4, 8]),
    "batch_size": CategoricalDistribution([1024, 2048, 4096, 8192]),
    "hidden": CategoricalDistribution(["64 64", "128 128", "256 256"]),
}
_RECURRENT: dict[str, BaseDistribution] = {
    **_ON_POLICY,
    "gamma": FloatDistribution(0.9, 0.99),
    "hold": CategoricalDistribution([4, 8, 12]),
    "lstm_width": CategoricalDistribution([32, 64, 128]),
}
_SAC: dict[str, BaseDistribution] = {
    **_EVERYWHERE,
    "gamma": FloatDistribution(0.85, 0.98),
    "residual_limit": FloatDistribution(0.3, 1.0, log=True),
    "hold": CategoricalDistribution([4, 8, 12, 16]),
    "gradient_steps": CategoricalDistribution([2, 4, 8]),
    "tau": FloatDistribution(0.002, 0.05, log=True),
    "exploration": FloatDistribution(0.1, 0.6),
    "target_entropy": FloatDistribution(-4.0, -1.0),
}
SPACES: dict[Searched, dict[str, BaseDistribution]] = {"ppo": _PPO, "recurrent_ppo": _RECURRENT, "sac": _SAC}
"""Ranges of the options that are searched, by algorithm; everything else is as the script has it."""
