"""A short training run that tests share."""

from __future__ import annotations

from pathlib import Path

import pytest

from agents.learners.ppo import PpoConfig, make_learner
from agents.runs.training import train
from baselines.engines.parallel import Channel


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a run of PPO with 8 arms and 128 agent steps, to be copied."""
    folder = tmp_path_factory.mktemp("finished") / "run"
    config = PpoConfig(
        **{"out": folder, "arms": 8, "total_steps": 128, "validation_every": 256, "validation_arms": 4},
        **{"hold": 40, "hidden": (8,), "rollout_steps": 8, "batch_size": 32},
    )
    train(config, make_learner, Channel())
    return folder
