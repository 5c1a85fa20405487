"""Runs of the comparison: a method on a split is a pair; pairs are spread over processes, and kept on disk.

A pair that is done is kept as `pairs/SET.SPLIT.METHOD.EPISODES.KEY.npz`, with a key of everything that its numbers
depend on: edition and scenarios, the method's gains, policies or sources, the code of plant and controllers, and the
versions of the packages below them. A run that was interrupted, or that asks for more, goes on from what is kept. Each
file ends in its SHA-256: one that is damaged, or was changed by hand, is run again.
"""

from __future__ import annotations

import hashlib
import json
import platform
import re
from collections.abc import Callable, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cache, partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import agents
import baselines
import beltarm_env
from baselines.engines import parallel
from baselines.engines.carrying import Carried
from baselines.optimal import kept as kept_gains
from baselines.tools.files import read_arrays, sha256_of, write_arrays
from beltarm_env.arm import NOMINAL
from beltarm_env.arrays import Flags, Floats, Singles
from beltarm_env.metrics import METRICS
from beltarm_env.rollout import Controller, Recording, nominal_params, rollout
from beltarm_env.sources import sources_digest
from eval.comparison.failures import Failure, attempt, explained, run_controller
from eval.comparison.methods import LARGEST_BATCH, Method
from eval.comparison.splits import EDITION, VERSION, Split, side_by_side

Metrics = dict[str, NDArray[np.float64]]
"""Of a method on a split: for each metric a table of shape (seeds, episodes)."""
LEFT = "left_workspace"
"""Beside the metrics: 1 where the arm left the workspace."""
SENSITIVE = "sensitive"
"""Of nudged pairs, beside the metrics: 1 where an episode is another one after a nudge."""
NUDGE = 1e-9
"""By how much a first torque differs in a nudged episode [N m]."""
CHANGE = 0.01
"""Share of its cost by which an episode has to change to count as another one."""
_PACKAGES = ("numpy", "numba", "scipy", "torch", "gymnasium")
"""Packages whose version the numbers may depend on."""


@dataclass(frozen=True, slots=True)
class Pair:
    """A method on the first scenarios of a split."""

    method: Method
    split: Split
    episodes: int
    nudged: bool = False  # whether each scenario is run once more, see `Nudged`

    @property
    def tables(self) -> tuple[str, ...]:
        """Names of all that is measured."""
        return (*METRICS, LEFT, *([SENSITIVE] if self.nudged else []))

    @property
    def runs(self) -> int:
        """Number of runs of a controller."""
        return len(self.method.sources) * (2 if self.nudged else 1)

    def file(self, folder: Path) -> Path:
        """File of its results, named by a key of everything that they depend on."""
        key = key_of(self.method, EDITION, VERSION, self.split.of, self.split.digest, self.episodes)
        return folder / "pairs" / f"{self.stem}.{key}.npz"

    @property
    def stem(self) -> str:
        """Beginning of the file's name, before the key."""
        method = re.sub(r"[^\w-]", "_", self.method.name)
        return f"{self.split.of.replace(' ', '-')}.{self.split.name}.{method}.{self.episodes}"


def key_of(method: Method, *others: str | int) -> str:
    """Hash of everything that a method depends on, and of what else is given."""
    content = [*others, method.name, method.kind, method.identity, _code()]
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()[:16]


@cache
def _code() -> list[str]:
    """SHA-256 of the code of plant, controllers and policies and of kept gains; versions of the packages below it."""
    sources = sources_digest(*(Path(package.__path__[0]) for package in (beltarm_env, baselines, agents)))
    kept = sha256_of(kept_gains.FILE) if kept_gains.FILE.exists() else ""
    return [sources, kept, platform.python_version(), *(f"{name} {version(name)}" for name in _PACKAGES)]


class Nudged:
    """Controller whose first torques differ by `NUDGE`, to see whether its episodes are the same ones again.

    Whether a motor sticks is decided by a hair, and what follows is another motion. Where a controller and its arm make
    much of such a difference, a single episode says little, and on a real arm the same move is not made twice.

    Args:
        controller: Whose torques they are.
    """

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self.params = nominal_params(controller)
        self._nudge = NUDGE / (self.params or NOMINAL).torque_limit

    def predict(
        self,
        observation: Singles,
        state: tuple[Any] | None = None,
        episode_start: Flags | None = None,
        deterministic: bool = True,
    ) -> tuple[Any, tuple[Any]]:
        """Torques over their limit, shape (n, 1): at the first sample in double precision, which holds the nudge."""
        own = None if state is None else state[0]
        action, following = self._controller.predict(observation, own, episode_start, deterministic)
        if state is None:
            first = np.clip(action.astype(np.float64), -1, 1)
            action = np.where(first > 0, first - self._nudge, first + self._nudge)  # within the limits
        return action, (following,)


def measure(pair: Pair) -> Metrics:
    """Run all controllers of a method on the scenarios of a split."""
    (metrics,) = measure_together([pair])
    return metrics


def measure_together(pairs: Sequence[Pair]) -> list[Metrics]:
    """Run all controllers of a method on the scenarios of splits that run beside one another, as `measure` on each."""
    first, counts = pairs[0], [pair.episodes for pair in pairs]
    scenarios, count = side_by_side([(pair.split, slice(pair.episodes)) for pair in pairs]), sum(counts)
    metrics = {name: np.empty((len(first.method.sources), count)) for name in first.tables}
    for seeds in first.method.batches(count):
        run = _run(first.method, seeds, scenarios)
        found = {**run.metrics(), LEFT: 1.0 - run.finished}
        if first.nudged:
            found[SENSITIVE] = _moved(run.cost, _run(first.method, seeds, scenarios, Nudged).cost)
        for name, values in found.items():
            metrics[name][seeds] = values.reshape(len(seeds), count)
    ends = np.cumsum(counts)[:-1]
    parts = {name: np.split(table, ends, axis=1) for name, table in metrics.items()}
    return [{name: part[k].copy() for name, part in parts.items()} for k in range(len(pairs))]


def _run(
    method: Method, seeds: range, scenarios: Split, wrapped: Callable[[Controller], Controller] = lambda of: of
) -> Recording:
    """Run the controllers of some training seeds, each on all scenarios, in one batch."""
    count = len(scenarios.table)
    rows = np.tile(np.arange(count), len(seeds))
    controller = wrapped(method.controllers(seeds, scenarios.arms(count)))
    return rollout(controller, len(rows), sensors=method.sensors, **scenarios.arguments(rows))


def _moved(cost: Floats, nudged: Floats) -> Floats:
    """1.0 where the cost of an episode and of the nudged one differ by more than `CHANGE`, else 0.0."""
    return (np.abs(nudged - cost) > CHANGE * cost).astype(np.float64)


def read_kept(pair: Pair, folder: Path) -> Metrics | None:
    """Read the results of a pair; None if there are none, or damaged ones."""
    if pair.method.identity is None:
        return None
    path = pair.file(folder)
    shape = (len(pair.method.sources), pair.episodes)
    try:
        metrics = read_arrays(path, pair.tables)
    except FileNotFoundError:
        return None
    except (OSError, ValueError):
        path.unlink(missing_ok=True)  # damaged, or changed since: run again
        return None
    return metrics if all(table.shape == shape for table in metrics.values()) else None


def keep(pair: Pair, folder: Path, metrics: Metrics) -> None:
    """Keep the results of a pair, unless its method's identity is unknown.

    Raises:
        OSError: If they cannot be written.
    """
    if pair.method.identity is None:
        return
    current = pair.file(folder)
    write_arrays(current, metrics)
    for path in current.parent.glob(f"{pair.stem}.*.npz"):
        if path != current:  # of other code, gains or policies
            path.unlink(missing_ok=True)


def run_pairs(
    pairs: list[Pair],
    folder: Path,
    jobs: int | None,
    done: Callable[[Pair], object],
    engine: parallel.Engine = parallel.LOCAL,
) -> list[Metrics | Failure]:
    """Results of all pairs, in their order: those that are kept are read, the others run, and kept by this process.

    Args:
        pairs: What to run.
        folder: Where to keep it.
        jobs: Number of processes, by default one per core.
        done: Called as each pair is there.
        engine: What runs the pairs.

    Raises:
        OSError: If a result cannot be written, or a pair broke off its process again and again.
    """
    results: dict[int, Metrics | Failure] = {}
    for k, pair in enumerate(pairs):
        kept = read_kept(pair, folder)
        if kept is not None:
            results[k] = kept
            done(pair)
    tasks = _tasks(pairs, [k for k in range(len(pairs)) if k not in results])
    sent = sent_along((pairs[task[0]].method for task in tasks), engine)
    left = {
        str(number): partial(_run_task, [pairs[k] for k in task], sent[pairs[task[0]].method.name])
        for number, task in enumerate(tasks)
    }
    with closing(parallel.run_side_by_side(left, jobs, engine=engine)) as fresh:
        for number, found in fresh:
            if isinstance(found, parallel.Failure):
                raise explained(found, jobs)
            for k, result in zip(tasks[int(number)], found, strict=True):
                if not isinstance(result, Failure):
                    keep(pairs[k], folder, result)
                results[k] = result
                done(pairs[k])
    return [results[k] for k in range(len(pairs))]


def _tasks(pairs: list[Pair], left: list[int]) -> list[list[int]]:
    """Group the pairs that are left into tasks: few arms of a method, on splits that run beside one another.

    Those with most runs come first, so that none is left over at the end.
    """
    tasks: list[list[int]] = []
    for k in left:
        task = next((task for task in tasks if _fits([pairs[other] for other in task], pairs[k])), None)
        if task is None:
            tasks.append([k])
        else:
            task.append(k)
    return sorted(tasks, key=lambda task: -sum(pairs[k].runs * pairs[k].episodes for k in task))


def _fits(task: list[Pair], pair: Pair) -> bool:
    """Whether a pair runs in a batch with others; an added controller's does not, whose failures are its own."""
    first = task[0]
    alike = pair.method == first.method and pair.nudged == first.nudged and pair.split.runs_beside(first.split)
    arms = sum(other.runs * other.episodes for other in [*task, pair])
    return alike and pair.method.kind != "added" and arms <= LARGEST_BATCH


def sent_along(methods: Iterable[Method], engine: parallel.Engine) -> dict[str, dict[str, Carried]]:
    """Belongings of methods, by name, that tasks take with them to other machines."""
    by_name = {method.name: method for method in methods}
    return {name: {} if engine.name == "local" else method.belongings() for name, method in by_name.items()}


def _run_task(pairs: list[Pair], belongings: dict[str, Carried], _: parallel.Channel) -> list[Metrics | Failure]:
    there = [replace(pair, method=pair.method.at(belongings)) for pair in pairs]
    if len(there) > 1:
        together = attempt(there[0].method.name, "", partial(measure_together, there))
        if not isinstance(together, Failure):
            return list(together)
    return [run_controller(pair.method, pair.split.name, partial(measure, pair)) for pair in there]
