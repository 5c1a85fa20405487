"""Where the time of a batch's step goes, in nanoseconds per arm."""

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
from beltarm_env.kernels.tile import transpose
from beltarm_env.observation import ENCODER, size
from beltarm_env.physics.models import LUMPED
from beltarm_env.task.ranges import Randomization
from beltarm_env.task.reference import TRAPEZOID

_ACTIONS = 16
_WARM_UP = 5  # steps, so that arms are in motion


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
        "observation": lambda _: observe_arms(batch.blocks, batch.tile, observations, TRAPEZOID, ENCODER, driven),
        "of that, copying to one row per arm": lambda _: _transpose(batch.tile, observations),
    }
    times: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(repetitions + 1):
        for name, run in runs.items():
            env.reset(seed=0)
            for k in range(_WARM_UP):
                env.step(actions[k])
            began = time.perf_counter()
            for k in range(steps):
                run(k)
            times[name].append((time.perf_counter() - began) / steps / count * 1e9)
    best = {name: min(of_part[1:]) for name, of_part in times.items()}
    known = sum(best[name] for name in ("motion", "sensing", "observation"))
    return {**best, "cost, results and Python": best["whole step"] - known}


def parts_table(arms: int, steps: int, repetitions: int) -> Table:
    """Table of the parts for the terminal, with ideal drives and with all effects of the drive."""
    ideal, driven = (parts(arms, steps, repetitions, kind) for kind in ("ideal", "train"))
    title = f"A step of about {arms} arms under random torques, ns per arm"
    table = Table("part", "ideal drives", "all effects of the drive", title=title, title_justify="left")
    for name in ideal:
        table.add_row(name, f"{ideal[name]:.1f}", f"{driven[name]:.1f}")
    return table
