"""Compare controllers on the same scenarios: `python eval/compare.py`.

Runs the classical controllers, the shipped policies, and a yardstick that knows its arm. Prints a table and a verdict,
and writes report.html, results.json, episodes.csv, summary.md and pictures. Results are kept in the folder and used
again.

With --scenario-seed there are as many scenarios as you ask for. Beyond 500 per split, it writes tails.md instead: what
happens once in a thousand moves, with tails.json and pictures.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # a process per core; read as numpy is imported, in all of them
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MKL_NUM_THREADS", "1")

import tyro
from rich.console import Console

from baselines.engines.options import SideBySide
from baselines.tools.command import require_bounds, run_command
from baselines.tools.options import Groups
from baselines.tools.progress import progress_count
from eval.comparison.custom import LONGEST, TIME_LIMIT, home
from eval.comparison.methods import chosen
from eval.comparison.run import choose_methods, compare
from eval.comparison.scenarios import choose_set
from eval.comparison.splits import DEFAULT_EPISODES, EPISODES, QUICK_EPISODES
from eval.report.publish import publish
from eval.tails.publish import publish as publish_tails
from eval.tails.study import check_options, study


@dataclass(frozen=True)
class Config(SideBySide):
    """Compare controllers on the belt-driven arm."""

    groups: ClassVar[Groups] = {
        "method": ("methods", "policy", "add", "time_limit", "guard"),
        "scenario": ("splits", "quick", "episodes", "scenarios", "scenario_seed"),
        "output": ("out", "verbose", "traceback", "maps"),
        "run": (),
    }

    methods: tuple[str, ...] = ()
    """Which of the project's own methods run, by name; what --add and --policy give always runs. Default: all shipped
    policies, the yardstick, and the classical controllers, without those that a simpler one beats everywhere
    (docs/science/controllers.md)."""
    splits: tuple[str, ...] = ()
    """Splits to run. Default: all."""
    policy: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """A policy of your own, beside the shipped ones: its folder, such as runs/ppo/best, or NAME=FOLDER. Repeat the
    option for more methods, or for more training seeds under the same name."""
    add: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """A controller of your own, as package.module:Class or path/to/file.py:Class. Repeat the option for more. Its
    results are kept until a file changes in its folder or below (for a package: in the whole package). If it depends on
    files elsewhere, use --fresh."""
    time_limit: float = TIME_LIMIT
    """Seconds that a controller from --add may take for a batch of episodes: up to 1000 scenarios of a split. It runs
    in a process of its own, and whatever ends that is a failure of this controller alone."""
    guard: bool = False
    """Also run each classical and learned method with the guard between it and the motor, as NAME+guard
    (docs/results/guard/page.md)."""
    out: Path = Path("results/compare")
    """Folder for report.html, results.json, episodes.csv, summary.md, the pictures, and the results that are kept. One
    that has results of more methods, splits or scenarios is left as it is."""
    episodes: int | None = None
    """Scenarios per split, 4 to 500, or with --scenario-seed up to 10000000: the first 500 are the same, and beyond
    them tails are compared. Default: 200."""
    quick: bool = False
    """Take a first look, with 24 scenarios per split."""
    scenarios: Literal["development", "test"] | None = None
    """Set of scenarios: "development", on which controllers and agents may be chosen, or "test". Default: the test
    set."""
    scenario_seed: int | None = None
    """Draw a fresh set of scenarios by the same rules instead. Seeds 0, 1, 2, ... are used by nothing else."""
    maps: bool = False
    """Also map the best learned method against each classical controller of --methods, for the report: over stiffness
    and payload, and over friction and delay. Takes about a minute with all controllers."""
    fresh: bool = False
    """Run everything again, and use no kept results."""
    computing_time: bool = False
    """Let computing time count: the commands of a method act later by its own time per action (99th percentile, one
    arm). Times are measured once and kept in computing_time.json. Needs its own --out."""
    traceback: bool = False
    """Print the whole traceback of each failure, to stderr."""
    verbose: bool = False
    """Also print all splits, with intervals and differences."""

    @property
    def count(self) -> int:
        """Scenarios per split."""
        return self.episodes or (QUICK_EPISODES if self.quick else DEFAULT_EPISODES)


def run(config: Config) -> None:
    """Run all methods on all splits and write everything; failures are named, and exit with 1."""
    console = Console()
    check_options(config)
    config.check_engine()
    require_bounds(config, time_limit=(1, LONGEST))
    known = choose_set(config.scenarios, config.scenario_seed)
    scenarios = known.only(chosen("split", config.splits, known.splits))
    methods = choose_methods(
        config.methods, config.policy, config.add, config.out, guard=config.guard, time_limit=config.time_limit
    )
    if config.scenario_seed is not None and config.count > EPISODES:
        names = list(scenarios.splits)
        with progress_count("shards of scenarios", console) as done:
            found = study(
                methods,
                names,
                config.scenario_seed,
                config.count,
                config.out,
                config.jobs,
                engine=config.runs_on,
                fresh=config.fresh,
                done=done,
            )
        publish_tails(found, config.out, console)
        failures = found.failures
    else:
        for method in methods:
            if method.identity is None:
                why = f"{home(method.sources[0])} is too large to be hashed, or cannot be read"
                console.print(f"Results of {method.name} will not be used again: {why}.", soft_wrap=True)
        with progress_count("pairs of method and split", console) as done:
            comparison = compare(
                methods,
                scenarios,
                config.count,
                config.out,
                config.jobs,
                engine=config.runs_on,
                fresh=config.fresh,
                computing_time=config.computing_time,
                done=done,
            )
        shown = publish(
            comparison,
            scenarios.splits,
            config.out,
            console,
            maps=config.maps,
            verbose=config.verbose,
            jobs=config.jobs,
        )
        failures = shown.failures
    for failure in failures:
        print(f"eval/compare.py: {failure.method} failed on {failure.split}: {failure.message}", file=sys.stderr)
        if config.traceback:
            print(failure.trace, file=sys.stderr)
    sys.exit(1 if failures else 0)


def main() -> None:
    """Command line."""
    run_command(__file__, Config, run, __doc__)


if __name__ == "__main__":
    main()
