"""Tiny training runs: their options, a stop at a chosen moment, and the weights that they leave."""

import os
import tempfile
from pathlib import Path
from typing import Any

from agents.learners.registry import ALGORITHMS
from agents.policy.bundle import read_bundle
from agents.runs.settings import RunConfig
from agents.runs.training import TrainingMonitor, train
from baselines.engines.parallel import Channel, StopRequest

NAMES = tuple(name for name in ALGORITHMS if name != "student")  # which has tests of its own
ON_POLICY = {"rollout_steps": 8, "batch_size": 32}
OFF_POLICY = {"batch_size": 64, "buffer_size": 200, "learning_starts": 32, "gradient_steps": 1}
REINFORCEMENT = {
    **{"arms": 8, "total_steps": 256, "validation_every": 128},
    **{"hold": 40, "hidden": (8,), "validation_arms": 4},
}
IMITATION = {
    **{"arms": 4, "rounds": 2, "remembered": 2, "epochs": 2, "batch_size": 2, "gru_width": 6},
    **{"hold": 40, "hidden": (8,), "validation_arms": 2, "base": "paper", "knowledge": "none", "moves": 1},
}
OWN: dict[str, dict[str, Any]] = {
    "ppo": {**REINFORCEMENT, **ON_POLICY, "base": "paper", "critic_steps": 0, "moves": 1},
    "recurrent_ppo": {**REINFORCEMENT, **ON_POLICY, "lstm_width": 8, "knowledge": "none"},
    "sac": {**REINFORCEMENT, **OFF_POLICY, "knowledge": "none"},
    "student": IMITATION,
}
SHORT = "--base paper --arms 8 --rollout-steps 8 --batch-size 32 --hold 40 --hidden 8 --validation-arms 4".split()
TINY = (*SHORT, "--total-steps", "256", "--validation-every", "128")


def tiny(name: str, out: Path, **options: Any) -> Any:
    """A few arms and updates, and two validations; the replay buffer comes round. For PPO they are TINY."""
    return ALGORITHMS[name](**{"out": out, **OWN[name], **options})


def run(config: RunConfig, stop: StopRequest | None = None, report: Any = None) -> TrainingMonitor:
    return train(config, Channel(report or (lambda _: None), stop or StopRequest()))


class StopAfter(StopRequest):
    """Made once it has been looked at so often."""

    def __init__(self, looks: int) -> None:
        self.looks = looks

    @property
    def made(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        self.looks -= 1
        return self.looks < 0


def weights(folder: Path) -> dict[str, bytes]:
    return {name: array.tobytes() for name, array in read_bundle(folder).weights.arrays.items()}


def same_policies(first: Path, second: Path) -> bool:
    return all(weights(first / kind) == weights(second / kind) for kind in ("best", "last"))


def in_memory() -> tempfile.TemporaryDirectory[str]:
    """Make an empty folder, in memory where there is a place: what is often written waits for no disk."""
    return tempfile.TemporaryDirectory(dir="/dev/shm" if os.access("/dev/shm", os.W_OK) else None)
