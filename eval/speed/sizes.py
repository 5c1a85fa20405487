"""Steps per second over the size of the batch, beside other vectorised environments on the same core.

EnvPool (J. Weng et al.: EnvPool: A Highly Parallel Reinforcement Learning Environment Execution Engine, NeurIPS 2022)
steps carts in C++; gymnax (R. T. Lange, 2022) in JAX, made for graphics processors. Both are in the extra `bench`.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from rich.console import Console

from baselines.tools.progress import progress_over
from beltarm_env.arrays import Floats
from eval.speed.stepping import batch_steps, times_in_turns

SIZES = (1, 4, 16, 64, 256, 1024, 4096, 16384, 100_000)
"""Arms or carts of a batch."""
Stepper = Callable[[int, int], Callable[[], object]]
"""Makes a batch of so many arms, and returns a function that takes so many steps of all."""
_TIME = 0.1  # of a repetition [s], about
_FEWEST, _MOST = 10, 2000  # steps of it


def rates(sizes: Sequence[int], repetitions: int) -> dict[str, Floats]:
    """Quartiles of the steps per second of all that is installed, each of shape (sizes, 3); on one core if possible."""
    steppers = {name: step for name, (package, step) in STEPPERS.items() if importlib.util.find_spec(package)}
    cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else ()
    try:
        if cores:
            os.sched_setaffinity(0, {max(cores)})
        shown = progress_over("sizes", sizes, Console())
        measured = [_rates(list(steppers.values()), size, repetitions) for size in shown]
    finally:
        if cores:
            os.sched_setaffinity(0, cores)
    quartiles = np.quantile(measured, [0.25, 0.5, 0.75], axis=1)  # of (sizes, repetitions, steppers)
    return {name: quartiles[:, :, k].T for k, name in enumerate(steppers)}


def _rates(steppers: Sequence[Stepper], size: int, repetitions: int) -> Floats:
    """Steps per second, shape (repetitions, steppers)."""
    runs, counts = [], []
    for stepper in steppers:
        took = times_in_turns([stepper(size, _FEWEST)], 3).min() / _FEWEST
        counts.append(int(np.clip(_TIME / took, _FEWEST, _MOST)))
        runs.append(stepper(size, counts[-1]))
    return size * np.array(counts) / times_in_turns(runs, repetitions)


def _pushes(carts: int, steps: int) -> list[Any]:
    """Random actions of carts for each step."""
    actions = np.random.default_rng(0).integers(0, 2, size=(16, carts), dtype=np.int32)
    return [actions[step % len(actions)] for step in range(steps)]


def _envpool(carts: int, steps: int) -> Callable[[], object]:
    """Step EnvPool's CartPole, in C++, with one thread."""
    envpool = importlib.import_module("envpool")
    env = envpool.make("CartPole-v1", env_type="gymnasium", num_envs=carts, num_threads=1, seed=0)
    env.reset()
    pushes = _pushes(carts, steps)
    return lambda: [env.step(push) for push in pushes]


def _gymnax_steps(carts: int, steps: int) -> Callable[[], object]:
    """Step gymnax's CartPole, one compiled call a step."""
    jax, step, beginning = _gymnax(carts)
    pushes, split = _pushes(carts, steps), jax.jit(lambda key: jax.random.split(key, carts))

    def run() -> None:
        states = beginning
        for k, push in enumerate(pushes):
            result = step(split(jax.random.key(k)), states, push)
            states = result[1]
            np.asarray(result[0])  # what an agent needs

    return run


def _gymnax_loop(carts: int, steps: int) -> Callable[[], object]:
    """Step gymnax's CartPole in a loop that is compiled too and draws the actions: no agent outside takes part."""
    jax, step, beginning = _gymnax(carts)

    def advance(states: Any, key: Any) -> Any:
        actions = jax.random.randint(key, (carts,), 0, 2)
        result = step(jax.random.split(key, carts), states, actions)
        return result[1], result[2].sum()

    loop = jax.jit(lambda states: jax.lax.scan(advance, states, jax.random.split(jax.random.key(0), steps)))
    return lambda: jax.block_until_ready(loop(beginning))


def _gymnax(carts: int) -> tuple[Any, Any, Any]:
    """JAX, the compiled step of keys, states and actions, and states to begin from."""
    jax, gymnax = importlib.import_module("jax"), importlib.import_module("gymnax")
    env, params = gymnax.make("CartPole-v1")
    keys = jax.random.split(jax.random.key(0), carts)
    _, beginning = jax.vmap(env.reset, in_axes=(0, None))(keys, params)
    return jax, jax.jit(jax.vmap(lambda key, state, action: env.step(key, state, action, params))), beginning


STEPPERS: dict[str, tuple[str, Stepper]] = {
    "BeltArm-v0, ideal drives": ("beltarm_env", partial(batch_steps, "BeltArm-v0", randomization="ideal")),
    "BeltArm-v0, all effects of the drive": ("beltarm_env", partial(batch_steps, "BeltArm-v0", randomization="train")),
    "CartPole-v1, Gymnasium": ("gymnasium", partial(batch_steps, "CartPole-v1")),
    "CartPole-v1, EnvPool": ("envpool", _envpool),
    "CartPole-v1, gymnax": ("gymnax", _gymnax_steps),
    "CartPole-v1, gymnax, loop compiled": ("gymnax", _gymnax_loop),
}
"""Package that each needs, and how it is stepped."""
