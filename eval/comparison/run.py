"""Run of a comparison: from names of methods and splits to results, which are kept and not computed again."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from baselines import DOMINATED
from baselines.engines.options import LOCAL, Engine
from baselines.tools.files import require_writable
from baselines.tools.provenance import command_line
from eval.comparison import check
from eval.comparison.cache import Metrics, kept_count, parts_of, run_parts
from eval.comparison.custom import TIME_LIMIT
from eval.comparison.failures import Failure
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
from eval.comparison.results import Comparison, MethodOutcome, estimated, make_comparison, provenance
from eval.comparison.scenarios import require_same_physics
from eval.comparison.schema import read_results, require_same_set
from eval.comparison.sets import ScenarioSet


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
    return [
        each
        for method in methods
        for each in ((method, method.with_guard()) if method.kind in ("classical", "learned") else (method,))
    ]


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
    done: Callable[[int, int], object] = lambda *_: None,
) -> Comparison:
    """Run methods on splits and compare their results.

    Args:
        methods: See `choose_methods`.
        scenarios: Splits that are run, of one set of scenarios.
        episodes: Scenarios per split.
        folder: Where results are kept.
        jobs: Number of processes, by default one per core.
        engine: What runs them.
        fresh: Whether to run everything again.
        done: Called with the number of parts that are done, and of all.

    Raises:
        OSError: If the folder cannot be written to, or a process was killed.
        ValueError: If the folder has results of other scenarios, or more results than these, the arms do not move as
            they did when the scenarios were drawn, or no method could be run.
        KeyboardInterrupt: On Ctrl-C, with a message about the results that are kept.
    """
    began = time.perf_counter()
    require_writable(folder)
    if (folder / "results.json").exists():
        require_same_set(folder / "results.json", scenarios.label)
        names = [method.name for method in methods]
        require_no_more_in(folder / "results.json", names, list(scenarios.splits), episodes)
    require_same_physics(scenarios)
    unsound = check.failures(methods)
    times = check.measured_times(method for method in methods if method.name not in unsound) | unsound
    able = [method for method in methods if not isinstance(times[method.name], Failure)]
    parts = {
        (split, method.name): parts_of(method, of_split, episodes)
        for split, of_split in scenarios.splits.items()
        for method in able
    }
    in_order = [part for of_pair in parts.values() for part in of_pair]
    if fresh:
        for part in in_order:
            part.file(folder).unlink(missing_ok=True)
    kept = kept_count(in_order, folder)
    results = iter(run_parts(in_order, folder, jobs, done, engine))
    joined = {pair: _joined([next(results) for _ in of_pair]) for pair, of_pair in parts.items()}

    measured, failures = list[tuple[Method, str, Metrics]](), list[Failure]()
    for split in scenarios.splits:
        for method in methods:
            early = times[method.name]
            result = replace(early, split=split) if isinstance(early, Failure) else joined[split, method.name]
            if isinstance(result, Failure):
                failures.append(result)
            else:
                measured.append((method, split, result))
    if not any(method.kind != "privileged" for method, _, _ in measured):
        first = failures[0]
        error = ValueError(f"no method could be run: {first.method} on {first.split}: {first.message}")
        error.add_note(first.trace)
        raise error
    outcomes = [
        MethodOutcome(method, split, metrics, estimates, action_times)
        for (method, split, metrics), estimates in zip(measured, estimated([of for _, _, of in measured]), strict=True)
        if not isinstance(action_times := times[method.name], Failure)
    ]
    origin = provenance(command_line(), time.perf_counter() - began, methods, scenarios.splits)
    return make_comparison(outcomes, failures, scenarios.label, origin | {"pairs_kept_before": kept})


def _joined(results: Sequence[Metrics | Failure]) -> Metrics | Failure:
    """Results of a method on a split, from those of its parts: the first failure, if there is one."""
    sound = []
    for result in results:
        if isinstance(result, Failure):
            return result
        sound.append(result)
    return {name: np.concatenate([metrics[name] for metrics in sound], axis=1) for name in sound[0]}
