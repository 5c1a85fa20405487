"""Draw the test scenarios and write them to `eval/comparison/scenarios.json`: `python eval/scenarios.py --write`.

Without `--write` the file is checked, and that the arms still move as they did when it was written.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines.tools.command import run_command
from eval.comparison.scenarios import require_same_physics, write
from eval.comparison.splits import SPLITS, load


@dataclass(frozen=True)
class Config:
    """Check the test scenarios, or draw them."""

    write: bool = False
    """Draw all splits from their seeds and write eval/comparison/scenarios.json."""


def run(config: Config) -> None:
    """Write the scenarios if asked to, and check them."""
    if config.write:
        write()
    splits = load()
    require_same_physics(splits)
    for name, split in splits.items():
        print(f"{name:<11} {len(split.moves)} scenarios  sha256 {split.digest[:12]}  {SPLITS[name].description}")


def main() -> None:
    """Command line."""
    run_command(__file__, Config, run, __doc__)


if __name__ == "__main__":
    main()
