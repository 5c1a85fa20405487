"""Steps per second of the environments, beside Gymnasium's CartPole-v1."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym
from joblib import cpu_count

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
    """Speed of the vector environment, beside CartPole's: lumped arm, behind drives as they are built, full arm.

    Random torques over the whole limit stop and start the motor in nearly every sample, which no controller does: so
    drives are also timed over whole episodes of the paper's controller, its torques recorded before.
    """
    stepped = {
        "vector step": _batch_steps("BeltArm-v0", arms, steps, randomization="ideal"),
        "vector step, all effects of the drive": _batch_steps("BeltArm-v0", arms, steps, randomization="train"),
        "vector step of the full arm": _batch_steps(
            "BeltArm-v0", arms, steps, randomization="ideal", model="lagrangian"
        ),
    }
    episodes = {
        "episodes of the paper's controller": _episodes(arms, "ideal"),
        "episodes of the paper's controller, all effects of the drive": _episodes(arms, "train"),
    }
    took = best_times([*stepped.values(), _batch_steps("CartPole-v1", arms, steps)], repetitions)
    *times, cart = (seconds / steps for seconds in took)
    times += [seconds / EPISODE_STEPS for seconds in best_times(list(episodes.values()), max(repetitions // 5, 1))]
    peer = f"CartPole-v1: {_rate(arms, cart)}"
    return [
        (f"{name}, N = {arms}", _rate(arms, seconds), peer, f"{cart / seconds:.2f}x")
        for name, seconds in zip([*stepped, *episodes], times, strict=True)
    ]


def threads_row(arms: int, steps: int, repetitions: int, randomization: Randomization) -> Row:
    """Speed of the vector environment with as many threads as cores, beside one thread."""
    cores = cpu_count()
    settings = {"randomization": randomization}
    runs = [_batch_steps("BeltArm-v0", arms, steps, num_threads=threads, **settings) for threads in (1, cores)]
    alone, together = (seconds / steps for seconds in best_times(runs, repetitions))
    drives = "" if randomization == "ideal" else ", all effects of the drive"
    name = f"vector step{drives}, {cores} threads, N = {arms}"
    return name, _rate(arms, together), f"1 thread: {_rate(arms, alone)}", f"{alone / together:.2f}x"


def _rate(arms: int, seconds: float) -> str:
    return f"{arms / seconds / 1e6:.1f} M steps/s"


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
