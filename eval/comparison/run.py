"""Run of a comparison: from names of methods and splits to results, which are kept and not computed again."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from baselines import DOMINATED
from baselines.engines.options import LOCAL, Engine
from baselines.tools.files import require_writable
from baselines.tools.provenance import command_line
from eval.comparison import protocol
from eval.comparison.custom import TIME_LIMIT
from eval.comparison.failures import Failure, attempt
from eval.comparison.methods import (
    PRIVILEGED,
    Method,
    added_method,
    chosen,
    classical_methods,
    is_shipped,
    learned_methods,
    privileged_method,
    shipped_policies,
)
from eval.comparison.pairs import Metrics, Pair, run_pairs
from eval.comparison.results import (
    COMPUTING_TIME,
    Comparison,
    MethodOutcome,
    estimated,
    make_comparison,
    provenance,
)
from eval.comparison.scenarios import require_same_physics
from eval.comparison.schema import read_results, require_same_set
from eval.comparison.sets import ScenarioSet
from eval.comparison.splits import Split, main_split
from eval.comparison.timing import ActionTimes, measured_once, measured_times


def choose_methods(
    names: Sequence[str],
    policies: Sequence[Path | str] = (),
    added: Sequence[str] = (),
    results: Path | None = None,
    *,
    guard: bool = False,
    time_limit: float = TIME_LIMIT,
) -> list[Method]:
    """Choose methods by name.

    Args:
        names: Names of the project's own methods; none for all but those that are dominated, see
            `baselines.registry.DOMINATED`. Names of the user's own change nothing.
        policies: Policies beside the shipped ones, see `eval.comparison.methods.learned_methods`. They always run.
        added: Controllers of the user's own, as package.module:Class or path/to/file.py:Class. They always run.
        results: Folder of the comparison, see `eval.comparison.custom.identity`.
        guard: Whether each classical and learned method also runs with the guard.
        time_limit: Time that a controller of the user's own may take for a batch of episodes [s].

    Raises:
        ValueError: If a name is unknown or given twice, or there is no such file or package.
    """
    known = [*classical_methods(), *learned_methods([*shipped_policies(), *policies])]
    known += [added_method(spec, results, time_limit) for spec in added] + [privileged_method()]
    all_names = [method.name for method in known]
    for name in all_names:
        if all_names.count(name) > 1:
            raise ValueError(f"two methods are called {name!r}: give yours another name (a policy: NAME=FOLDER)")
    wanted = chosen("method", names or [name for name in all_names if name not in DOMINATED], all_names)
    methods = [method for method in known if method.name in wanted or not is_shipped(method)]
    if names and [method.name for method in methods] == [PRIVILEGED]:
        raise ValueError(f"--methods names {PRIVILEGED} alone, which is compared with nothing: name another as well")
    if not guard:
        return methods
    twice = [(one, one.with_guard()) if one.kind in ("classical", "learned") else (one,) for one in methods]
    return [method for group in twice for method in group]


def require_no_more_in(path: Path, methods: Sequence[str], splits: Sequence[str], episodes: int) -> None:
    """Check that a results.json has nothing that results of these methods, splits and scenarios would lose.

    Raises:
        ValueError: If it has more, or is damaged.
    """
    rows = read_results(path)["rows"]
    more = sorted({row["method"] for row in rows} - {*methods})
    more += sorted({row["split"] for row in rows} - {*splits})
    most = max((row["episodes"] for row in rows), default=0)
    more += [f"{most} scenarios per split"] if most > episodes else []
    if more:
        raise ValueError(
            f"{path} has more ({', '.join(more)}), which this run would lose: give another --out, or remove that file"
        )


def compare(
    methods: Sequence[Method],
    scenarios: ScenarioSet,
    episodes: int,
    folder: Path,
    jobs: int | None,
    *,
    engine: Engine = LOCAL,
    fresh: bool = False,
    computing_time: bool = False,
    done: Callable[[int, int], object] = lambda *_: None,
) -> Comparison:
    """Run methods on splits and compare what comes out.

    Args:
        methods: See `choose_methods`.
        scenarios: Splits that are run, of one set of scenarios.
        episodes: Scenarios per split.
        folder: Where results are kept.
        jobs: Number of processes, by default one per core.
        engine: What runs them.
        fresh: Whether to run everything again.
        computing_time: Whether each method's commands are later by its own time per action, see
            `eval.comparison.timing`.
        done: Called with the number of pairs of method and split that are done, and of all.

    Raises:
        OSError: If the folder cannot be written to, or a process was killed.
        ValueError: If the folder has results of other scenarios, more results than these, or some in which computing
            time counts as it does not here, the arms do not move as they did when the scenarios were drawn, or no
            method could be run.
        KeyboardInterrupt: On Ctrl-C, with a message about the results that are kept.
    """
    began = time.perf_counter()
    require_writable(folder)
    if (folder / "results.json").exists():
        require_same_set(folder / "results.json", scenarios.label, computing_time)
        names = [method.name for method in methods]
        require_no_more_in(folder / "results.json", names, list(scenarios.splits), episodes)
    require_same_physics(scenarios)
    unsound = protocol.failures(methods)
    sound = [method for method in methods if method.name not in unsound]
    times = measured_once(sound, folder, fresh=fresh) if computing_time else measured_times(sound)
    times |= unsound
    main = main_split(list(scenarios.splits))
    runs = [
        _Run(method, split, times[method.name], computing_time, episodes, nudged=split.name == main)
        for split in scenarios.splits.values()
        for method in methods
    ]
    pairs = [run.pair for run in runs if isinstance(run.pair, Pair)]
    if fresh:
        for pair in pairs:
            pair.file(folder).unlink(missing_ok=True)
    kept = _kept(pairs, folder)
    outcomes, failures = _outcomes(runs, folder, jobs, engine, done)
    if not any(outcome.ranked for outcome in outcomes):
        first = failures[0]
        error = ValueError(f"no method could be run: {first.method} on {first.split}: {first.message}")
        error.add_note(first.trace)
        raise error
    origin = provenance(command_line(), time.perf_counter() - began, methods, scenarios.splits)
    origin |= {"pairs_kept_before": kept, COMPUTING_TIME: computing_time}
    return make_comparison(outcomes, failures, scenarios.label, origin)


@dataclass(frozen=True)
class _Run:
    """A method on a split, with the time that it takes for an action; one that fails before that is not run."""

    method: Method
    split: Split
    times: ActionTimes | Failure
    computing_time: bool  # whether its commands are later by that time
    episodes: int
    nudged: bool  # whether its sensitivity is measured

    @property
    def latency(self) -> float:
        """Time by which its commands are later than the drive's latency [s]."""
        return 1e-6 * self.times[1] if self.computing_time and not isinstance(self.times, Failure) else 0.0

    @cached_property
    def pair(self) -> Pair | Failure:
        """What is run, or why nothing is."""
        if isinstance(self.times, Failure):
            return replace(self.times, split=self.split.name)
        late = attempt(self.method.name, self.split.name, lambda: self.split.later(self.latency))
        return late if isinstance(late, Failure) else Pair(self.method, late, self.episodes, self.nudged)


def _kept(pairs: list[Pair], folder: Path) -> int:
    return sum(pair.file(folder).exists() for pair in pairs)


def _outcomes(
    runs: list[_Run], folder: Path, jobs: int | None, engine: Engine, done: Callable[[int, int], object]
) -> tuple[list[MethodOutcome], list[Failure]]:
    """Outcomes and failures of all runs."""
    pairs = [run.pair for run in runs if isinstance(run.pair, Pair)]
    finished: list[Pair] = []

    def one_more(pair: Pair) -> None:
        finished.append(pair)
        done(len(finished), len(pairs))

    done(0, len(pairs))
    try:
        results = iter(run_pairs(pairs, folder, jobs, one_more, engine))
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"interrupted: {_kept(pairs, folder)} of {len(pairs)} pairs of method and split are kept in {folder}; the "
            "same command continues from there"
        ) from None
    measured, failures = list[tuple[_Run, ActionTimes, Metrics]](), list[Failure]()
    for run in runs:
        result = run.pair if isinstance(run.pair, Failure) else next(results)
        if isinstance(result, Failure):
            failures.append(result)
        elif not isinstance(run.times, Failure):
            measured.append((run, run.times, result))
    found = estimated([metrics for _, _, metrics in measured])
    outcomes = [
        MethodOutcome(run.method, run.split.name, metrics, estimates, times, run.latency)
        for (run, times, metrics), estimates in zip(measured, found, strict=True)
    ]
    return outcomes, failures
