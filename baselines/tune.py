"""Tune the gains of classical controllers: `python baselines/tune.py NAME`, or `--all` of them.

Every controller gets the same optimiser, arms, objective and budget (see `baselines/tuning/search.py`). A full budget
is 48 million samples, twice what PPO on `paper` simulates. Gains go to `baselines/gains.json`, with their
origin. Each search keeps a journal, from which `--resume` continues, with the options that it had unless others are
told. A new search begins with untuned gains, never with tuned ones: otherwise budgets would add up.

Gains are refused before anything is simulated if their loop lacks modulus and delay margins, on the design model or at
a corner of the training ranges. `--no-margins` accepts them, for another file with `--out`.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines.tools.command import resume_command, run_command, stop_without

try:
    from rich.console import Console

    from baselines.engines.parallel import Interrupted
    from baselines.tuning.run import TuningConfig, tune
except ModuleNotFoundError as error:
    stop_without("baselines/tune.py", error)


def run(config: TuningConfig) -> None:
    """Tune; an interruption says how to go on."""
    try:
        tune(config, Console())
    except (Interrupted, KeyboardInterrupt):
        again = resume_command("baselines/tune.py")
        print(f"interrupted; trials are kept in {config.journals}; to continue:\n  {again}")
        sys.exit(130)


def main() -> None:
    """Command line."""
    run_command(__file__, TuningConfig, run, __doc__, TuningConfig.begun)


if __name__ == "__main__":
    main()
