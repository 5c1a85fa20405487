"""Steps per second of the environments, beside Gymnasium's CartPole-v1."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from joblib import cpu_count

from agents.policy.bundle import POLICIES, load_controller
from baselines.optimal.adaptive import AdaptiveController
from baselines.servo.paper import PaperController
from beltarm_env import EPISODE_STEPS, BeltArmVectorEnv
from beltarm_env.arrays import Floats
from beltarm_env.rollout import rollout
from beltarm_env.task.ranges import Randomization
from beltarm_env.threads.blocks import usual_threads
from eval.speed.timing import Row, ratios, times_in_turns

_PER_SINGLE_ARM = 100  # steps of a single arm for one of a batch
_ROLLED_OUT = 1024  # arms
_CORES = cpu_count()


def batch_rows(arms: int, steps: int, repetitions: int) -> list[Row]:
    """Speed of the vector environment, beside CartPole's: ideal drives, on one core and on all, built ones, full arm.

    Random torques over the whole limit keep the motor slow, where steps are short, which no controller does: so drives
    are also timed over whole episodes of the paper's controller, its torques recorded before.
    """
    stepped = {
        "vector step": batch_steps("BeltArm-v0", arms, steps, randomization="ideal"),
        f"vector step, {_CORES} threads": batch_steps(
            "BeltArm-v0", arms, steps, randomization="ideal", num_threads=_CORES
        ),
        "vector step, all effects of the drive": batch_steps("BeltArm-v0", arms, steps, randomization="train"),
        "vector step of the full arm": batch_steps(
            "BeltArm-v0", arms, steps, randomization="ideal", model="lagrangian"
        ),
    }
    episodes = {
        "episodes of the paper's controller": _episodes(arms, "ideal"),
        "episodes of the paper's controller, all effects of the drive": _episodes(arms, "train"),
    }
    cart = batch_steps("CartPole-v1", arms, steps)
    *times, carts = times_in_turns([*stepped.values(), cart], repetitions).T / steps
    rows = [_row(name, arms, of_name, carts) for name, of_name in zip(stepped, times, strict=True)]
    *longer, cart_times = times_in_turns([*episodes.values(), cart], max(repetitions // 5, 1)).T
    carts = cart_times / steps
    return rows + [
        _row(name, arms, of_name / EPISODE_STEPS, carts) for name, of_name in zip(episodes, longer, strict=True)
    ]


def rollout_rows(repetitions: int) -> list[Row]:
    """Speed of whole episodes by `rollout`, controllers included: beside the paper's controller, and on one core."""
    student = load_controller(POLICIES / "student" / "seed0")
    controllers = {"adaptive": AdaptiveController(), "student, seed 0": student}
    settings: dict[str, Any] = {"seed": 0, "randomization": "train"}
    all_of_them = [*controllers.values(), PaperController()]
    runs = [partial(rollout, controller, _ROLLED_OUT, **settings) for controller in all_of_them]
    *times, paper, alone = times_in_turns([*runs, _in_one_thread(runs[0])], max(repetitions // 5, 1)).T / EPISODE_STEPS
    peer = f"paper: {_rate(_ROLLED_OUT, paper)}"
    rows = [
        Row(f"rollout, {name}, N = {_ROLLED_OUT}", _rate(_ROLLED_OUT, of_name), peer, *ratios(of_name, paper))
        for name, of_name in zip(controllers, times, strict=True)
    ]
    name, peer = f"rollout, adaptive, {usual_threads()} threads", f"1 thread: {_rate(_ROLLED_OUT, alone)}"
    return [*rows, Row(f"{name}, N = {_ROLLED_OUT}", _rate(_ROLLED_OUT, times[0]), peer, *ratios(times[0], alone))]


def _in_one_thread(run: Callable[[], object]) -> Callable[[], None]:
    def alone() -> None:
        told = os.environ.get("OMP_NUM_THREADS")
        os.environ["OMP_NUM_THREADS"] = "1"
        try:
            run()
        finally:
            os.environ.pop("OMP_NUM_THREADS")
            if told is not None:
                os.environ["OMP_NUM_THREADS"] = told

    return alone


def threads_row(arms: int, steps: int, repetitions: int, randomization: Randomization) -> Row:
    """Speed of the vector environment with as many threads as cores, beside one thread."""
    settings = {"randomization": randomization}
    runs = [batch_steps("BeltArm-v0", arms, steps, num_threads=threads, **settings) for threads in (1, _CORES)]
    alone, together = times_in_turns(runs, repetitions).T / steps
    drives = "" if randomization == "ideal" else ", all effects of the drive"
    name = f"vector step{drives}, {_CORES} threads, N = {arms}"
    return Row(name, _rate(arms, together), f"1 thread: {_rate(arms, alone)}", *ratios(together, alone))


def _row(name: str, arms: int, times: Floats, cart: Floats) -> Row:
    return Row(f"{name}, N = {arms}", _rate(arms, times), f"CartPole-v1: {_rate(arms, cart)}", *ratios(times, cart))


def _rate(arms: int, times: Floats) -> str:
    rate = arms / np.median(times)
    return f"{rate / 1e6:.1f} M steps/s" if rate > 1e6 else f"{rate / 1e3:.0f} k steps/s"


def single_row(steps: int, repetitions: int) -> Row:
    """Time of a step of a single environment through `make`."""
    count = _PER_SINGLE_ARM * steps
    runs = [_single_steps(name, count) for name in ("BeltArm-v0", "CartPole-v1")]
    arm, cart = times_in_turns(runs, repetitions).T / count
    of_arm, of_cart = (f"{1e6 * np.median(times):.2f} us" for times in (arm, cart))
    return Row("single step through make", of_arm, f"CartPole-v1: {of_cart}", *ratios(arm, cart))


def batch_steps(name: str, arms: int, steps: int, **settings: Any) -> Callable[[], None]:
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
