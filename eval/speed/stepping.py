"""Steps per second of environments, whole episodes and training, start-up and memory, each beside a peer."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from unittest.mock import patch

import gymnasium as gym
import numpy as np
from joblib import cpu_count

from agents.policy.bundle import POLICIES, load_controller
from agents.residual.bases import make_base
from agents.residual.env import ResidualEnv
from baselines.engines.parallel import default_jobs
from baselines.optimal.adaptive import AdaptiveController
from baselines.servo.paper import PaperController
from beltarm_env import EPISODE_STEPS, BeltArmVectorEnv
from beltarm_env.arrays import Floats
from beltarm_env.engine.blocks import usual_threads
from beltarm_env.rollout import Controller, rollout
from beltarm_env.task.ranges import Randomization
from beltarm_env.task.seeds import training_arms

if TYPE_CHECKING:
    from agents.learners.ppo import PpoConfig

ROOT = Path(__file__).resolve().parents[2]
Work = tuple[int, Callable[[], object]]
"""Number of steps, and what takes them."""
_PEER = "CartPole-v1"
_DRIVE = ", all effects of the drive"
_PER_SINGLE_ARM = 100  # steps of a single arm for one of a batch
_ROLLED_OUT = 1024  # arms
_SINGLE_ARMS = 64  # beside the batch of a training
_MOST_STARTS, _MOST_TRAININGS = 3, 3
_FEW, _SOME, _MANY = 100, 1000, 100_000  # arms whose memory is measured: before, single ones, and of a batch
_FIRST_STEP = """
import importlib, sys, time
began = time.perf_counter()
importlib.import_module(sys.argv[1])
import gymnasium
env = gymnasium.make(sys.argv[2])
env.reset(seed=0)
env.step(env.action_space.sample())
print(time.perf_counter() - began)
"""
_MEMORY = """
import pathlib, re, sys, gymnasium, beltarm_env
name, vector, counts = sys.argv[1], sys.argv[2] == "vector", [int(word) for word in sys.argv[3:]]
most, envs = [], []
for count in counts:
    if vector:
        envs.append(gymnasium.make_vec(name, num_envs=count, vectorization_mode="vector_entry_point"))
    else:
        envs += [gymnasium.make(name) for _ in range(count)]
    for env in envs:
        env.action_space.seed(0)
        env.reset(seed=0)
        for _ in range(3):
            env.step(env.action_space.sample())
    most.append(int(re.search(r"VmHWM:\\s*(\\d+)", pathlib.Path("/proc/self/status").read_text())[1]))
print((most[1] - most[0]) * 1024 / counts[1])
"""


class Row(NamedTuple):
    """A measured quantity, beside that of a peer."""

    what: str
    measured: float
    unit: str  # "steps/s", "s", "kB" or "MB"
    peer: str | None = None
    of_peer: float | None = None
    ratios: tuple[float, ...] = ()  # how many times as good: lower quartile, median and upper quartile, or one


def times_in_turns(runs: Sequence[Callable[[], object]], repetitions: int) -> Floats:
    """Wall-clock of calls that take turns [s], shape (repetitions, calls); a busy machine slows all of them."""
    times = np.empty((repetitions + 1, len(runs)))
    for repetition in range(repetitions + 1):
        for k, run in enumerate(runs):
            began = time.perf_counter()
            run()
            times[repetition, k] = time.perf_counter() - began
    return times[1:]  # the first warms up


def speed(what: str, steps: int, times: Floats, peer: str, steps_of_peer: int, times_of_peer: Floats) -> Row:
    """Row of a speed, from the times that so many steps took in each repetition [s]."""
    rates, of_peer = steps / times, steps_of_peer / times_of_peer
    ratios = np.quantile(rates / of_peer, [0.25, 0.5, 0.75] if len(times) > 1 else [0.5]).tolist()
    return Row(what, float(np.median(rates)), "steps/s", peer, float(np.median(of_peer)), tuple(ratios))


def beside(peer: str, of_peer: Work, runs: Mapping[str, Work], repetitions: int) -> list[Row]:
    """Rows of runs that take turns with that of a peer."""
    *times, times_of_peer = times_in_turns([*(run for _, run in runs.values()), of_peer[1]], repetitions).T
    measured = zip(runs.items(), times, strict=True)
    return [speed(what, steps, taken, peer, of_peer[0], times_of_peer) for (what, (steps, _)), taken in measured]


def batch_rows(arms: int, steps: int, repetitions: int) -> list[Row]:
    """Speed of the vector environment beside CartPole's, and of as many threads as cores beside one.

    Random torques over the whole limit keep the motor slow, where steps are short, which no controller does: so drives
    are also timed over whole episodes of the paper's controller, its torques recorded before.
    """
    cores, end = cpu_count(), f", N = {arms}"

    def stepped(randomization: Randomization, count: int = arms, **settings: Any) -> Work:
        return count * steps, batch_steps("BeltArm-v0", count, steps, randomization=randomization, **settings)

    cart = arms * steps, batch_steps(_PEER, arms, steps)
    batches = {
        f"vector step{end}": stepped("ideal"),
        f"vector step, {cores} threads{end}": stepped("ideal", num_threads=cores),
        f"vector step{_DRIVE}{end}": stepped("train"),
        f"vector step{_DRIVE}, a fifth of the torques{end}": stepped("train", share=0.2),
        f"vector step of the full arm{end}": stepped("ideal", model="lagrangian"),
    }
    episodes = {
        f"episodes of the paper's controller{end}": (arms * EPISODE_STEPS, _episodes(arms, "ideal")),
        f"episodes of the paper's controller{_DRIVE}{end}": (arms * EPISODE_STEPS, _episodes(arms, "train")),
    }
    rows = beside(_PEER, cart, batches, repetitions)
    rows += beside(_PEER, cart, episodes, max(repetitions // 5, 1))
    threads: tuple[tuple[str, Randomization, int], ...] = (("", "ideal", 4 * arms), (_DRIVE, "train", arms))
    for drive, randomization, count in threads:
        alone, together = (stepped(randomization, count, num_threads=number) for number in (1, cores))
        rows += beside("1 thread", alone, {f"vector step{drive}, {cores} threads, N = {count}": together}, repetitions)
    return rows


def single_rows(steps: int, repetitions: int) -> list[Row]:
    """Speed of a single environment through `make`; episodes are restarted as they end."""
    count = _PER_SINGLE_ARM * steps

    def run(env: gym.Env, actions: list[Any]) -> None:
        for step in range(count):
            _, _, terminated, truncated, _ = env.step(actions[step % len(actions)])
            if terminated or truncated:
                env.reset()

    def stepped(name: str, **settings: Any) -> Work:
        env = gym.make(name, **settings)
        return count, partial(run, env, _actions(env))

    drives: dict[str, Randomization] = {"": "off", _DRIVE: "train"}
    arms = {f"single step through make{end}": stepped("BeltArm-v0", randomization=drives[end]) for end in drives}
    return beside(_PEER, stepped(_PEER), arms, repetitions)


def rollout_rows(repetitions: int) -> list[Row]:
    """Speed of whole episodes by `rollout`, controllers included: beside the paper's controller, and one thread."""
    repetitions, end = max(repetitions // 5, 1), f", {usual_threads()} threads, N = {_ROLLED_OUT}"

    def played(controller: Controller) -> Work:
        run = partial(rollout, controller, _ROLLED_OUT, seed=0, randomization="train")
        return _ROLLED_OUT * EPISODE_STEPS, run

    steps, adaptive = played(AdaptiveController())
    student = played(load_controller(POLICIES / "student" / "seed0"))
    runs = {f"rollout, adaptive{end}": (steps, adaptive), f"rollout, student, seed 0{end}": student}
    alone = steps, patch.dict(os.environ, OMP_NUM_THREADS="1")(lambda: adaptive())
    together = {f"rollout beside one thread, adaptive{end}": (steps, adaptive)}
    return [
        *beside("paper", played(PaperController()), runs, repetitions),
        *beside("1 thread", alone, together, repetitions),
    ]


def training_rows(repetitions: int, config: PpoConfig | None = None) -> list[Row]:
    """Speed of the loop of PPO on `paper`, rollout and update, beside one over single arms with as many samples."""
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import DummyVecEnv

    from agents.learners.ppo import ALONE, PpoConfig

    config = config or PpoConfig(**ALONE, base="paper", threads=default_jobs())  # as many as PyTorch has by default
    count, samples = min(_SINGLE_ARMS, config.arms), config.arms * config.rollout_steps

    def single_arm() -> ResidualEnv:
        arm = gym.make("BeltArm-v0", sensors=config.sensors, randomization="train")
        return ResidualEnv(arm, make_base(config.base), config.residual)

    batch, single_arms = config.make_env(), DummyVecEnv([single_arm] * count)
    for env in (batch, single_arms):
        env.seed(training_arms(config.seed).first)
    alone = PPO("MlpPolicy", single_arms, **replace(config, rollout_steps=samples // count).arguments())
    torch.set_num_threads(config.threads)

    def learned(model: PPO) -> Work:
        return samples * config.hold, partial(model.learn, samples, reset_num_timesteps=False)

    runs = {f"PPO, rollout and update, {config.arms} arms": learned(config.make_model(batch))}
    peer = f"PPO on {_SINGLE_ARMS} single arms in a DummyVecEnv"
    return beside(peer, learned(alone), runs, min(repetitions, _MOST_TRAININGS))


def batch_steps(name: str, arms: int, steps: int, share: float = 1, **settings: Any) -> Callable[[], None]:
    """Steps of a vector environment under random actions, or under a share of each."""
    env = gym.make_vec(name, num_envs=arms, vectorization_mode="vector_entry_point", **settings)
    actions = [action if share == 1 else share * action for action in _actions(env)]
    return partial(_step, env, [actions[step % len(actions)] for step in range(steps)])


def _step(env: Any, actions: Iterable[Any]) -> None:
    for action in actions:
        env.step(action)


def _actions(env: Any) -> list[Any]:
    """Reset an environment, and draw 16 actions."""
    env.action_space.seed(0)
    env.reset(seed=0)
    return [env.action_space.sample() for _ in range(16)]


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
        _step(env, torques)

    return run


def numbers(code: str, *words: str, **environment: str) -> list[float]:
    """Numbers that a Python process of its own prints."""
    known = {**os.environ, "PYTHONPATH": str(ROOT), **environment}
    command = [sys.executable, "-c", code, *words]
    return [float(word) for word in subprocess.check_output(command, env=known, text=True).split()]


def start_up_rows(repetitions: int) -> list[Row]:
    """Time of a process from the import to the first step, with kernels that are built and in a copy without any."""
    starts = range(min(repetitions, _MOST_STARTS))
    with tempfile.TemporaryDirectory() as folder:
        built = shutil.ignore_patterns("__pycache__", "built", "_glue.*")
        shutil.copytree(ROOT / "beltarm_env", Path(folder, "beltarm_env"), ignore=built)
        places = {"PYTHONPATH": folder, "BELTARM_CACHE_DIR": str(Path(folder, "kernels"))}

        def started(package: str, name: str) -> float:
            return numbers(_FIRST_STEP, package, name, **places)[0]

        cold = started("beltarm_env", "BeltArm-v0")
        times = [(started("beltarm_env", "BeltArm-v0"), started("gymnasium", _PEER)) for _ in starts]
    warm, cart = (min(taken) for taken in zip(*times, strict=True))
    return [
        Row(f"import, make, reset, first step{state}", taken, "s", _PEER, cart, (cart / taken,))
        for state, taken in (("", warm), (", kernels not built", cold))
    ]


def memory_rows() -> list[Row]:
    """Most memory that arms ever need, made, reset and stepped, beside as many CartPoles; on Linux."""
    if sys.platform != "linux":
        return []

    def of_one(kind: str, name: str) -> float:
        return max(numbers(_MEMORY, name, kind, str(_FEW), str(_MANY if kind == "vector" else _SOME))[0], 1.0)

    arm, cart = (of_one("single", name) / 1e3 for name in ("BeltArm-v0", _PEER))
    arms, carts = (of_one("vector", name) * _MANY / 1e6 for name in ("BeltArm-v0", _PEER))
    return [
        Row("memory of one arm", arm, "kB", _PEER, cart, (cart / arm,)),
        Row(f"memory of a batch, N = {_MANY}", arms, "MB", _PEER, carts, (carts / arms,)),
    ]
