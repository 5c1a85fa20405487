"""Wall-clock of PPO by phase, and the speed of its loop beside one over single arms.

Printed by `python eval/bench.py --training-loop`, of the model and the arms that `train/ppo.py` makes by default.
Methods are timed from outside, so what is timed is what runs; time is charged to the innermost phase alone, so that the
phases add up to the whole.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from rich.console import Console
from rich.table import Table
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv

from agents.learners.ppo import PpoConfig, make_model
from agents.learners.reinforcement import make_env
from agents.residual.bases import make_base
from agents.residual.env import ResidualEnv
from baselines.engines.parallel import default_jobs
from beltarm_env.task.seeds import training_arms
from eval.speed.timing import Row, ratios, times_in_turns

ARMS, INFORMED, ADAPTER = "arms", "base controller and identification", "rest of the environment's step"
POLICY, BUFFER, REST, OPTIMISER = "policy network", "rollout buffer", "rest of the rollout", "optimiser"
PHASES = (ARMS, INFORMED, ADAPTER, BUFFER, REST, POLICY, OPTIMISER)
OVERHEAD = (ARMS, INFORMED, ADAPTER, BUFFER, REST)
"""What is neither optimiser nor policy network."""
SINGLE_ARMS = 64
_ITERATIONS = 20  # of PPO whose time is taken apart


class Stopwatch:
    """Seconds of each phase; a phase within another one stops the outer one's clock."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = dict.fromkeys(PHASES, 0.0)
        self._phase: str = REST
        self._since = time.perf_counter()

    def restart(self) -> None:
        """Forget what was measured so far."""
        self.seconds.update(dict.fromkeys(PHASES, 0.0))
        self._since = time.perf_counter()

    def turn(self, phase: str) -> str:
        """Charge the time since the last turn to the phase that ends, and begin another one; returns the former."""
        now = time.perf_counter()
        self.seconds[self._phase] += now - self._since
        before, self._phase, self._since = self._phase, phase, now
        return before

    @contextmanager
    def during(self, phase: str) -> Iterator[None]:
        """Charge to a phase."""
        before = self.turn(phase)
        try:
            yield
        finally:
            self.turn(before)

    def watch(self, owner: Any, method: str, phase: str) -> None:
        """Charge all calls of an object's method to a phase."""
        original: Callable[..., Any] = getattr(owner, method)

        def timed(*arguments: Any, **named: Any) -> Any:
            with self.during(phase):
                return original(*arguments, **named)

        setattr(owner, method, timed)


def watched(config: PpoConfig) -> tuple[PPO, Stopwatch]:
    """Make the model of a run, and the stopwatch that times it."""
    env = make_env(config)
    env.seed(training_arms(config.seed).first)
    model, watch = make_model(config, env), Stopwatch()
    watch.watch(env.env, "step", ARMS)
    for method in ("advance", "ended", "seen"):
        watch.watch(env.informed, method, INFORMED)
    for method in ("step_async", "step_wait"):
        watch.watch(env, method, ADAPTER)
    for method in ("forward", "predict_values"):
        watch.watch(model.policy, method, POLICY)
    for method in ("add", "compute_returns_and_advantage", "_get_samples"):
        watch.watch(model.rollout_buffer, method, BUFFER)
    watch.watch(model, "train", OPTIMISER)
    return model, watch


def shares(config: PpoConfig, iterations: int) -> dict[str, float]:
    """Share of each phase in the wall-clock of `iterations` of PPO, after two that warm up."""
    torch.set_num_threads(config.threads)
    model, watch = watched(config)
    batch = config.arms * config.rollout_steps
    model.learn(2 * batch)
    watch.restart()
    model.learn(iterations * batch, reset_num_timesteps=False)
    watch.turn(REST)
    whole = sum(watch.seconds.values())
    return {phase: watch.seconds[phase] / whole for phase in PHASES}


def iteration_on_batch(config: PpoConfig) -> Callable[[], object]:
    """One iteration of PPO, rollout and update, on the batch of arms."""
    env = make_env(config)
    env.seed(training_arms(config.seed).first)
    return _iteration(make_model(config, env), config)


def iteration_on_single_arms(config: PpoConfig) -> Callable[[], object]:
    """One iteration of PPO with as many samples per update, on single arms in a `DummyVecEnv`."""
    count = min(SINGLE_ARMS, config.arms)

    def make() -> ResidualEnv:
        arm = gym.make("BeltArm-v0", sensors=config.sensors, randomization="train")
        return ResidualEnv(arm, make_base(config.base), config.residual)

    env = DummyVecEnv([make] * count)
    env.seed(training_arms(config.seed).first)
    longer = replace(config, rollout_steps=config.arms * config.rollout_steps // count)
    return _iteration(PPO("MlpPolicy", env, **longer.arguments()), config)


def _iteration(model: PPO, config: PpoConfig) -> Callable[[], object]:
    torch.set_num_threads(config.threads)
    return lambda: model.learn(config.arms * config.rollout_steps, reset_num_timesteps=False)


def shares_table(config: PpoConfig, iterations: int) -> Table:
    """Table of the phases' shares for the terminal."""
    found = shares(config, iterations)
    title = f"PPO's wall-clock, {iterations} iterations"
    table = Table("phase", "share", title=title, title_justify="left")
    for phase in PHASES:
        table.add_row(phase, f"{100 * found[phase]:.1f} %")
        if phase == OVERHEAD[-1]:
            table.add_row("together", f"{100 * sum(found[name] for name in OVERHEAD):.1f} %", end_section=True)
    return table


def loop_row(console: Console) -> Row:
    """Speed of the loop of `train/ppo.py` beside the same PPO on single arms; prints where its time goes.

    PyTorch has a thread for each core in both, as it has where nothing is said.
    """
    config = PpoConfig(threads=default_jobs())
    console.print(shares_table(config, _ITERATIONS))
    loops = [iteration_on_batch(config), iteration_on_single_arms(config)]
    times = times_in_turns(loops, 3).T
    batch, single = config.arms * config.rollout_steps * config.hold / np.median(times, axis=1)
    return Row(
        f"PPO, rollout and update, {config.arms} arms",
        f"{batch / 1e3:.0f} k steps/s",
        f"PPO on {SINGLE_ARMS} single arms in a DummyVecEnv: {single / 1e3:.1f} k steps/s",
        *ratios(*times),
    )
