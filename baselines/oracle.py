"""Compute the least attainable cost: `python baselines/oracle.py` plans with the true arm and stores the torques.

What is planned, replayed and stored is explained in `baselines.yardsticks.oracle`.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines.tools.command import run_command
from baselines.yardsticks.oracle import FILE, Scenario, write_file
from beltarm_env.task.seeds import GAIN_SEARCH

_SCENARIOS = {"nominal": 2, "ideal": 3, "train": 5}


@dataclass(frozen=True)
class Config:
    """Plan with the true arm, replay in the environment, store."""

    scenario: tuple[str, ...] = tuple(
        f"{kind}:{GAIN_SEARCH.first + k}" for kind, count in _SCENARIOS.items() for k in range(count)
    )
    """Scenarios as KIND:SEED. KIND is nominal, ideal (arms of the training ranges, ideal drive) or train (with the
    drive as it is built)."""
    out: Path = FILE
    """File to write."""


def plan(config: Config) -> None:
    """Plan every scenario and write the file."""
    write_file([Scenario.parse(text) for text in config.scenario], config.out)


def main() -> None:
    """Command line."""
    run_command(__file__, Config, plan, __doc__)


if __name__ == "__main__":
    main()
