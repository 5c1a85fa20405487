"""Steps per second of the environments, beside Gymnasium's CartPole-v1."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym

from baselines.servo.paper import PaperController
from beltarm_env import EPISODE_STEPS, BeltArmVectorEnv
from beltarm_env.task.ranges import Randomization

Row = tuple[str, str, str, str]
"""What was measured, the result, the peer's, their ratio."""
_PER_SINGLE_ARM = 100  # steps of a single arm for one of a batch


def best_times(runs: Sequence[Callable[[], object]], repetitions: int) -> list[float]:
    """Shortest wall-clock of each call [s]; they take turns, so that a busy machine slows all of them."""
    times = []
    for repetition in range(repetitions + 1):
        for run in runs:
            began = time.perf_counter()
            run()
            if repetition > 0:  # the first warms up
                times.append(time.perf_counter() - began)
    return [min(times[k :: len(runs)]) for k in range(len(runs))]


def batch_rows(arms: int, steps: int, repetitions: int) -> list[Row]:
    """Speed of the vector environment: lumped arm, the same behind drives as they are built, full arm.

    Random torques over the whole limit stop and start the motor in nearly every sample, which no controller does: so
    drives are also timed over whole episodes of the paper's controller, its torques recorded before.
    """
    batches = [
        _batch_steps("BeltArm-v0", arms, steps, randomization="ideal"),
        _batch_steps("BeltArm-v0", arms, steps, randomization="train"),
        _batch_steps("BeltArm-v0", arms, steps, randomization="ideal", model="lagrangian"),
        _batch_steps("CartPole-v1", arms, steps),
    ]
    times = [took / steps for took in best_times(batches, repetitions)]
    episodes = [_episodes(arms, "ideal"), _episodes(arms, "train")]
    times += [took / EPISODE_STEPS for took in best_times(episodes, max(repetitions // 5, 1))]
    lumped, driven, full, cart, of_ideal, of_train = times
    rates = [f"{arms / took / 1e6:.1f} M steps/s" for took in times]
    above = "lumped arm, ideal drive"
    size = f"N = {arms}"
    return [
        (f"vector step, {size}", rates[0], f"CartPole-v1: {rates[3]}", f"{cart / lumped:.2f}x"),
        (
            f"episodes of the paper's controller, all effects of the drive, {size}",
            rates[5],
            f"ideal drive: {rates[4]}",
            f"{of_ideal / of_train:.2f}x",
        ),
        (f"vector step with all effects, random torques, {size}", rates[1], above, f"{lumped / driven:.2f}x"),
        (f"vector step of the full arm, {size}", rates[2], above, f"{lumped / full:.2f}x"),
    ]


def single_row(steps: int, repetitions: int) -> Row:
    """Time of a step of a single environment through `make`."""
    count = _PER_SINGLE_ARM * steps
    runs = [_single_steps(name, count) for name in ("BeltArm-v0", "CartPole-v1")]
    arm, cart = (took / count for took in best_times(runs, repetitions))
    return "single step through make", f"{1e6 * arm:.2f} us", f"CartPole-v1: {1e6 * cart:.2f} us", f"{cart / arm:.2f}x"


def _batch_steps(name: str, arms: int, steps: int, **settings: Any) -> Callable[[], None]:
    """Steps of a vector environment under random actions."""
    env = gym.make_vec(name, num_envs=arms, vectorization_mode="vector_entry_point", **settings)
    env.action_space.seed(0)
    env.reset(seed=0)
    actions = [env.action_space.sample() for _ in range(16)]

    def run() -> None:
        for step in range(steps):
            env.step(actions[step % 16])

    return run


def _episodes(arms: int, randomization: Randomization) -> Callable[[], None]:
    """One episode of each arm under the torques that the paper's controller commanded in it."""
    env = BeltArmVectorEnv(arms, randomization=randomization)
    controller, memory, torques = PaperController(), None, []
    observations, _ = env.reset(seed=0)
    for _ in range(EPISODE_STEPS):
        torque, memory = controller.predict(observations, memory)
        torques.append(torque)
        observations, *_ = env.step(torque)

    def run() -> None:
        env.reset(seed=0)
        for torque in torques:
            env.step(torque)

    return run


def _single_steps(name: str, steps: int) -> Callable[[], None]:
    """Steps of one environment under random actions, episodes restarted as they end."""
    env = gym.make(name)
    env.action_space.seed(0)
    env.reset(seed=0)
    actions = [env.action_space.sample() for _ in range(16)]

    def run() -> None:
        for step in range(steps):
            _, _, terminated, truncated, _ = env.step(actions[step % 16])
            if terminated or truncated:
                env.reset()

    return run
