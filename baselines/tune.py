"""Tune the gains of classical controllers: `python baselines/tune.py NAME`, or `--all` of them.

Every controller gets the same optimiser, arms, objective and budget (see `baselines/tuning/search.py`). A full budget
is 48 million samples, twice what a run of `train/ppo.py` simulates. Gains go to `baselines/gains.json`, with their
origin. Each search keeps a journal, from which `--resume` continues, with the options that it had unless others are
told. A new search begins with untuned gains, never with tuned ones: otherwise budgets would add up.

Gains are refused before anything is simulated if their loop lacks modulus and delay margins, on the design model or at
a corner of the training ranges. `--no-margins` accepts them, for another file with `--out`: the difference in cost is
the price of the margins.
"""

from __future__ import annotations

import shlex
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import tyro
from rich.console import Console

from baselines import TUNABLE
from baselines.engines.options import WithStorage
from baselines.engines.parallel import Interrupted
from baselines.gains import FILE
from baselines.loops.condition import MarginCondition
from baselines.tools.command import require_bounds, require_known, run_command, this_python
from baselines.tools.options import Groups
from baselines.tuning.race import split_budget
from baselines.tuning.run import begun_options, tune


@dataclass(frozen=True)
class Config(WithStorage):
    """Tune the gains of classical controllers."""

    groups: ClassVar[Groups] = {
        "basic": ("names", "all", "resume", "out"),
        "search": (),
        "run": ("jobs", "engine", "address", "storage"),
    }

    names: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[NAME ...]")] = ()
    """Controllers to tune."""
    all: bool = False
    """Tune every controller that has gains to tune."""
    budget: int = 48_000_000
    """Simulated samples for each controller. A run of `train/ppo.py` takes half as many; the gains in
    baselines/gains.json were found with 8 million."""
    seed: int = 0
    """Seed of the optimiser. The arms are the same for every seed."""
    out: Path = FILE
    """File of gains. Entries of other controllers are kept."""
    journals: Path = Path("results/tune")
    """Folder of the journals."""
    margins: bool = True
    """Also accept gains whose loop lacks the margins of `baselines/loops/condition.py`, to see what the margins
    cost."""
    resume: bool = False
    """Continue the searches that have a journal, and start the others."""

    def chosen(self) -> list[str]:
        """Names of the controllers to tune.

        Raises:
            ValueError: If an option is out of range, a name unknown, or there is nothing to do.
        """
        split_budget(self.budget)
        require_bounds(self, seed=(0, None))
        self.check_engine()
        if self.all == bool(self.names):
            raise ValueError(f"name controllers to tune or give --all, not both; there are {', '.join(TUNABLE)}")
        require_known(self.names, TUNABLE, "no controller {} to tune")
        names = list(dict.fromkeys(self.names)) or list(TUNABLE)
        return names

    def begun(self) -> dict[str, Any]:
        """Options with which the searches to be resumed were begun, but for their names and their folder."""
        if not self.resume:
            return {}
        return begun_options(self.chosen(), self.journals, "names", "all", "journals", "resume")


def run(config: Config) -> None:
    """Tune; an interruption says how to go on."""
    try:
        tune(
            config.chosen(),
            budget=config.budget,
            seed=config.seed,
            options=config,
            out=config.out,
            journals=config.journals,
            resume=config.resume,
            condition=MarginCondition() if config.margins else None,
            console=Console(),
        )
    except (Interrupted, KeyboardInterrupt):
        arguments = [argument for argument in sys.argv[1:] if argument != "--resume"]
        command = f"{this_python()} {shlex.join(['baselines/tune.py', *arguments, '--resume'])}"
        print(f"interrupted; trials are kept in {config.journals}; to continue:\n  {command}")
        sys.exit(130)


def main() -> None:
    """Command line."""
    run_command(__file__, Config, run, __doc__, Config.begun)


if __name__ == "__main__":
    main()
