"""Vectorised environments whose speed is compared, each as a function that steps so many arms or carts.

EnvPool (J. Weng et al.: EnvPool: A Highly Parallel Reinforcement Learning Environment Execution Engine, NeurIPS 2022)
steps carts in C++; gymnax (R. T. Lange, 2022) in JAX, made for graphics processors. Both are in the extra `bench`.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable
from typing import Any

import numpy as np

from eval.speed.stepping import batch_steps

Stepper = Callable[[int, int], Callable[[], object]]
"""Makes a batch of so many arms, and returns what takes so many steps of all."""
_ACTIONS = 16


def belt_arms(arms: int, steps: int) -> Callable[[], object]:
    """Step arms with ideal drives."""
    return batch_steps("BeltArm-v0", arms, steps, randomization="ideal")


def built_arms(arms: int, steps: int) -> Callable[[], object]:
    """Step arms with all effects of the drive."""
    return batch_steps("BeltArm-v0", arms, steps, randomization="train")


def gymnasium_carts(carts: int, steps: int) -> Callable[[], object]:
    """Step Gymnasium's own vectorised CartPole, in NumPy."""
    return batch_steps("CartPole-v1", carts, steps)


def envpool_carts(carts: int, steps: int) -> Callable[[], object]:
    """Step EnvPool's CartPole, in C++, with one thread."""
    envpool = importlib.import_module("envpool")
    env = envpool.make("CartPole-v1", env_type="gymnasium", num_envs=carts, num_threads=1, seed=0)
    env.reset()
    actions = np.random.default_rng(0).integers(0, 2, size=(_ACTIONS, carts), dtype=np.int32)

    def run() -> None:
        for step in range(steps):
            env.step(actions[step % _ACTIONS])

    return run


def gymnax_carts(carts: int, steps: int) -> Callable[[], object]:
    """Step gymnax's CartPole, one compiled call a step."""
    jax, step, begun = _gymnax(carts)
    actions = np.random.default_rng(0).integers(0, 2, size=(_ACTIONS, carts), dtype=np.int32)
    split = jax.jit(lambda key: jax.random.split(key, carts))

    def run() -> None:
        states = begun
        for k in range(steps):
            result = step(split(jax.random.key(k)), states, actions[k % _ACTIONS])
            states = result[1]
            np.asarray(result[0])  # what an agent needs

    return run


def gymnax_loop(carts: int, steps: int) -> Callable[[], object]:
    """Step gymnax's CartPole in a loop that is compiled too and draws the actions: no agent outside takes part."""
    jax, step, begun = _gymnax(carts)

    def one(states: Any, key: Any) -> Any:
        actions = jax.random.randint(key, (carts,), 0, 2)
        result = step(jax.random.split(key, carts), states, actions)
        return result[1], result[2].sum()

    loop = jax.jit(lambda states: jax.lax.scan(one, states, jax.random.split(jax.random.key(0), steps)))
    return lambda: jax.block_until_ready(loop(begun))


def _gymnax(carts: int) -> tuple[Any, Any, Any]:
    """JAX, the compiled step of keys, states and actions, and states to begin from."""
    jax, gymnax = importlib.import_module("jax"), importlib.import_module("gymnax")
    env, params = gymnax.make("CartPole-v1")
    keys = jax.random.split(jax.random.key(0), carts)
    _, begun = jax.vmap(env.reset, in_axes=(0, None))(keys, params)
    step = jax.jit(jax.vmap(lambda key, state, action: env.step(key, state, action, params)))
    return jax, step, begun


STEPPERS: dict[str, tuple[str, Stepper]] = {
    "BeltArm-v0, ideal drives": ("beltarm_env", belt_arms),
    "BeltArm-v0, all effects of the drive": ("beltarm_env", built_arms),
    "CartPole-v1, Gymnasium": ("gymnasium", gymnasium_carts),
    "CartPole-v1, EnvPool": ("envpool", envpool_carts),
    "CartPole-v1, gymnax": ("gymnax", gymnax_carts),
    "CartPole-v1, gymnax, loop compiled": ("gymnax", gymnax_loop),
}
"""Package that each needs, and how it is stepped."""


def installed() -> dict[str, Stepper]:
    """Those whose packages are installed."""
    return {name: step for name, (package, step) in STEPPERS.items() if importlib.util.find_spec(package)}
