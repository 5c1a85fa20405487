"""Check the comparison's scenarios, and that arms still move as when they were drawn: `python eval/scenarios.py`.

With `--write`, seeds, hashes and a few motions of the development set are written to
`eval/comparison/development.json`. With `--freeze-test`, the test set is drawn into `eval/comparison/scenarios.json`:
once, after all controllers, agents and the protocol are frozen. The hash of the last commit of
`docs/benchmark/protocol.md` chooses the seeds.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines.tools.command import run_command
from eval.comparison import scenarios
from eval.comparison.sets import development_set
from eval.comparison.splits import SPLITS


@dataclass(frozen=True)
class Config:
    """Check the comparison's scenarios, or write what is kept of them."""

    write: bool = False
    """Write eval/comparison/development.json again, after a change of the physics or of the splits."""
    freeze_test: bool = False
    """Draw the test set, from the hash of the last commit of docs/benchmark/protocol.md, and write
    eval/comparison/scenarios.json. Refused if that file exists."""


def run(config: Config) -> None:
    """Write what is asked for, and check and show all sets that there are."""
    if config.write:
        scenarios.write_record(scenarios.RECORD)
    if config.freeze_test:
        scenarios.freeze_test_set(scenarios.FILE)
    sets = [development_set()]
    if scenarios.FILE.exists():
        sets.append(scenarios.load(scenarios.FILE))
    for known in sets:
        scenarios.require_same_physics(known)
        label = known.label
        print(f"{label.title}, edition {scenarios.EDITION}, version {scenarios.VERSION}: sha256 {label.sha256}")
        for name, split in known.splits.items():
            print(f"{name:<11} {len(split.moves)} scenarios  sha256 {split.digest[:12]}  {SPLITS[name].description}")


def main() -> None:
    """Command line."""
    run_command(__file__, Config, run, __doc__)


if __name__ == "__main__":
    main()
