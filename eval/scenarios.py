"""Check the comparison's scenarios, and that arms still move as when they were drawn: `python eval/scenarios.py`.

With `--freeze-test`, the test set is drawn into `eval/comparison/scenarios.json`: once, after all controllers, agents
and the protocol are frozen. The hash of the last commit of `docs/benchmark/protocol.md` chooses the seeds.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines.tools.command import run_command
from eval.comparison import sets
from eval.comparison.splits import EDITION, SPLITS, VERSION


@dataclass(frozen=True)
class Config:
    """Check the comparison's scenarios, or draw the test set."""

    freeze_test: bool = False
    """Draw the test set, from the hash of the last commit of docs/benchmark/protocol.md, and write
    eval/comparison/scenarios.json. Refused if that file exists."""


def run(config: Config) -> None:
    """Draw what is asked for, and check and show all sets that there are."""
    if config.freeze_test:
        sets.freeze_test_set(sets.FILE)
    every = [sets.development_set()]
    if sets.FILE.exists():
        every.append(sets.load(sets.FILE))
        sets.require_same_physics(every[-1])
    for known in every:
        print(f"{known.label.title}, edition {EDITION}, version {VERSION}: sha256 {known.label.sha256}")
        for name, split in known.splits.items():
            print(f"{name:<11} {len(split.moves)} scenarios  sha256 {split.digest[:12]}  {SPLITS[name].description}")


def main() -> None:
    """Command line."""
    run_command(__file__, Config, run, __doc__)


if __name__ == "__main__":
    main()
