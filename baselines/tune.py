"""Tune the gains of classical controllers: `python baselines/tune.py NAME`, or `--all` of them.

Every controller gets the same optimiser, arms, objective and budget, see `baselines/tuning/search.py`; a full budget is
what a run of `train/ppo.py` simulates. Gains go to `baselines/gains.json`, with where they come from. Each search keeps
a journal, from which `--resume` goes on after an interruption. A new search begins with the untuned gains, never with
tuned ones: otherwise budgets would add up.
"""

from __future__ import annotations

import difflib
import shlex
import sys
from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import tyro
from rich.console import Console

from baselines import TUNABLE
from baselines.gains import FILE, read_file, write_entry
from baselines.tools.files import require_writable
from baselines.tools.parallel import BrokenOff, Failure, Interrupted, StopRequest, run_side_by_side, stop_on_signals
from baselines.tools.progress import progress_rows
from baselines.tools.provenance import command_line, commit
from baselines.tuning.search import CHOICE_SEED, SearchProgress, SearchResult, search, split_budget
from baselines.tuning.study import begin_anew
from beltarm_env import __version__


@dataclass(frozen=True)
class Config:
    """Tune the gains of classical controllers."""

    names: tyro.conf.Positional[tuple[str, ...]] = ()
    """Controllers to tune."""
    all: bool = False
    """Tune every controller that has gains to tune."""
    budget: int = 48_000_000
    """Simulated steps for each controller; an RL run of 4 000 000 agent steps, each of 12 samples, takes as many."""
    seed: int = 0
    """Seed of the optimiser; the arms are the same with every seed."""
    jobs: int = 2
    """Controllers tuned side by side, each in a process of its own."""
    out: Path = FILE
    """File of gains; entries of other controllers are kept."""
    journals: Path = Path("results/tune")
    """Folder of the journals."""
    resume: bool = False
    """Resume the searches that have a journal; those of the other controllers begin."""

    def chosen(self) -> list[str]:
        """Names of the controllers to tune.

        Raises:
            ValueError: If an option is out of range, a name unknown, or there is nothing to do.
        """
        split_budget(self.budget)
        for option in ("jobs", "seed"):
            if getattr(self, option) < (least := {"jobs": 1, "seed": 0}[option]):
                raise ValueError(f"--{option} must be at least {least}, got {getattr(self, option)}")
        if self.all == bool(self.names):
            raise ValueError(f"name controllers to tune or give --all, not both; there are {', '.join(TUNABLE)}")
        for name in self.names:
            if name not in TUNABLE:
                near = difflib.get_close_matches(name, TUNABLE, n=1)
                hint = f"did you mean {near[0]!r}?" if near else f"there are {', '.join(TUNABLE)}"
                raise ValueError(f"no controller {name!r} to tune; {hint}")
        names = list(dict.fromkeys(self.names)) or list(TUNABLE)
        if self.resume and not any(self.journal(name).exists() for name in names):
            raise ValueError(f"nothing to resume in {self.journals}: run once without --resume")
        return names

    def journal(self, name: str) -> Path:
        """Journal file of a controller's search."""
        return self.journals / f"{name}.journal"


def tune(config: Config, console: Console) -> None:
    """Tune the controllers chosen, and write the gains of each as soon as they are found.

    Raises:
        ValueError: If an option or file is bad, or, once the others are through, if searches failed.
        OSError: If files cannot be written.
        Interrupted: If a signal asked to stop; the journals are in order.
    """
    names = config.chosen()
    read_file(config.out)
    require_writable(config.out.parent)
    require_writable(config.journals)
    if not config.resume:
        for name in names:
            begin_anew(config.journal(name))
    stop, errors = StopRequest(), list[str]()
    searches = {
        name: partial(search, TUNABLE[name], config.budget, config.seed, config.journal(name)) for name in names
    }
    with (
        stop_on_signals(stop, lambda: console.print("stopping soon; once more to stop at once")),
        progress_rows(names, config.budget, console) as rows,
    ):

        def tell(name: str, state: SearchProgress) -> None:
            rows.show(name, state.steps, f"{state.trials} trials, best cost {state.best:.1f}")

        outcomes = run_side_by_side(searches, config.jobs, stop=stop, tell=tell)
        with closing(outcomes):
            for name, found in outcomes:
                if isinstance(found, SearchResult):
                    write_entry(name, TUNABLE[name].gains(**found.gains), provenance(config, found), config.out)
                    rows.show(name, config.budget, summary(found))
                elif not isinstance(found.error, Interrupted):
                    errors.append(f"{name}: {_explained(found)}")
    if errors:
        raise ValueError("\n".join(errors))
    if stop.made:
        raise Interrupted
    console.print(f"written to {config.out}: {', '.join(names)}")


def _explained(failure: Failure) -> str:
    """Message of a failed search, with a remedy if its process died."""
    return f"{failure.message}; to go on, use --resume" if isinstance(failure.error, BrokenOff) else failure.message


def provenance(config: Config, found: SearchResult) -> dict[str, object]:
    """Provenance of gains."""
    return {
        "command": command_line(),
        "seed": config.seed,
        "budget": config.budget,
        "steps": found.steps,
        "trials": found.trials,
        "pruned": found.pruned,
        "failed": found.failed,
        "cost": round(found.cost, 2),
        "cost_untuned": round(found.cost_untuned, 2),
        "measured_on": f"{found.arms} arms of the training ranges, seeds from {CHOICE_SEED}",
        "date": datetime.now(UTC).date().isoformat(),
        "version": __version__,
        "commit": commit(),
        "seconds": round(found.seconds, 1),
    }


def summary(found: SearchResult) -> str:
    """One-line summary of a search."""
    return f"{found.trials} trials, cost {found.cost:.1f}, untuned {found.cost_untuned:.1f}, {found.seconds:.0f} s"


def main() -> None:
    """Run the command."""
    config = tyro.cli(Config, description=__doc__)
    try:
        tune(config, Console())
    except (Interrupted, KeyboardInterrupt):
        arguments = [argument for argument in sys.argv[1:] if argument != "--resume"]
        command = shlex.join(["python", "baselines/tune.py", *arguments, "--resume"])
        print(f"interrupted; trials are kept in {config.journals}; to go on:\n  {command}")
        sys.exit(130)
    except (OSError, ValueError) as error:
        for line in str(error).splitlines():
            print(f"baselines/tune.py: {line}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
