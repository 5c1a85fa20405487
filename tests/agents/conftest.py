"""A short training run that tests share."""

from __future__ import annotations

from pathlib import Path

import pytest
from trainings import run, tiny


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a run of PPO with 8 arms and 128 agent steps, to be copied."""
    folder = tmp_path_factory.mktemp("finished") / "run"
    run(tiny("ppo", folder, total_steps=128))
    return folder
