"""Compare controllers on the same scenarios: `python eval/compare.py`.

Runs the classical controllers, the shipped policies, and an oracle that knows its arm. Prints a table and a verdict,
and writes report.html, results.json, episodes.csv, page.md and pictures. Results are kept in the folder and used again.

With --quick it takes about a minute; with --scenario-seed there are as many scenarios as you ask for.
"""

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

from baselines.engines.parallel import SideBySide
from baselines.tools.command import require_bounds, run_command
from baselines.tools.files import write_text
from baselines.tools.options import Groups
from baselines.tools.progress import progress_count
from eval.comparison.custom import LONGEST, TIME_LIMIT, home
from eval.comparison.methods import chosen
from eval.comparison.run import OwnMethods, Run, choose_methods, compare, verify
from eval.comparison.sets import choose_set
from eval.comparison.splits import EPISODES, MOVES, QUICK_EPISODES, QUICK_MOVES, QUICK_SEEDS
from eval.report import summary
from eval.report.publish import print_results, publish
from eval.report.verdict import verdict
from eval.studies._frame import PAGE, text_of

MOST = 100_000
"""Scenarios of a split that fit into the memory of a usual machine, with all methods."""


@dataclass(frozen=True)
class Config(SideBySide):
    """Compare controllers on the belt-driven arm."""

    groups: ClassVar[Groups] = {
        "method": ("methods", "policy", "add", "time_limit", "guard"),
        "scenario": ("splits", "quick", "episodes", "scenarios", "scenario_seed"),
        "output": ("out", "verify", "traceback"),
        "run": (),
    }

    methods: tuple[str, ...] = ()
    """The project's own methods that run, by name; those of --add and --policy always run. Default: all shipped
    policies, the oracle, and the classical controllers, without those that one no more complex beat on single
    moves (docs/science/controllers.md)."""
    splits: tuple[str, ...] = ()
    """Splits to run. Default: all."""
    policy: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """A policy of your own, beside the shipped ones: its folder, such as runs/ppo/best, or NAME=FOLDER. Repeat the
    option for more methods, or for more training seeds under the same name."""
    add: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """A controller of your own, as package.module:Class or path/to/file.py:Class. Repeat the option for more. Its
    results are kept until a file changes in its folder or below (for a package: in the whole package), but for caches
    and results; none may change while it runs. If it depends on files elsewhere, use --fresh."""
    time_limit: float = TIME_LIMIT
    """Seconds that a controller from --add may take for a batch of episodes: up to 200 scenarios of a split. It runs
    in a process of its own, and whatever ends that is a failure of this controller alone."""
    guard: bool = False
    """Also run each classical and learned method with the guard between it and the motor, as NAME+guard
    (docs/results/guard/page.md)."""
    out: Path = Path("results/compare")
    """Folder for report.html, results.json, episodes.csv, page.md, pictures, and the parts that are kept. One that has
    results of more methods, splits or scenarios is left as it is."""
    episodes: int | None = None
    """Scenarios per split, 4 to 200, or with --scenario-seed up to 100000, of which the first 200 are always the same.
    Default: 200."""
    quick: bool = False
    """Take a first look: 20 scenarios per split, unless --episodes says otherwise, of a shift its first 2 moves, and of
    each learned method the first 2 of its shipped policies."""
    scenarios: Literal["development", "test"] | None = None
    """Set of scenarios: "development", on which controllers and agents may be chosen, or "test". Default: the test
    set."""
    scenario_seed: int | None = None
    """Draw a fresh set of scenarios by the same rules instead. Seeds 0, 1, 2, ... are used by nothing else."""
    fresh: bool = False
    """Run everything again, and use no kept results."""
    verify: Path | None = None
    """Run again what the results.json of this folder claims, and write nothing. The first number that differs by more
    than another processor explains is printed, and exits with 1. Give a controller or a policy with --add or --policy
    if it is not where the results' command names it."""
    traceback: bool = False
    """Print the whole traceback of each failure, to stderr."""


def run(config: Config) -> None:
    """Run all methods on all splits and write everything; failures are named, and exit with 1."""
    console = Console()
    config.check_engine()
    require_bounds(config, time_limit=(1, LONGEST))
    if config.verify is not None:
        names = ("methods", "splits", "quick", "episodes", "scenarios", "scenario_seed", "guard", "fresh", "out")
        if vain := [name.replace("_", "-") for name in names if getattr(config, name) != getattr(Config, name)]:
            raise ValueError(f"--{vain[0]} has no effect beside --verify, which runs what results claim: leave it out")
        with progress_count("parts", console) as done:
            own = OwnMethods(config.policy, config.add, config.verify, config.time_limit)
            news, sound = verify(config.verify, config, verdict, own, done)
        console.print(news, soft_wrap=True, markup=False, highlight=False)
        sys.exit(0 if sound else 1)
    usual, moves, seeds = (QUICK_EPISODES, QUICK_MOVES, QUICK_SEEDS) if config.quick else (EPISODES, MOVES, None)
    count = usual if config.episodes is None else config.episodes
    known = choose_set(config.scenarios, config.scenario_seed)
    splits = chosen("split", config.splits, known.splits)
    most = EPISODES if config.scenario_seed is None else MOST
    if not 4 <= count <= most:
        more = f"; --scenario-seed 1 draws up to {MOST}" if config.scenario_seed is None else ""
        raise ValueError(f"--episodes must lie within 4 and {most}, got {count}{more}")
    scenarios = known.only(splits, count, moves)
    own = OwnMethods(config.policy, config.add, config.out, config.time_limit)
    methods = choose_methods(config.methods, own, guard=config.guard, seeds=seeds)
    for method in methods:
        if method.identity is None:
            why = f"{home(method.sources[0])} is too large to be hashed, or cannot be read"
            console.print(f"Results of {method.name} will not be used again: {why}.", soft_wrap=True)
    size = f"Methods: {len(methods)}; splits: {', '.join(scenarios.splits)}; {count} scenarios of each."
    console.print(f"{size} What is done is kept in {config.out}.", soft_wrap=True, highlight=False)
    with progress_count("parts", console) as done:
        comparison = compare(methods, scenarios, count, Run(config.out, config, config.fresh, done))
    content, failures = publish(comparison, scenarios.splits, config.out, config.jobs)
    write_text(config.out / PAGE, text_of("comparison", summary, content))
    print_results(content, console)
    console.print(f"Written to {config.out}: report.html, {PAGE}, results.json, episodes.csv, pictures", soft_wrap=True)
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
