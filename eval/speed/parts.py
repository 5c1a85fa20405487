"""Where the time of a batch's step goes, in nanoseconds per arm, and how long it would take a core at its best."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from rich.table import Table

from beltarm_env import BeltArmVectorEnv
from beltarm_env.arrays import Floats, Singles
from beltarm_env.jit import compiled
from beltarm_env.kernels.advance import advance_block
from beltarm_env.kernels.advance_driven import DRIVEN_WORK_ROWS, advance_driven_block
from beltarm_env.kernels.layout import IDEAL, LANES, Driven, aligned_zeros
from beltarm_env.kernels.observe import observe_arms
from beltarm_env.kernels.sense import sense_block
from beltarm_env.kernels.step import charge
from beltarm_env.kernels.tile import transpose
from beltarm_env.observation import ENCODER, size
from beltarm_env.physics.models import LUMPED
from beltarm_env.task.ranges import Randomization
from beltarm_env.task.reference import TRAPEZOID
from eval.speed.limits import arithmetic, copying
from eval.speed.operations import PARTS, WARM_UP, Effort, efforts_of_kernels

_ACTIONS = 16


@compiled
def _advance(blocks: Floats, work: Floats, actions: Floats, driven: Driven) -> None:
    for k in range(len(blocks)):
        if driven is IDEAL:
            advance_block(blocks[k], work, actions[k * LANES : (k + 1) * LANES], LANES, LUMPED)
        else:
            advance_driven_block(blocks[k], work, actions[k * LANES : (k + 1) * LANES], LANES, LUMPED)


@compiled
def _sense(blocks: Floats, driven: Driven) -> None:
    for k in range(len(blocks)):
        sense_block(blocks[k], LANES, ENCODER, driven)


@compiled
def _charge(blocks: Floats, scratch: Floats, driven: Driven) -> None:
    for k in range(len(blocks)):
        charge(blocks[k], scratch, LANES, TRAPEZOID, driven)


@compiled
def _transpose(tile: Singles, observations: Singles) -> None:
    for k in range(len(observations) // LANES):
        transpose(tile, observations[k * LANES : (k + 1) * LANES], ENCODER)


def parts(arms: int, steps: int, repetitions: int, randomization: Randomization) -> dict[str, float]:
    """Measure the parts of a step under random torques [ns per arm], the best of some repetitions.

    Args:
        arms: About how many; whole blocks are measured.
        steps: Per repetition, all of them before the first episode ends.
        repetitions: They take turns.
        randomization: Of the arms.
    """
    count = -(-arms // LANES) * LANES
    env = BeltArmVectorEnv(count, randomization=randomization)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(_ACTIONS)]
    torques = [action[:, 0].astype(np.float64) for action in actions]
    batch, work = env._batch, aligned_zeros(DRIVEN_WORK_ROWS * LANES)
    env.reset(seed=0)
    observations, driven = np.empty((count, size()), np.float32), batch.driven
    runs: dict[str, Callable[[int], object]] = {
        "whole step": lambda k: env.step(actions[k % _ACTIONS]),
        "motion": lambda k: _advance(batch.blocks, work, torques[k % _ACTIONS], driven),
        "sensing": lambda _: _sense(batch.blocks, driven),
        "cost": lambda _: _charge(batch.blocks, batch.scratch, driven),
        "observation": lambda _: observe_arms(batch.blocks, batch.tile, observations, TRAPEZOID, ENCODER, driven),
        "of that, copying to one row per arm": lambda _: _transpose(batch.tile, observations),
    }
    times: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(repetitions + 1):
        for name, run in runs.items():
            env.reset(seed=0)
            for k in range(WARM_UP):
                env.step(actions[k])
            began = time.perf_counter()
            for k in range(steps):
                run(k)
            times[name].append((time.perf_counter() - began) / steps / count * 1e9)
    best = {name: min(of_part[1:]) for name, of_part in times.items()}
    known = sum(best[name] for name in PARTS)
    return {**best, "results and Python": best["whole step"] - known}


def parts_tables(arms: int, steps: int, repetitions: int) -> list[Table]:
    """Tables of the parts for the terminal, with ideal drives and with all effects of the drive.

    Beside the time of a part is what its operations would take if a core did nothing else, and were at its best.
    """
    kinds: dict[str, Randomization] = {"ideal drives": "ideal", "all effects of the drive": "train"}
    fastest, copied, tables = arithmetic(), copying(), []
    for drives, kind in kinds.items():
        times, efforts = parts(arms, steps, repetitions, kind), efforts_of_kernels(kind)
        efforts["whole step"] = Effort(*map(sum, zip(*efforts.values(), strict=True)))
        title = f"A step under random torques, {drives}, per arm of about {arms}"
        caption = f"A core at its best: {fastest:.0f} operations in a ns, or {copied:.0f} bytes copied."
        columns = ("part", "ns", "operations", "/ and sqrt", "ns at best", "share", "bytes")
        table = Table(*columns, title=title, caption=caption, title_justify="left", caption_justify="left")
        for name, took in times.items():
            cells = _cells(efforts[name], took, fastest) if name in efforts else ["-"] * (len(columns) - 2)
            table.add_row(name, f"{took:.1f}", *cells)
        tables.append(table)
    return tables


def _cells(effort: Effort, took: float, fastest: float) -> list[str]:
    best = effort.operations / fastest
    counts = f"{effort.operations:.0f}", f"{effort.slow:.0f}"
    return [*counts, f"{best:.1f}", f"{100 * best / took:.0f} %", f"{effort.read + effort.written:.0f}"]
