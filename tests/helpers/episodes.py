"""Episodes for the tests: torques, everything that an episode returns, and arms of a batch beside arms alone."""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from beltarm_env import BeltArmEnv, BeltArmVectorEnv
from beltarm_env.arm import FIELDS
from beltarm_env.observation import index


def torques(steps: int, seed: int = 0, hold: int = 40) -> NDArray[np.float32]:
    """Random torques, each held for a while: enough to slide, stick and reverse, shape (steps, 1)."""
    levels = np.random.default_rng(seed).uniform(-1, 1, (-(-steps // hold), 1))
    return np.repeat(levels, hold, axis=0)[:steps].astype(np.float32)


def play(env: gym.Env[Any, Any], actions: NDArray[np.float32], **reset: Any) -> list[tuple[Any, ...]]:
    """Everything that an episode returns, observations as bytes so that lists compare bit for bit."""
    observation, info = env.reset(**reset)
    record: list[tuple[Any, ...]] = [(observation.tobytes(), info)]
    for action in actions:
        observation, *rest = env.step(action)
        record.append((observation.tobytes(), *rest))
        if rest[1] or rest[2]:
            break
    return record


def assert_as_alone(
    batch: BeltArmVectorEnv,
    alone: Sequence[BeltArmEnv],
    actions: Iterable[NDArray[np.float32]],
    seed: int,
    arms: Sequence[int] | None = None,
) -> int:
    """Assert that arms of a batch in the mode SameStep are as alone, bit for bit, across resets; return the ends."""
    pairs, ends = list(zip(arms or range(batch.num_envs), alone, strict=True)), 0
    first, _ = batch.reset(seed=seed)
    for arm, env in pairs:
        assert first[arm].tobytes() == env.reset(seed=seed + arm)[0].tobytes()
    for action in actions:
        observations, rewards, *_ = batch.step(action)
        for arm, env in pairs:
            observation, reward, terminated, truncated, _ = env.step(action[arm])
            if terminated or truncated:
                ends, observation = ends + 1, env.reset()[0]
            assert observations[arm].tobytes() == observation.tobytes() and rewards[arm] == reward
            assert observation[index("holds_part")] == (env.params.payload_mass > 0)
    for arm, env in pairs:
        assert batch.state[arm].tobytes() == env.state.tobytes()
        assert batch.motor_torques[arm] == env.motor_torque
    return ends


def memory_after(controller: Any, env: BeltArmVectorEnv, steps: int, **reset: Any) -> Any:
    """Memory of a controller that has driven a batch for so many samples."""
    observation, _ = env.reset(**reset)
    memory: Any = None
    for _ in range(steps):
        action, memory = controller.predict(observation, memory)
        observation, *_ = env.step(action)
    return memory


def next_move(env: BeltArmVectorEnv, payload: float) -> Any:
    """Let all arms begin a move where they are, with a payload [kg]; return their observations."""
    table, goal = env.params_table, np.clip(env.moves[:, 1], 0, np.pi / 2)
    params = {name: table[:, k].copy() for k, name in enumerate(FIELDS)}
    params["payload_mass"] = np.full(len(table), payload)
    return env.reset(options={"params": params, "move": {"start": goal}, "state": env.state})[0]


def torques_of(controller: Any, first: int, count: int, steps: int = 160, **settings: Any) -> NDArray[np.float32]:
    """Torques of a controller on arms that set out, shape (steps, count): what a rounding changes has time to grow."""
    arms = BeltArmVectorEnv(count, autoreset_mode="Disabled", **settings)
    observation, _ = arms.reset(seed=first)
    memory, taken = None, []
    for k in range(steps):
        action, memory = controller.predict(observation, memory, np.full(count, k == 0))
        taken.append(action[:, 0].copy())
        observation, *_ = arms.step(action)
    return np.stack(taken)


def assert_same_in_batches(make: Callable[[], Any], first: int, **settings: Any) -> None:
    """Assert that an arm is driven the same way alone, in a batch of 24, twice at the same time, and in two blocks."""
    many = torques_of(make(), first, 140, **settings)
    assert np.abs(np.diff(many, axis=0)).max() > 0.01, "it moves"
    with ThreadPoolExecutor(2) as pool:
        shared = [pool.submit(torques_of, each, first, 24, **settings) for each in 2 * [make()]]
    for torques in shared:
        np.testing.assert_array_equal(torques.result(), many[:, :24])
    np.testing.assert_array_equal(torques_of(make(), first + 17, 1, **settings), many[:, 17:18])
