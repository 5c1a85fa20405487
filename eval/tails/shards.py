"""Shards: up to a thousand scenarios of a method on a split, which a worker draws and runs, each kept as one file.

A shard is kept as `shards/SET.SPLIT.METHOD/FIRST-COUNT.KEY.npz`, with a key of everything that its numbers depend on
(`eval.comparison.pairs.key_of`). A run that was interrupted, or that asks for more scenarios, goes on from what is
kept.

A learned method has several policies. Each scenario is played by one of them, scenario i by policy i modulo their
number. So all scenarios of a method are independent of one another, as its intervals take them to be.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import astuple, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from baselines.engines import parallel
from baselines.engines.carrying import Carried
from baselines.tools.files import read_arrays, write_arrays
from beltarm_env.metrics import NOT_ARRIVED, TORQUE_QUALITY
from eval.comparison.failures import Failure, explained, run_controller
from eval.comparison.methods import Method
from eval.comparison.pairs import LEFT, Pair, key_of, measure, sent_along
from eval.comparison.sets import fresh_scenarios
from eval.comparison.splits import EDITION, SPLITS, VERSION, digest_of

Floats = NDArray[np.float64]
SIZE = 1000
"""Scenarios of a shard; the last one of a split may have fewer."""
BATCH = 250
"""Scenarios that run side by side at most: more take more memory and are no faster."""
NOT_SETTLED = "failure_share"
METRICS = ("cost", "tip_rms_mm", "tip_max_mm", "residual_pp_mm", "settling_s", *TORQUE_QUALITY)
KEPT = (*METRICS, NOT_SETTLED, NOT_ARRIVED, LEFT)
"""What is kept of each scenario."""
SECONDS = "cpu_seconds"
"""Beside it: processor time of the shard."""
Tables = dict[str, Floats]
"""For each of `KEPT` the values of a shard, shape (count,); and `SECONDS`, shape ()."""


@dataclass(frozen=True, slots=True)
class Shard:
    """Some scenarios in a row of a split of a fresh set, and the method that plays them."""

    method: Method
    split: str
    number: int  # of the fresh set
    first: int  # scenario
    count: int

    def file(self, folder: Path) -> Path:
        """File of its results, named by a key of everything that they depend on."""
        definition = digest_of(astuple(SPLITS[self.split]))
        key = key_of(self.method, EDITION, VERSION, self.number, self.split, definition, self.first, self.count)
        method = re.sub(r"[^\w-]", "_", self.method.name)
        return folder / "shards" / f"seed-{self.number}.{self.split}.{method}" / f"{self.stem}.{key}.npz"

    @property
    def stem(self) -> str:
        """Beginning of the file's name, before the key."""
        return f"{self.first:07}-{self.count}"


def shards_of(method: Method, split: str, number: int, episodes: int) -> list[Shard]:
    """Cut the first scenarios of a split of a fresh set into shards."""
    firsts = range(0, episodes, SIZE)
    return [Shard(method, split, number, first, min(SIZE, episodes - first)) for first in firsts]


def policy_of(scenario: int, method: Method) -> int:
    """Return which of a method's policies plays a scenario; 0 for a classical controller."""
    return scenario % len(method.sources)


def run(shard: Shard) -> Tables:
    """Draw the scenarios of a shard and run them, in batches."""
    began = time.process_time()
    split = fresh_scenarios(shard.number, shard.split, range(shard.first, shard.first + shard.count))
    policies = len(shard.method.sources)
    batches = policies * -(-shard.count // (policies * BATCH))
    tables = {name: np.empty(shard.count) for name in KEPT}
    for k in range(min(batches, shard.count)):
        part = slice(k, None, batches)  # of one policy, since `batches` is a multiple of their number
        method = replace(shard.method, sources=(shard.method.sources[policy_of(shard.first + k, shard.method)],))
        arms = replace(split, table=split.table[part], moves=split.moves[part], delays=split.delays[part])
        found = measure(Pair(method, arms, len(arms.table)))
        for name in KEPT:
            tables[name][part] = found[name][0]
    return {**tables, SECONDS: np.array(time.process_time() - began)}


def keep(shard: Shard, tables: Tables, folder: Path) -> None:
    """Write the results of a shard, in place of those of other code, gains or policies.

    Raises:
        OSError: If they cannot be written.
    """
    current = shard.file(folder)
    write_arrays(current, tables)
    for path in current.parent.glob(f"{shard.stem}.*.npz"):
        if path != current:
            path.unlink(missing_ok=True)


def is_kept(shard: Shard, folder: Path) -> bool:
    """Whether the results of a shard are there and sound; damaged ones are removed."""
    path = shard.file(folder)
    try:
        found = read_arrays(path, (*KEPT, SECONDS))
        sound = all(found[name].shape == (shard.count,) for name in KEPT)
    except FileNotFoundError:
        return False
    except (OSError, ValueError):
        sound = False
    if not sound:
        path.unlink(missing_ok=True)
    return sound


def merged(shards: Sequence[Shard], folder: Path, name: str) -> Floats:
    """One metric of all scenarios of some shards in a row, shape (episodes,): only this one is in memory."""
    return np.concatenate([read_arrays(shard.file(folder), [name])[name] for shard in shards])


def seconds_of(shards: Sequence[Shard], folder: Path) -> float:
    """Processor time that some shards took [s]."""
    return float(sum(read_arrays(shard.file(folder), [SECONDS])[SECONDS] for shard in shards))


def run_shards(
    shards: Sequence[Shard],
    folder: Path,
    jobs: int | None,
    done: Callable[[int, int], object] = lambda *_: None,
    engine: parallel.Engine = parallel.LOCAL,
) -> list[Failure]:
    """Run all shards that are not kept, and keep them as they come.

    Args:
        shards: What to run.
        folder: Where to keep it.
        jobs: Number of processes, by default one per core.
        done: Called with the number of shards that are there, and of all.
        engine: What runs the shards.

    Returns:
        What failed: one entry for each method and split.

    Raises:
        OSError: If a result cannot be written, or a shard broke off its process twice.
        KeyboardInterrupt: On Ctrl-C, with a message about the shards that are kept.
    """
    waiting = {str(k): shard for k, shard in enumerate(shards) if not is_kept(shard, folder)}
    sent = sent_along((shard.method for shard in waiting.values()), engine)
    left = {name: partial(_task, shard, sent[shard.method.name]) for name, shard in waiting.items()}
    there = len(shards) - len(left)
    failures: dict[tuple[str, str], Failure] = {}
    done(there, len(shards))
    try:
        with closing(parallel.run_side_by_side(left, jobs, engine=engine)) as fresh:
            for name, result in fresh:
                if isinstance(result, parallel.Failure):
                    raise explained(result, jobs)
                if isinstance(result, Failure):
                    failures.setdefault((result.method, result.split), result)
                else:
                    keep(shards[int(name)], result, folder)
                there += 1
                done(there, len(shards))
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"interrupted: {there} of {len(shards)} shards are done, and kept in {folder}; the same command continues "
            "from there"
        ) from None
    return list(failures.values())


def _task(shard: Shard, belongings: dict[str, Carried], _: parallel.Channel) -> Tables | Failure:
    there = replace(shard, method=shard.method.at(belongings))
    return run_controller(there.method, shard.split, partial(run, there))
