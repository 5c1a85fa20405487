"""Run of a comparison: from names of methods and splits to results, which are kept and not computed again."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from baselines import DOMINATED
from baselines.tools.files import require_writable
from baselines.tools.provenance import command_line
from beltarm_env import ArmParams
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
from eval.comparison.pairs import Failure, Pair, attempt, run_pairs
from eval.comparison.protocol import first_failure
from eval.comparison.results import Comparison, MethodOutcome, make_comparison, make_outcome, provenance
from eval.comparison.scenarios import require_same_physics
from eval.comparison.schema import require_same_set
from eval.comparison.sets import ScenarioSet
from eval.comparison.timing import action_times


def choose_methods(
    names: Sequence[str], policies: Sequence[Path] = (), added: Sequence[str] = (), results: Path | None = None
) -> list[Method]:
    """Choose methods by name, and check the user's own.

    Args:
        names: Names of the methods; none for all but those that are dominated, see `baselines.registry.DOMINATED`.
        policies: Folders of policies, in place of the shipped ones.
        added: Controllers of the user's own, as package.module:Class or path/to/file.py:Class.
        results: Folder of the comparison, see `eval.comparison.custom.identity`.

    Raises:
        ValueError: If a name is unknown or given twice, or a controller of the user's own does not keep the protocol.
    """
    known = [*classical_methods(), *learned_methods(policies or shipped_policies())]
    known += [added_method(spec, results) for spec in added] + [privileged_method()]
    all_names = [method.name for method in known]
    for name in all_names:
        if all_names.count(name) > 1:
            raise ValueError(f"two methods are called {name!r}: give yours another name")
    wanted = chosen("method", names or [name for name in all_names if name not in DOMINATED], all_names)
    if names and set(wanted) == {PRIVILEGED}:
        raise ValueError(f"--methods names {PRIVILEGED} alone, which is compared with nothing: name another as well")
    methods = [method for method in known if method.name in wanted]
    for method in methods:
        if method.kind == "added" and (failure := first_failure(method.sources[0])):
            raise ValueError(f"{failure}; see `python eval/check_controller.py {method.sources[0]}`")
    return methods


def compare(
    methods: Sequence[Method],
    scenarios: ScenarioSet,
    episodes: int,
    folder: Path,
    jobs: int,
    *,
    fresh: bool = False,
    done: Callable[[int, int], object] = lambda *_: None,
) -> Comparison:
    """Run methods on splits and compare what comes out.

    Args:
        methods: See `choose_methods`.
        scenarios: Splits that are run, of one set of scenarios.
        episodes: Scenarios per split.
        folder: Where results are kept.
        jobs: Number of processes.
        fresh: Whether to run everything again.
        done: Called with the number of pairs of method and split that are done, and of all.

    Raises:
        OSError: If the folder cannot be written to, or a process was killed.
        ValueError: If the folder has results of other scenarios, the arms do not move as they did when the scenarios
            were drawn, or no method could be run.
        KeyboardInterrupt: On Ctrl-C, with a message about the results that are kept.
    """
    began = time.perf_counter()
    require_writable(folder)
    if (folder / "results.json").exists():
        require_same_set(folder / "results.json", scenarios.label)
    require_same_physics(scenarios)
    pairs = [Pair(method, split, episodes) for split in scenarios.splits.values() for method in methods]
    if fresh:
        for pair in pairs:
            pair.file(folder).unlink(missing_ok=True)
    kept = _kept(pairs, folder)
    outcomes, failures = _outcomes(pairs, folder, jobs, done)
    if not any(outcome.ranked for outcome in outcomes):
        raise ValueError(f"no method could be run: {failures[0].method} on {failures[0].split}: {failures[0].message}")
    origin = provenance(command_line(), time.perf_counter() - began, methods, scenarios.splits)
    return make_comparison(outcomes, failures, scenarios.label, origin | {"pairs_kept_before": kept})


def _kept(pairs: list[Pair], folder: Path) -> int:
    return sum(pair.file(folder).exists() for pair in pairs)


def _outcomes(
    pairs: list[Pair], folder: Path, jobs: int, done: Callable[[int, int], object]
) -> tuple[list[MethodOutcome], list[Failure]]:
    """Outcomes and failures of all pairs; a controller that fails on a single arm, where it is timed, is not run."""
    methods = {pair.method.name: pair.method for pair in pairs}
    times = {name: attempt(name, "", partial(_time, method), "one arm") for name, method in methods.items()}
    sound = [pair for pair in pairs if not isinstance(times[pair.method.name], Failure)]
    finished: list[Pair] = []

    def one_more(pair: Pair) -> None:
        finished.append(pair)
        done(len(finished), len(sound))

    try:
        results = dict(zip(map(id, sound), run_pairs(sound, folder, jobs, one_more), strict=True))
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"interrupted: {_kept(sound, folder)} of {len(sound)} pairs of method and split are kept in {folder}; the "
            "same command goes on from there"
        ) from None
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
