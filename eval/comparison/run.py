"""Run of a comparison: from names of methods and splits to results, which are kept; and the verification of results."""

from __future__ import annotations

import re
import shlex
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

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
from eval.comparison.scenarios import choose_set, require_same_physics
from eval.comparison.schema import read_results, require_same_set, to_json
from eval.comparison.sets import ScenarioSet, SetLabel, enlarged_set
from eval.comparison.splits import EPISODES


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


# Verification

TOLERANCES = {
    "interquartile mean of the cost": 0.003,
    "mean cost": 0.005,
    "worst 5 % of the cost": 0.02,
    "share not settled": 0.005,
    "share out of the workspace": 0.005,
}
"""Differences that are allowed between processors: of costs relative, of shares absolute.

Processors round differently, and where a motor sticks is decided by a hair. First torques that differ by 1e-9 N m, more
than rounding does, changed average costs of `paper`, `mpc`, `adaptive` and a seed of `student` over 500 scenarios of
each split of the development set (`student`: all but `structural`) by less than a tenth of these tolerances."""
_SHARES = ("share not settled", "share out of the workspace")


class Difference(NamedTuple):
    """A number of a method on a split, as it is claimed and as it came out."""

    method: str
    split: str
    quantity: str
    claimed: float
    measured: float

    @property
    def excess(self) -> float:
        """Size over the tolerance."""
        size = abs(self.measured - self.claimed) / (1.0 if self.quantity in _SHARES else abs(self.claimed))
        return size / TOLERANCES[self.quantity]

    def __str__(self) -> str:
        """The numbers, in words."""
        numbers = f"claimed {self.claimed:.6g}, here {self.measured:.6g}"
        return (
            f"{self.method} on {self.split}, {self.quantity} of the cost: {numbers}, {self.excess:.2g} of the tolerance"
        )


def verify(
    folder: Path,
    policies: Sequence[str] = (),
    added: Sequence[str] = (),
    jobs: int | None = None,
    time_limit: float = TIME_LIMIT,
    done: Callable[[int, int], object] = lambda *_: None,
) -> tuple[str, bool]:
    """Run again what the results.json of a folder claims, in a temporary folder.

    Args:
        folder: Of a comparison.
        policies: See `choose_methods`; by default those of the command that the results name.
        added: Likewise.
        jobs: Number of processes, by default one per core.
        time_limit: Time that a controller of the user's own may take for a batch of episodes [s].
        done: Called with the number of parts that are done, and of all.

    Returns:
        Sentence about the first number that differs by more than its tolerance, or about all; whether all agree.

    Raises:
        ValueError: If the results are of other scenarios or of files that no commit has, or a method is not there or
            fails.
    """
    path = folder / "results.json"
    claimed = read_results(path)
    require_clean(claimed, path)
    scenarios = scenarios_of(claimed, path)
    names = list(dict.fromkeys(row["method"] for row in claimed["rows"]))
    command = shlex.split(claimed["provenance"]["command"])
    project = {method.name for method in (*classical_methods(), *learned_methods(shipped_policies()))} | {PRIVILEGED}
    known = choose_methods(
        [name for name in project if name in {each.removesuffix("+guard") for each in names}] or ("paper",),
        policies or _given(command, "--policy"),
        added or _given(command, "--add"),
        guard=any(name.endswith("+guard") for name in names),
        time_limit=time_limit,
    )
    methods = {method.name: method for method in known}
    if missing := [name for name in names if name not in methods]:
        raise ValueError(f"{path} has results of {missing[0]}, which is not here: give it with --add or --policy")
    with TemporaryDirectory(prefix="beltarm-") as temporary:
        chosen = [methods[name] for name in names]
        comparison = compare(chosen, scenarios, claimed["rows"][0]["episodes"], Path(temporary), jobs, done=done)
    for failure in comparison.failures:
        raise ValueError(f"{failure.method} failed on {failure.split}: {failure.message}")
    measured = {(row["method"], row["split"]): row for row in to_json(comparison)["rows"]}
    numbers = [
        Difference(row["method"], row["split"], quantity, value, quantities[quantity])
        for row in claimed["rows"]
        for quantities in [dict(_quantities(measured[row["method"], row["split"]]))]
        for quantity, value in _quantities(row)
    ]
    wrong = next((number for number in numbers if number.excess > 1), None)
    if wrong:
        return f"Not as {path} says: {wrong}", False
    farthest = max(numbers, key=lambda number: number.excess)
    return f"All {len(numbers)} numbers of {path} come out again. Farthest: {farthest}", True


def require_clean(content: dict[str, Any], path: Path) -> None:
    """Check that results are of a commit without changes.

    Raises:
        ValueError: If they are not.
    """
    commit = content["provenance"]["commit"]
    if commit == "unknown" or commit.endswith("-dirty"):
        raise ValueError(f"{path} was measured with files that no commit has ({commit}): commit them, and run it again")


def scenarios_of(content: dict[str, Any], path: Path) -> ScenarioSet:
    """Return the scenarios that results are of.

    Raises:
        ValueError: If this checkout has others.
    """
    label, episodes = SetLabel(**content["scenario_set"]), content["rows"][0]["episodes"]
    fresh = re.fullmatch(r"seed (\d+)", label.name)
    known = choose_set(None, int(fresh[1])) if fresh else choose_set(label.name)
    if known.label != label:
        raise ValueError(
            f"{path} is of other scenarios than this checkout's {known.label.title}: they differ in SHA-256"
        )
    splits = list(dict.fromkeys(row["split"] for row in content["rows"]))
    return enlarged_set(int(fresh[1]), splits, episodes) if fresh and episodes > EPISODES else known.only(splits)


def _given(command: Sequence[str], option: str) -> list[str]:
    """Values of an option in a command line."""
    return [word for before, word in pairwise(command) if before == option]


def _quantities(row: dict[str, Any]) -> Iterator[tuple[str, float]]:
    """Numbers of a row that have a tolerance."""
    failures = row["failures"]
    yield "interquartile mean of the cost", row["metrics"]["cost"]["iqm"]
    for quantity, key in (("mean cost", "cost_mean"), ("worst 5 % of the cost", "cost_worst")):
        if key in row:
            yield quantity, row[key]
    for quantity, key in zip(_SHARES, ("not_settled", "left_workspace"), strict=True):
        yield quantity, failures[key] / failures["runs"]
