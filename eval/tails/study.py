"""Study of tails: all methods on many scenarios of some splits, and what their costs and errors come to."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.engines.options import LOCAL, Engine
from baselines.tools.files import require_writable
from baselines.tools.provenance import command_line
from beltarm_env.arm import params_columns
from beltarm_env.metrics import NOT_ARRIVED, OF_ARRIVED
from beltarm_env.task.moves import MOVE_FIELDS
from eval.comparison import protocol
from eval.comparison.failures import Failure
from eval.comparison.methods import Method
from eval.comparison.pairs import LEFT
from eval.comparison.results import provenance
from eval.comparison.scenarios import require_same_physics
from eval.comparison.sets import MOST, SetLabel, development_set, fresh_scenarios
from eval.comparison.splits import EPISODES, Split
from eval.comparison.statistics import interquartile_mean
from eval.tails.estimates import Against, Interval, Tail, Unlike, against, share_of, tail_of, tail_size, unlike
from eval.tails.shards import METRICS, NOT_SETTLED, Shard, merged, policy_of, run_shards, seconds_of, shards_of

Floats = NDArray[np.float64]
DRAWN = ("cost", "tip_max_mm")
"""Metrics of which a picture shows the distribution."""
CASES = 5
"""Worst scenarios that are named."""
_POINTS = 400  # of a drawn distribution
_USUAL = 10_000  # scenarios that say how arms are distributed


class Case(NamedTuple):
    """One scenario of a method."""

    scenario: int
    policy: int  # which of the method's policies plays it
    cost: float
    tip_max_mm: float
    start: float  # of the move [rad]
    goal: float


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a method came to on a split."""

    method: Method
    tails: dict[str, Tail]  # by metric; those of `OF_ARRIVED` over the scenarios in which the arm arrives
    few: Tail  # of the cost, from the first `EPISODES` scenarios alone
    policies: list[Tail]  # of the cost, by policy; empty where there is one
    not_settled: Interval
    not_arrived: Interval
    left: Interval
    curves: dict[str, tuple[Floats, Floats]]  # by metric: values, and in what share of scenarios they are reached
    worst: list[Case]
    unlike: list[Unlike]  # by what the arms and moves of the tail are told from all
    against: Against | None  # the best classical method; None for itself, or where there is none
    seconds: float  # of processor time


@dataclass(frozen=True, slots=True)
class Study:
    """Outcomes of all methods that came through, by split."""

    number: int  # of the fresh set
    episodes: int  # scenarios per split
    outcomes: dict[str, list[Outcome]]
    failures: list[Failure]
    provenance: dict[str, Any]

    @property
    def note(self) -> str:
        """What its numbers are worth."""
        return SetLabel(f"seed {self.number}", "").note


def check_options(options: Any) -> None:
    """Check the options of `eval/compare.py` that depend on the number of scenarios.

    Raises:
        ValueError: If there are not so many scenarios, saying where there are more, or not for what is asked of them.
    """
    if options.episodes is None:
        return
    most = EPISODES if options.scenario_seed is None else MOST
    if not 4 <= options.episodes <= most:
        more = f"; --scenario-seed 1 draws as many as you want, up to {MOST}" if EPISODES < options.episodes else ""
        raise ValueError(
            f"--episodes must lie within 4 and {most}, got {options.episodes}{more if most < MOST else ''}"
        )
    for name in ("maps", "computing_time"):
        if options.episodes > EPISODES and getattr(options, name):
            raise ValueError(
                f"--{name.replace('_', '-')} is for up to {EPISODES} scenarios, got --episodes {options.episodes}: "
                "leave one of them out"
            )


def study(
    methods: Sequence[Method],
    splits: Sequence[str],
    number: int,
    episodes: int,
    folder: Path,
    jobs: int | None,
    *,
    engine: Engine = LOCAL,
    fresh: bool = False,
    done: Callable[[int, int], object] = lambda *_: None,
) -> Study:
    """Run methods on the first scenarios of some splits of a fresh set, and estimate their tails.

    Args:
        methods: See `eval.comparison.run.choose_methods`.
        splits: Their names.
        number: Of the fresh set.
        episodes: Scenarios per split.
        folder: Where results are kept, see `eval.tails.shards`.
        jobs: Number of processes, by default one per core.
        engine: What runs them.
        fresh: Whether to run everything again.
        done: Called with the number of shards that are there, and of all.

    Raises:
        OSError: If the folder cannot be written to, or a process was killed.
        ValueError: If the results of a method cannot be kept, the arms do not move as they did when the development set
            was drawn, or no method could be run.
        KeyboardInterrupt: On Ctrl-C, with a message about the shards that are kept.
    """
    began = time.perf_counter()
    for method in methods:
        if method.identity is None:
            raise ValueError(
                f"results of {method.name} cannot be kept, as more than {EPISODES} scenarios have to be: its files are "
                "too large to be hashed, or cannot be read"
            )
    require_writable(folder)
    require_same_physics(development_set().only(splits))
    unsound = protocol.failures(methods)
    sound = [one for one in methods if one.name not in unsound]
    shards = {(split, one.name): shards_of(one, split, number, episodes) for split in splits for one in sound}
    in_turn = sorted((shard for some in shards.values() for shard in some), key=lambda shard: shard.first)
    if fresh:
        for shard in in_turn:
            shard.file(folder).unlink(missing_ok=True)
    kept = sum(shard.file(folder).exists() for shard in in_turn)
    failures = [replace(failure, split=split) for failure in unsound.values() for split in splits]
    failures += run_shards(in_turn, folder, jobs, done, engine)
    failed = {(failure.method, failure.split) for failure in failures}
    outcomes: dict[str, list[Outcome]] = {}
    for split in splits:
        done_all = [shards[split, one.name] for one in sound if (one.name, split) not in failed]
        outcomes[split] = _outcomes(done_all, folder)
    if not any(outcomes.values()):
        first = failures[0]
        error = ValueError(f"no method could be run: {first.method} on {first.split}: {first.message}")
        error.add_note(first.trace)
        raise error
    origin = provenance(command_line(), time.perf_counter() - began, methods, {}) | {"shards_kept_before": kept}
    return Study(number, episodes, outcomes, failures, origin)


def _outcomes(shards: list[list[Shard]], folder: Path) -> list[Outcome]:
    """Outcomes of all methods on one split, from the shards of each."""
    if not shards:
        return []
    first = shards[0][0]
    usual = _quantities(fresh_scenarios(first.number, first.split, range(min(_USUAL, _count(shards[0])))))
    classical = [some for some in shards if some[0].method.kind == "classical"]
    best = min(classical, key=lambda some: interquartile_mean(merged(some, folder, "cost")), default=None)
    opponent = merged(best, folder, "cost") if best else None
    return [_outcome(some, folder, usual, None if some is best else opponent) for some in shards]


def _count(shards: list[Shard]) -> int:
    return shards[-1].first + shards[-1].count


def _outcome(shards: list[Shard], folder: Path, usual: dict[str, Floats], opponent: Floats | None) -> Outcome:
    """Outcome of one method on one split, metric by metric."""
    method, number, split = shards[0].method, shards[0].number, shards[0].split
    tails: dict[str, Tail] = {}
    curves: dict[str, tuple[Floats, Floats]] = {}
    away = merged(shards, folder, NOT_ARRIVED) > 0
    for name in METRICS:
        values = merged(shards, folder, name)
        if name in OF_ARRIVED:
            values = values[~away]
        tails[name] = tail_of(values)
        if name in DRAWN:
            curves[name] = exceedance(values)
    cost, largest = merged(shards, folder, "cost"), merged(shards, folder, "tip_max_mm")
    order = np.argsort(-cost, kind="stable")[: max(CASES, tail_size(len(cost)))]
    tail = fresh_scenarios(number, split, order[: tail_size(len(cost))].tolist())
    named = fresh_scenarios(number, split, order[:CASES].tolist())
    policies = len(method.sources)
    return Outcome(
        method,
        tails,
        tail_of(cost[:EPISODES]),
        [tail_of(cost[policy::policies]) for policy in range(policies)] if policies > 1 else [],
        share_of(merged(shards, folder, NOT_SETTLED) > 0),
        share_of(away),
        share_of(merged(shards, folder, LEFT) > 0),
        curves,
        [
            Case(k, policy_of(k, method), float(cost[k]), float(largest[k]), float(move[0]), float(move[1]))
            for k, move in zip(order[:CASES].tolist(), named.moves, strict=True)
        ],
        unlike(_quantities(tail), usual),
        None if opponent is None else against(cost, opponent),
        seconds_of(shards, folder),
    )


def exceedance(values: Floats) -> tuple[Floats, Floats]:
    """Values from the least to the largest, and the share of all that reaches each; equally spread in its logarithm."""
    ordered = np.sort(values)
    ranks = np.unique(np.geomspace(1, len(values), _POINTS).round().astype(np.intp))[::-1]
    return ordered[-ranks], ranks / len(values)


def _quantities(split: Split) -> dict[str, Floats]:
    """What tells scenarios of a split from one another, by name: constants, moves, delays; shape (n,) each."""
    moves = dict(zip(MOVE_FIELDS, split.moves.T, strict=True))
    length = {"length of the move": np.abs(moves["goal"] - moves["start"])}
    return {**params_columns(split.table), **moves, **length, "delay": split.delays}
