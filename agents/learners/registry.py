"""Training algorithms by name."""

from __future__ import annotations

from agents.learners.ppo import PpoConfig, RecurrentPpoConfig
from agents.learners.sac import SacConfig
from agents.learners.student import StudentConfig
from agents.runs.settings import RunConfig

_CONFIGS: tuple[type[RunConfig], ...] = (PpoConfig, RecurrentPpoConfig, SacConfig, StudentConfig)
ALGORITHMS = {config.algorithm: config for config in _CONFIGS}
"""Options of the algorithms of `train/`, which make their learners."""
