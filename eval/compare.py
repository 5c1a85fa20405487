"""Compare controllers on the same scenarios: `python eval/compare.py`.

Runs all classical controllers, the shipped policies and a yardstick that knows its arm on every split, prints a table,
and writes report.html, results.json, episodes.csv, summary.md and pictures. What is done is kept in the folder, and not
done again.
"""

from __future__ import annotations

import hashlib
import os
import sys
import time
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # a process per core; read as numpy is imported, in all of them
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MKL_NUM_THREADS", "1")

import torch
import tyro
from rich.console import Console
from rich.progress import Progress

from baselines.tools.command import one_line_errors
from baselines.tools.files import require_writable, write_text
from baselines.tools.provenance import command_line
from beltarm_env import ArmParams
from eval.check_controller import first_failure
from eval.comparison.custom import home
from eval.comparison.methods import (
    PRIVILEGED,
    Method,
    added_method,
    chosen,
    classical_methods,
    learned_methods,
    privileged_method,
    shipped_policies,
)
from eval.comparison.pairs import Failure, Metrics, Pair, attempt, default_jobs, run_pairs
from eval.comparison.results import Comparison, Outcome, make_comparison, make_outcome, provenance
from eval.comparison.schema import require_same_version, write_results
from eval.comparison.splits import EPISODES, QUICK_EPISODES, load
from eval.comparison.timing import action_times
from eval.comparison.traces import Traces, record
from eval.scenarios import require_same_physics
from eval.views.markdown import markdown
from eval.views.plots import save_plots
from eval.views.report import Recordings, record_scenes, robustness_maps, write_report
from eval.views.terminal import print_tables


@dataclass(frozen=True)
class Config:
    """Compare controllers on the belt-driven arm."""

    methods: tuple[str, ...] = ()
    """Methods to run, by name. Default: all classical controllers, all policies, the yardstick and what --add names."""
    splits: tuple[str, ...] = ()
    """Splits to run them on. Default: all."""
    policy: Annotated[tuple[Path, ...], tyro.conf.UseAppendAction] = ()
    """Folder of a policy bundle, such as runs/ppo/best; repeat it for more training seeds or methods. Default: the
    shipped policies."""
    add: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """A controller of your own, as package.module:Class or path/to/file.py:Class; repeat it for several. What is
    kept of it is used again until any file changes in its folder or below (of a package: in the whole package); if it
    depends on files elsewhere, use --fresh."""
    out: Path = Path("results/compare")
    """Folder for report.html, results.json, episodes.csv, summary.md, the pictures, and what is kept of each pair."""
    episodes: int | None = None
    """Scenarios per split; 200 by default."""
    quick: bool = False
    """A first look: 24 scenarios per split."""
    maps: bool = False
    """Also sweep stiffness by payload and friction by delay for the report: the best learned method against every
    classical controller that runs, which --methods chooses. Takes about a minute for all of them."""
    fresh: bool = False
    """Run everything again, whatever is kept of earlier runs."""
    jobs: int | None = None
    """Number of processes; by default one per core."""

    def check(self) -> None:
        """Check the numbers.

        Raises:
            ValueError: If one is out of range.
        """
        if self.episodes is not None and not 4 <= self.episodes <= EPISODES:
            raise ValueError(f"--episodes must lie within 4 and {EPISODES}, got {self.episodes}")
        if self.jobs is not None and not 1 <= self.jobs <= 256:
            raise ValueError(f"--jobs must lie within 1 and 256, got {self.jobs}")

    @property
    def scenarios(self) -> int:
        """Scenarios per split."""
        return self.episodes or (QUICK_EPISODES if self.quick else EPISODES)


def compare(config: Config, console: Console) -> Comparison:
    """Run all methods on all splits and write everything."""
    config.check()
    torch.set_num_threads(1)  # the networks are too small for more
    began = time.perf_counter()
    methods = _methods(config)
    for method in methods:
        if method.identity is None:
            why = f"{home(method.sources[0])} is too large to be hashed, or cannot be read"
            console.print(f"Results of {method.name} will not be used again: {why}.", soft_wrap=True)
    known = load()
    splits = {name: known[name] for name in chosen("split", config.splits, known)}
    require_writable(config.out)
    if (config.out / "results.json").exists():
        require_same_version(config.out / "results.json")
    require_same_physics(splits)
    pairs = [Pair(method, split, config.scenarios) for split in splits.values() for method in methods]
    if config.fresh:
        for pair in pairs:
            pair.file(config.out).unlink(missing_ok=True)
    kept = sum(pair.file(config.out).exists() for pair in pairs)
    outcomes, failures = _outcomes(pairs, config, console)
    if not any(outcome.ranked for outcome in outcomes):
        raise ValueError(f"no method could be run: {failures[0].method} on {failures[0].split}: {failures[0].message}")
    origin = provenance(command_line(), time.perf_counter() - began, methods, splits) | {"pairs_kept_before": kept}
    comparison = make_comparison(outcomes, failures, origin)
    traces, unrecorded = record(comparison, splits)
    scenes, unseen = record_scenes(comparison, splits)
    maps, unmapped = robustness_maps(comparison) if config.maps else ([], [])
    comparison = comparison.with_failures([*unrecorded, *unseen, *unmapped])
    _write(comparison, traces, config.out, console)
    write_report(comparison, Recordings(scenes, maps), config.out)
    console.print(f"for reading: {config.out / 'report.html'}")
    return comparison


def _methods(config: Config) -> list[Method]:
    """The methods to run, checked.

    Raises:
        ValueError: If a name is unknown or given twice, or a controller of the user's own does not keep the protocol.
    """
    known = [*classical_methods(), *learned_methods(config.policy or shipped_policies())]
    known += [added_method(spec, config.out) for spec in config.add] + [privileged_method()]
    names = [method.name for method in known]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"two methods are called {name!r}: give yours another name")
    wanted = chosen("method", config.methods, names)
    if config.methods and set(wanted) == {PRIVILEGED}:
        raise ValueError(f"--methods names {PRIVILEGED} alone, which is compared with nothing: name another as well")
    methods = [method for method in known if method.name in wanted]
    for method in methods:
        if method.kind == "added" and (failure := first_failure(method.sources[0])):
            raise ValueError(f"{failure}; see `python eval/check_controller.py {method.sources[0]}`")
    return methods


def _outcomes(pairs: list[Pair], config: Config, console: Console) -> tuple[list[Outcome], list[Failure]]:
    """What came out of all pairs; a controller that fails on a single arm, where it is timed, is not run at all."""
    methods = {pair.method.name: pair.method for pair in pairs}
    times = {name: attempt(name, "", partial(_time, method), "one arm") for name, method in methods.items()}
    sound = [pair for pair in pairs if not isinstance(times[pair.method.name], Failure)]
    results = dict(zip(map(id, sound), _run(sound, config, console), strict=True))
    outcomes, failures = [], []
    for pair in pairs:
        took, result = times[pair.method.name], results.get(id(pair))
        if isinstance(took, Failure):
            failures.append(replace(took, split=pair.split.name))
        elif isinstance(result, Failure):
            failures.append(result)
        elif result is not None:
            outcomes.append(make_outcome(pair.method, pair.split.name, result, took))
    return outcomes, failures


def _time(method: Method) -> tuple[float, float]:
    return action_times(method.controller(0, [ArmParams()]), method.sensors)


def _run(pairs: list[Pair], config: Config, console: Console) -> list[Metrics | Failure]:
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(f"{len(pairs)} pairs of method and split", total=len(pairs))
        try:
            return run_pairs(pairs, config.out, config.jobs or default_jobs(), lambda _: progress.advance(task))
        except KeyboardInterrupt:
            kept = sum(pair.file(config.out).exists() for pair in pairs)
            raise Interrupted(
                f"interrupted: {kept} of {len(pairs)} pairs of method and split are kept in {config.out}; the same "
                "command goes on from there"
            ) from None


class Interrupted(KeyboardInterrupt):
    """Ctrl-C, with what is kept."""


def _write(comparison: Comparison, traces: Traces, folder: Path, console: Console) -> None:
    """Print tables and write all files."""
    print_tables(comparison, console)
    write_results(comparison, folder)
    digest = hashlib.sha256((folder / "results.json").read_bytes()).hexdigest()
    pictures = save_plots(comparison, traces, folder, digest)
    write_text(folder / "summary.md", markdown(comparison, [path.name for path in pictures], digest))
    console.print(f"written to {folder}: results.json, episodes.csv, summary.md, {len(pictures)} pictures")
    for failure in comparison.failures:
        print(f"eval/compare.py: {failure.method} failed on {failure.split}: {failure.message}", file=sys.stderr)


def main() -> None:
    """Command line."""
    config = tyro.cli(Config, description=__doc__)
    with one_line_errors("eval/compare.py"):
        comparison = compare(config, Console())
        sys.exit(1 if comparison.failures else 0)


if __name__ == "__main__":
    main()
