"""Test scenarios: arms and moves that nothing was trained, tuned or selected on.

A scenario is one arm with one move, drawn by the environment itself from `seed + i`. Training uses seeds below
7 000 000 and validation those from there on (see `agents.training`); the splits lie above.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

VERSION = 1
"""Changes whenever the physics or a split changes: results of different versions must not be compared."""


@dataclass(frozen=True, slots=True)
class Split:
    """A set of scenarios."""

    seed: int
    description: str
    settings: dict[str, Any] = field(default_factory=dict)  # of the environment


SPLITS = {
    "nominal": Split(8_000_000, "the nominal arm, random moves", {"randomization": "off"}),
    "randomized": Split(8_100_000, "arms from the training ranges, random moves", {"randomization": "train"}),
}
EPISODES = 200
QUICK_EPISODES = 24
MAX_EPISODES = 100_000
"""Per split; the seeds of the splits are that far apart."""
