"""Cache of a comparison: parts that are kept on disk, and the processes that run the others.

A part is a method on some scenarios in a row of a split. It is kept as
`parts/SET.SPLIT.METHOD.FIRST-COUNT.KEY.safetensors`, with a key of everything that its numbers depend on: edition and
scenarios, the method's gains, policies or sources, the code, and the versions of the packages below it. Each file ends
in its SHA-256: one that is damaged, or was changed by hand, is run again.
"""

import platform
import re
from collections.abc import Callable, Hashable, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from functools import cache, partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

import agents
import baselines
import beltarm_env
from baselines.engines import parallel
from baselines.optimal import robust
from baselines.tools.files import read_arrays, sha256_of, write_arrays
from beltarm_env.arm import NOMINAL
from beltarm_env.arrays import Flags, Floats, Integers, Singles
from beltarm_env.metrics import METRICS
from beltarm_env.rollout import Controller, Recording, nominal_params, nominal_profile, rollout
from beltarm_env.sources import sources_digest
from eval.comparison.carrying import Carried
from eval.comparison.custom import PARTS
from eval.comparison.methods import LARGEST_BATCH, Method
from eval.comparison.rollouts import Failure, attempt, changed, explained, run_controller
from eval.comparison.splits import EDITION, EPISODES, VERSION, Split, digest_of, side_by_side

Metrics = dict[str, Floats]
"""Of a method on a split: for each metric a table of shape (seeds, episodes)."""
LEFT = "left_workspace"
"""Beside the metrics: 1 where the arm left the workspace."""
SENSITIVE = "sensitive"
"""Of perturbed parts, beside the metrics: 1 where the cost changes, see `sensitive`."""
_PACKAGES = ("numpy", "ziglang", "scipy", "gymnasium")
"""Packages whose version the numbers may depend on."""


@dataclass(frozen=True, slots=True)
class Part:
    """A method on the first `count` scenarios of `split`."""

    method: Method
    split: Split
    count: int
    first: int = 0  # number that the split's first scenario has in its set
    perturbed: bool = False  # whether each scenario is run once more, perturbed

    @property
    def tables(self) -> tuple[str, ...]:
        """Names of the tables that are kept."""
        return (*METRICS, LEFT, *([SENSITIVE] if self.perturbed else []))

    @property
    def runs(self) -> int:
        """Number of moves that are simulated."""
        moves = len(self.split.tables)
        return len(self.method.sources) * self.count * moves * (2 if self.perturbed else 1)

    def file(self, folder: Path) -> Path:
        """File of its results, named by a key of everything that they depend on."""
        method, split = self.method, self.split
        content = [EDITION, VERSION, split.of, split.digest, self.count, method.name, method.kind, method.identity]
        return folder / PARTS / f"{self.stem}.{digest_of([*content, _code()])[:16]}.safetensors"

    @property
    def stem(self) -> str:
        """Beginning of the file's name, before the key."""
        method = re.sub(r"[^\w-]", "_", self.method.name)
        return f"{self.split.of.replace(' ', '-')}.{self.split.name}.{method}.{self.first}-{self.count}"


def parts_of(method: Method, split: Split, episodes: int, perturbed: bool = False) -> list[Part]:
    """Cut the first scenarios of a split into parts of at most `EPISODES`."""
    if episodes <= EPISODES:
        return [Part(method, split, episodes, perturbed=perturbed)]
    cuts = [slice(first, min(first + EPISODES, episodes)) for first in range(0, episodes, EPISODES)]
    return [Part(method, split.part(cut), cut.stop - cut.start, cut.start, perturbed) for cut in cuts]


@cache
def _code() -> list[str]:
    """SHA-256 of the code of plant, controllers, policies and comparison, and of kept gains; versions of packages."""
    packages = (beltarm_env, baselines, agents)
    sources = sources_digest(*(Path(package.__path__[0]) for package in packages), Path(__file__).parent)
    kept = sha256_of(robust.FILE)
    return [sources, kept, platform.python_version(), *(f"{name} {version(name)}" for name in _PACKAGES)]


def measure(part: Part) -> Metrics:
    """Run all controllers of a method on the scenarios of a part."""
    return measure_together([part])[0]


def measure_together(parts: Sequence[Part]) -> list[Metrics]:
    """Run all controllers of a method on parts whose splits run beside one another, as `measure` does on each."""
    method, counts = parts[0].method, [part.count for part in parts]
    scenarios, count = side_by_side([(part.split, slice(part.count)) for part in parts]), sum(counts)
    metrics = {name: np.empty((len(method.sources), count)) for name in parts[0].tables}
    arms = scenarios.arms(slice(count)) if method.kind == "privileged" else []
    model = scenarios.settings.get("model", "lumped")
    for seeds in method.batches(count):
        rows = np.tile(np.arange(count), len(seeds))
        arguments = scenarios.arguments(rows)
        run = rollout(method.controllers(seeds, *arms, model=model), len(rows), sensors=method.sensors, **arguments)
        require_these_arms(run, scenarios, rows)
        tables = {name: run.over_moves(values) for name, values in run.metrics().items()}
        tables[LEFT] = np.where(run.stayed, 0.0, 1.0)
        if parts[0].perturbed:
            again = Perturbed(method.controllers(seeds, *arms, model=model))
            cost = rollout(again, len(rows), sensors=method.sensors, **arguments).cost
            tables[SENSITIVE] = sensitive(tables["cost"], run.over_moves(cost))
        for name, values in tables.items():
            metrics[name][seeds] = values.reshape(len(seeds), count)
    ends = np.cumsum(counts)[:-1]
    pieces = {name: np.split(table, ends, axis=1) for name, table in metrics.items()}
    return [{name: piece[k].copy() for name, piece in pieces.items()} for k in range(len(parts))]


def require_these_arms(run: Recording, scenarios: Split, rows: Integers) -> None:
    """Check that a run had the arms and moves of its scenarios, which it drew on the way if they are shifts.

    Moves after that in which an arm left its workspace were not run.

    Raises:
        ValueError: If one is another.
    """
    begun = np.ones((run.num_moves, len(rows)), np.bool_)
    begun[1:] = run.finished.reshape(run.num_moves, -1)[:-1]
    of_run = run.params[begun.ravel()], run.moves[begun.ravel()]
    wanted = scenarios.tables[:, rows][begun], scenarios.all_moves[:, rows][begun]
    if not all(map(np.array_equal, of_run, wanted)):
        raise ValueError(f"the arms that were run are not those of the scenarios of {scenarios.of or 'this split'}")


def read_kept(part: Part, folder: Path) -> Metrics | None:
    """Read the results of a part; None if there are none, or damaged ones, which are removed."""
    if part.method.identity is None:
        return None
    path, shape = part.file(folder), (len(part.method.sources), part.count)
    with suppress(OSError, ValueError, KeyError):
        kept = read_arrays(path)
        metrics = {name: kept[name] for name in part.tables}
        if all(t.shape == shape and t.dtype == np.float64 and np.isfinite(t).all() for t in metrics.values()):
            return metrics
    path.unlink(missing_ok=True)
    return None


def keep(part: Part, folder: Path, metrics: Metrics) -> Metrics | Failure:
    """Keep results of a part in place of those of other code, gains or policies; not if its identity is unknown.

    Returns them, or a failure if the method's files changed.

    Raises:
        OSError: If they cannot be written.
    """
    if part.method.identity is None:
        return metrics
    if failure := changed(part.method, part.split.name):
        return failure
    current = part.file(folder)
    write_arrays(current, metrics)
    for path in current.parent.glob(f"{part.stem}.*"):
        if path != current:
            path.unlink(missing_ok=True)
    return metrics


def run_parts(
    parts: Sequence[Part],
    folder: Path,
    options: parallel.SideBySide,
    done: Callable[[int, int], object] = lambda *_: None,
) -> list[Metrics | Failure]:
    """Return the results of all parts, in their order: kept ones are read, the others run, and kept by this process.

    `done` is called with the number of parts that are there, and of all.

    Raises:
        OSError: If a result cannot be written, or a part broke off its process again and again.
        KeyboardInterrupt: On Ctrl-C, with a message about the parts that are kept.
    """
    kept = enumerate(read_kept(part, folder) for part in parts)
    results: dict[int, Metrics | Failure] = {k: metrics for k, metrics in kept if metrics is not None}
    done(len(results), len(parts))
    tasks = _tasks(parts, [k for k in range(len(parts)) if k not in results])
    methods = {parts[task[0]].method.name: parts[task[0]].method for task in tasks}
    belongings = {name: {} if options.engine == "local" else method.belongings() for name, method in methods.items()}
    left = {
        str(number): partial(_run_task, [parts[k] for k in task], belongings[parts[task[0]].method.name])
        for number, task in enumerate(tasks)
    }
    try:
        with closing(parallel.run_side_by_side(left, options)) as fresh:
            for number, measured in fresh:
                if isinstance(measured, parallel.Failure):
                    raise explained(measured, options.jobs)
                for k, result in zip(tasks[int(number)], measured, strict=True):
                    results[k] = result if isinstance(result, Failure) else keep(parts[k], folder, result)
                    done(len(results), len(parts))
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"interrupted: {kept_count(parts, folder)} of {len(parts)} parts are kept in {folder}; the same command "
            "continues from there"
        ) from None
    return [results[k] for k in range(len(parts))]


def kept_count(parts: Sequence[Part], folder: Path) -> int:
    """Return the number of parts that have a file."""
    return sum(part.file(folder).exists() for part in parts)


def _tasks(parts: Sequence[Part], left: list[int]) -> list[list[int]]:
    """Group the parts that are left: few arms of a method, on splits that run beside one another; most runs come first.

    A user's controller runs alone, so that its failure affects nothing else.
    """

    def runs(task: list[int]) -> int:
        return sum(parts[k].runs for k in task)

    groups: dict[Hashable, list[list[int]]] = {}
    for k in left:
        method, split = parts[k].method, parts[k].split
        alike = k if method.kind == "added" else (method.name, method.sources, parts[k].perturbed, split.kind_of_batch)
        tasks = groups.setdefault(alike, [])
        task = next((task for task in tasks if runs([*task, k]) <= LARGEST_BATCH), None)
        if task is None:
            tasks.append([k])
        else:
            task.append(k)
    return sorted((task for tasks in groups.values() for task in tasks), key=lambda task: -runs(task))


def _run_task(parts: list[Part], belongings: dict[str, Carried], _: parallel.Channel) -> list[Metrics | Failure]:
    there = [replace(part, method=part.method.at(belongings)) for part in parts]
    if len(there) > 1:
        together = attempt(there[0].method.name, "", partial(measure_together, there))
        if not isinstance(together, Failure):
            return list(together)
    return [run_controller(part.method, part.split.name, partial(measure, part)) for part in there]


# Perturbed episodes

PERTURBATION = 1e-9
"""Difference of the first torque in a perturbed episode [N m]."""
CHANGE = 0.01
"""Share of its cost by which an episode has to change to count as sensitive."""


class Perturbed:
    """Controller whose first torques differ by `PERTURBATION`.

    Whether a motor sticks is decided by a hair, and what follows is another motion. Where a controller and its arm
    amplify such a difference, a single episode says little, and on a real arm the same move is not made twice.
    """

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self.params, self.profile = nominal_params(controller), nominal_profile(controller)
        self._difference = PERTURBATION / (self.params or NOMINAL).torque_limit

    def predict(
        self, observation: Singles, state: Any = None, episode_start: Flags | None = None, deterministic: bool = True
    ) -> tuple[Any, tuple[Any]]:
        """Torques over their limit, shape (n, 1); the first in double precision, which holds the difference."""
        own = None if state is None else state[0]
        action, following = self._controller.predict(observation, own, episode_start, deterministic=deterministic)
        if state is None:
            first = np.clip(action.astype(np.float64), -1, 1)
            action = np.where(first > 0, first - self._difference, first + self._difference)  # within the limits
        return action, (following,)


def sensitive(cost: Floats, perturbed: Floats) -> Floats:
    """1.0 where the costs of an episode and of the perturbed one differ by more than `CHANGE`, else 0.0."""
    return (np.abs(perturbed - cost) > CHANGE * cost).astype(np.float64)
