"""Run of a comparison: from names of methods and splits to results, which are kept; and the verification of results."""

import shlex
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise, product
from math import inf, isfinite
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from baselines.engines.parallel import SideBySide
from baselines.tools.files import require_writable
from beltarm_env.metrics import METRICS
from eval.comparison.cache import Metrics, kept_count, parts_of, run_parts
from eval.comparison.check import ActionTimes, first_failures, times_of
from eval.comparison.methods import NO_METHODS, Method, OwnMethods, choose_methods, project_names
from eval.comparison.results import Comparison, MethodOutcome, estimated, make_comparison, provenance
from eval.comparison.rollouts import Failure, changed
from eval.comparison.schema import read_results, to_json
from eval.comparison.sets import ScenarioSet, require_same_physics, set_of
from eval.comparison.splits import QUICK_SEEDS, main_split


class Run(NamedTuple):
    """How a comparison is run."""

    folder: Path  # in which parts are kept, see `run_parts`
    options: SideBySide
    fresh: bool = False  # whether everything is run again
    done: Callable[[int, int], object] = lambda *_: None


def compare(methods: Sequence[Method], scenarios: ScenarioSet, episodes: int, run: Run) -> Comparison:
    """Run methods on the first scenarios of splits, and compare their results.

    Raises:
        OSError: If the folder cannot be written to, or a process was killed.
        ValueError: If the folder has results of other scenarios, or more results than these, the arms do not move as
            they did when the scenarios were drawn, or no method could be run.
        KeyboardInterrupt: On Ctrl-C, with a message about the results that are kept, and how to go on.
    """
    folder = run.folder
    require_writable(folder)
    _require_no_loss(folder / "results.json", methods, scenarios, episodes)
    require_same_physics(scenarios)
    origin, began = provenance(methods, scenarios.splits), time.perf_counter()
    failed, main = first_failures(methods), main_split(list(scenarios.splits))
    parts = {
        (split.name, method.name): parts_of(method, split, episodes, perturbed=split.name == main)
        for split, method in product(scenarios.splits.values(), methods)
        if method.name not in failed
    }
    in_order = [part for of_pair in parts.values() for part in of_pair]
    if run.fresh:
        for part in in_order:
            part.file(folder).unlink(missing_ok=True)
    kept = kept_count(in_order, folder)
    try:
        results = iter(run_parts(in_order, folder, run.options, run.done))
    except KeyboardInterrupt as stop:
        raise KeyboardInterrupt(f"{stop}, without --fresh" if run.fresh else str(stop)) from None
    joined = {pair: _joined([next(results) for _ in of_pair]) for pair, of_pair in parts.items()}
    # Only now, when processes have compiled kernels side by side.
    times = times_of(method for method in methods if method.name not in failed) | failed
    times |= {method.name: failure for method in methods if (failure := changed(method))}
    measured, failures = list[tuple[Method, str, Metrics, ActionTimes]](), list[Failure]()
    for split, method in product(scenarios.splits, methods):
        early = times[method.name]
        result = replace(early, split=split) if isinstance(early, Failure) else joined[split, method.name]
        if isinstance(result, Failure):
            failures.append(result)
        elif not isinstance(early, Failure):
            measured.append((method, split, result, early))
    estimates = estimated([metrics for _, _, metrics, _ in measured])
    outcomes = [
        MethodOutcome(method, split, metrics, of_metrics, action_times, len(scenarios.splits[split].tables))
        for (method, split, metrics, action_times), of_metrics in zip(measured, estimates, strict=True)
    ]
    origin |= {"seconds": round(time.perf_counter() - began, 1), "pairs_kept_before": kept}
    return make_comparison(outcomes, failures, scenarios.label, origin)


def _require_no_loss(path: Path, methods: Sequence[Method], scenarios: ScenarioSet, episodes: int) -> None:
    """Check that a results.json, if there is one, has nothing that this run's results would lose."""
    rows = read_results(path, scenarios.label)["rows"] if path.exists() else []
    seeds = {method.name: len(method.sources) for method in methods}
    moves = {split.name: len(split.tables) for split in scenarios.splits.values()}
    more = [*sorted({r["method"] for r in rows} - seeds.keys()), *sorted({r["split"] for r in rows} - moves.keys())]
    more += [f"{r['seeds']} policies of {r['method']}" for r in rows if r["seeds"] > seeds.get(r["method"], inf)]
    more += [f"{r['episodes']} scenarios per split" for r in rows if r["episodes"] > episodes]
    more += [f"shifts of {r['moves']} moves" for r in rows if r["moves"] > moves.get(r["split"], inf)]
    if more:
        lost = ", ".join(dict.fromkeys(more))
        raise ValueError(f"{path} has more ({lost}), which would be lost: give another --out, or remove that file")


def _joined(results: Sequence[Metrics | Failure]) -> Metrics | Failure:
    """Results of a method on a split, from those of its parts: the first failure, if there is one."""
    sound = [result for result in results if not isinstance(result, Failure)]
    if len(sound) < len(results):
        return next(result for result in results if isinstance(result, Failure))
    return {name: np.concatenate([metrics[name] for metrics in sound], axis=1) for name in sound[0]}


# Verification

TOLERANCES = {"cost": 0.003, "cost_mean": 0.005, "cost_worst": 0.02, "torque_reversals_hz": 0.05, "p_holm": 0.02}
"""Differences that are allowed between processors, of p values absolute, of costs and reversals relative."""
OTHERWISE, SECONDS, SHARE = 0.01, 0.02, 0.005
"""The same of all other numbers: relative of errors and torques, absolute of times [s] and of shares.

Processors round differently, and where a motor sticks is decided by a hair. First torques that differ by 1e-9 N m, more
than rounding does, changed averages of `paper`, `mpc`, `adaptive` and a seed of `student` over 200 scenarios of five
splits of the development set (randomized, shift, stiffness, friction, structural) by 0.6 of what is allowed at most."""
_Claim = tuple[float | str, float]  # number or word, and by how much it may differ
_NOTHING: _Claim = (float("nan"), 0.0)


def verify(
    folder: Path,
    options: SideBySide,
    judge: Callable[[Comparison], tuple[list[str], list[dict[str, Any]]]],
    own: OwnMethods = NO_METHODS,
    done: Callable[[int, int], object] = lambda *_: None,
) -> tuple[str, bool]:
    """Run again what the results.json of a folder claims, in a temporary folder; `options` and `done` as of `Run`.

    Methods of the user's own are by default those of the command that the results name, and `judge` makes sentences and
    tests of the verdict. Returns a sentence about the first number or word that differs by more than its tolerance, or
    about all, and whether all agree.

    Raises:
        ValueError: If the results are of other scenarios or of files that no commit has, or a method is not there or
            fails.
    """
    path = folder / "results.json"
    claimed = read_results(path)
    scenarios, episodes = _claimed_scenarios(claimed, path), claimed["rows"][0]["episodes"]
    methods = _claimed_methods(claimed, path, own)
    with TemporaryDirectory(prefix="beltarm-") as temporary:
        comparison = compare(methods, scenarios, episodes, Run(Path(temporary), options, done=done))
    for failure in comparison.failures:
        raise ValueError(f"{failure.method} failed on {failure.split}: {failure.message}")
    sentences, primary = judge(comparison)
    claims, here = _claims(claimed), _claims(to_json(comparison, sentences, primary))
    pairs = {key: (claims.get(key, _NOTHING), here.get(key, _NOTHING)) for key in {**claims, **here}}
    excess = {key: _excess(*pair) for key, pair in pairs.items()}
    wrong = next((key for key in excess if excess[key] > 1), None)
    method, split, quantity = farthest = wrong or max(excess, key=lambda key: excess[key])
    said, found = (value if isinstance(value, str) else f"{value:.6g}" for value, _ in pairs[farthest])
    about = f"{method} on {split}, {quantity}: claimed {said}, here {found}, {excess[farthest]:.2g} of the tolerance"
    if wrong:
        return f"Not as {path} says: {about}", False
    other = "" if sentences == claimed["verdict"] else " The sentences of its verdict are others here."
    return f"All {len(pairs)} numbers and words of {path} come out again.{other} Farthest: {about}", True


def _excess(claimed: _Claim, measured: _Claim) -> float:
    """Difference over the tolerance; infinite where words or counts differ, or one of the two is not there."""
    (said, allowed), (found, _) = claimed, measured
    if isinstance(said, str) or isinstance(found, str) or not allowed:
        return 0.0 if said == found else inf
    return abs(said - found) / allowed if isfinite(found) else inf


def _claimed_methods(claimed: dict[str, Any], path: Path, own: OwnMethods) -> list[Method]:
    """Methods that results are of, which must be there."""
    names = list(dict.fromkeys(row["method"] for row in claimed["rows"]))
    command = shlex.split(claimed["provenance"]["command"])
    words = list(pairwise(part for word in command for part in (word.split("=", 1) if word[:2] == "--" else [word])))
    known = choose_methods(
        [name for name in project_names() if name in {each.removesuffix("+guard") for each in names}] or ("paper",),
        own._replace(
            policies=own.policies or [word for option, word in words if option == "--policy"],
            added=own.added or [word for option, word in words if option == "--add"],
        ),
        guard=any(name.endswith("+guard") for name in names),
        seeds=QUICK_SEEDS if "--quick" in command else None,
    )
    methods = {method.name: method for method in known}
    if missing := [name for name in names if name not in methods]:
        raise ValueError(f"{path} has results of {missing[0]}, which is not here: give it with --add or --policy")
    for name, files in claimed["provenance"].get("added", {}).items():
        if name in methods and methods[name].own_files != files:
            raise ValueError(f"{path} was measured with other files of {name}")
    return [methods[name] for name in names]


def _claimed_scenarios(claimed: dict[str, Any], path: Path) -> ScenarioSet:
    """Scenarios that results of a commit without changes are of, which this checkout must have."""
    commit = claimed["provenance"]["commit"]
    if commit == "unknown" or commit.endswith("-dirty"):
        raise ValueError(f"{path} was measured with files that no commit has ({commit}): commit them, and run it again")
    rows = claimed["rows"]
    names, moves = list(dict.fromkeys(row["split"] for row in rows)), max(row["moves"] for row in rows)
    return set_of(claimed, path).only(names, rows[0]["episodes"], moves)


def _claims(content: dict[str, Any]) -> dict[tuple[str, str, str], _Claim]:
    """What a results.json claims, by method, split and quantity: of rows, of pairs, and of the primary comparison."""
    claims: dict[tuple[str, str, str], _Claim] = {}
    for row in content["rows"]:
        own, failures = (row["method"], row["split"]), row["failures"]
        numbers = {name: value["iqm"] for name, value in row["metrics"].items()}
        numbers |= {name: row[name] for name in ("cost_mean", "cost_worst") if name in row}
        runs = {"not_settled": failures["runs"], "left_workspace": row["seeds"] * row["episodes"]}
        numbers |= {name: failures[name] / count for name, count in runs.items()}
        claims |= {(*own, name): (value, _allowed(name, value)) for name, value in numbers.items()}
        claims |= {(*own, name): (row[name], 0.0) for name in ("episodes", "moves", "seeds")}
    pairs = [(row["method"], row["other"], row, each) for row in content["paired"] for each in row["metrics"].items()]
    pairs += [(row["challenger"], row["classical"], row, (row["metric"], row)) for row in content.get("primary", [])]
    for method, other, about, (name, test) in pairs:
        _, allowed = claims.get((method, about["split"], name), _NOTHING)
        found = {"difference": (test["iqm"], allowed), "p": (test["p_holm"], TOLERANCES["p_holm"])}
        found |= {"mean difference": (test["mean"], 2 * allowed)} if "mean" in test else {}
        if name == "cost" and "mean" in test:  # a ratio, whose error grows with it
            found["relative"] = test["relative"], 2 * TOLERANCES["cost"] * (1 + abs(test["relative"]))
        found["result"] = test.get("verdict") or test["result"], 0.0
        words = f"{name} against {other}, {about.get('against', 'primary')}"
        claims |= {(method, about["split"], f"{words}, {part}"): claim for part, claim in found.items()}
    return claims


def _allowed(name: str, value: float) -> float:
    """Difference that is allowed of a number of a row; of zeros that of rounding."""
    metric = METRICS.get(name)
    if name in ("not_settled", "left_workspace") or (metric and metric.share):
        return SHARE
    return SECONDS if metric and metric.unit == "s" else TOLERANCES.get(name, OTHERWISE) * abs(value) + 1e-4
