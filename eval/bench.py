"""Speed and accuracy, each beside a peer measured in the same run: `python eval/bench.py`.

Times are the best of several repetitions, which is what the code can do when the machine leaves it alone; ratios to the
peer are what to compare between machines.
"""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import gymnasium as gym
import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

import beltarm_env

ROOT = Path(__file__).resolve().parent.parent
_ITERATIONS = 20  # of PPO whose time is taken apart


@dataclass(frozen=True)
class Config:
    """Measure speed and accuracy."""

    arms: int = 4096
    """Arms of the batch."""
    repetitions: int = 25
    """Repetitions, of which the best counts."""
    steps: int = 100
    """Steps per repetition of a batch; single arms take a hundred times as many."""
    training: bool = False
    """Also run `train/ppo.py` with its defaults, and see when its policy halves the paper's figures; takes minutes."""
    training_loop: bool = False
    """Also measure what PPO spends its time on, and its speed beside PPO on single arms; takes a minute."""


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


def batch_steps(name: str, config: Config, **settings: Any) -> Callable[[], None]:
    """Steps of a vector environment under random actions."""
    env = gym.make_vec(name, num_envs=config.arms, vectorization_mode="vector_entry_point", **settings)
    env.action_space.seed(0)
    env.reset(seed=0)
    actions = [env.action_space.sample() for _ in range(16)]

    def run() -> None:
        for step in range(config.steps):
            env.step(actions[step % 16])

    return run


def single_steps(name: str, config: Config, **settings: Any) -> Callable[[], None]:
    """Steps of one environment through `make`, episodes restarted as they end."""
    env = gym.make(name, **settings)
    env.action_space.seed(0)
    env.reset(seed=0)
    actions = [env.action_space.sample() for _ in range(16)]

    def run() -> None:
        for step in range(100 * config.steps):
            _, _, terminated, truncated, _ = env.step(actions[step % 16])
            if terminated or truncated:
                env.reset()

    return run


_FIRST_STEP = """
import time
began = time.perf_counter()
import beltarm_env
imported = time.perf_counter()
import gymnasium, numpy
env = gymnasium.make("BeltArm-v0")
env.reset(seed=0)
env.step(numpy.zeros(1, numpy.float32))
print(imported - began, time.perf_counter() - imported)
"""


_EMPTY = """
import time
began = time.perf_counter()
import numba

@numba.njit
def nothing(x):
    return x

nothing(1.0)
print(time.perf_counter() - began)
"""


def numba_start_up() -> float:
    """Seconds numba takes to be imported and to compile a function that does nothing."""
    result = subprocess.run([sys.executable, "-c", _EMPTY], capture_output=True, text=True, check=True)
    return float(result.stdout)


def start_up(cache: Path) -> tuple[float, float]:
    """Seconds of `import beltarm_env`, and from there to the end of the first step, in a process of its own."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": str(ROOT)}
    result = subprocess.run(
        [sys.executable, "-c", _FIRST_STEP], env=environment, capture_output=True, text=True, check=True
    )
    imported, stepped = map(float, result.stdout.split())
    return imported, stepped


def accuracy() -> tuple[float, int]:
    """Largest tip distance [m] to the event-located reference over stick-slip moves, and their changes of mode."""
    from baselines import PaperController
    from eval.verification.event_located import EventLocatedArm, tip

    worst, changes = 0.0, 0
    for seed in range(5):
        env = gym.make("BeltArm-v0", randomization="train")
        arm = env.unwrapped
        assert isinstance(arm, beltarm_env.BeltArmEnv)
        observation, _ = env.reset(seed=seed)
        reference = EventLocatedArm(arm.params, arm.state)
        controller, memory = PaperController(), None
        over = False
        while not over:
            action, memory = controller.predict(observation[None], memory)
            observation, _, terminated, over, _ = env.step(action[0])
            assert not terminated
            reference.advance(float(action[0, 0]) * arm.params.torque_limit, beltarm_env.CONTROL_PERIOD)
            distance = np.linalg.norm(tip(arm.params, arm.state) - tip(reference.params, reference.state))
            worst = max(worst, float(distance))
        changes += len(reference.mode_changes)
    return worst, changes


def training() -> tuple[float, float, str]:
    """Seconds until cost, tip RMS and residual vibration are all halved on validation arms, and of the whole run.

    Also returns the ratios to the base controller that the best policy reached.
    """
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, str(ROOT / "train" / "ppo.py"), "--out", folder]
        subprocess.run([*command, "--validation-every", "100000"], check=True, stdout=subprocess.DEVNULL)
        with (Path(folder) / "validation.csv").open(newline="", encoding="utf-8") as file:
            rows = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]
        provenance = json.loads((Path(folder) / "best" / "policy.json").read_text())["provenance"]
    base = provenance["validation_of_base"]
    halved = [row["seconds"] for row in rows if all(row[name] <= 0.5 * base[name] for name in base)]
    reached = provenance["reached"]["validation"]
    shown = ", ".join(f"{name} {reached[name] / base[name]:.2f}x" for name in base)
    return min(halved, default=float("inf")), rows[-1]["seconds"], shown


def training_loop(console: Console, table: Table) -> None:
    """Speed of `train/ppo.py`'s loop beside the same PPO on single arms; prints where its time goes."""
    from eval.speed import training_loop as loop

    config = loop.Config()
    console.print(loop.shares_table(config, _ITERATIONS))
    loops = [loop.iteration_on_batch(config), loop.iteration_on_single_arms(config)]
    batch, single = (config.arms * config.rollout_steps * config.hold / took for took in best_times(loops, 3))
    table.add_row(
        f"PPO, rollout and update, {config.arms} arms",
        f"{batch / 1e3:.0f} k steps/s",
        f"PPO on {loop.SINGLE_ARMS} single arms in a DummyVecEnv: {single / 1e3:.1f} k steps/s",
        f"{batch / single:.1f}x",
    )


def main() -> None:
    """Command line."""
    config = tyro.cli(Config, description=__doc__)
    console = Console()
    table = Table("what", "measured", "peer", "ratio", title=f"{os.cpu_count()} cores", title_justify="left")

    batches = [
        batch_steps("BeltArm-v0", config, randomization="train"),
        batch_steps("BeltArm-v0", config, randomization="train", model="lagrangian"),
        batch_steps("CartPole-v1", config),
    ]
    arms, full, cart = (time / config.steps for time in best_times(batches, config.repetitions))
    table.add_row(
        f"vector step, N = {config.arms}",
        f"{config.arms / arms / 1e6:.1f} M steps/s",
        f"CartPole-v1: {config.arms / cart / 1e6:.1f} M steps/s",
        f"{cart / arms:.2f}x",
    )
    table.add_row(
        f"vector step of the full arm, N = {config.arms}",
        f"{config.arms / full / 1e6:.1f} M steps/s",
        "lumped arm, the row above",
        f"{arms / full:.2f}x",
    )
    singles = [single_steps("BeltArm-v0", config), single_steps("CartPole-v1", config)]
    arm, cart = (time / (100 * config.steps) for time in best_times(singles, config.repetitions))
    table.add_row(
        "single step through make", f"{1e6 * arm:.2f} us", f"CartPole-v1: {1e6 * cart:.2f} us", f"{cart / arm:.2f}x"
    )
    worst, changes = accuracy()
    table.add_row(
        f"tip error of 5 stick-slip episodes, {changes} mode changes",
        f"{1e6 * worst:.4f} um",
        "event-located DOP853",
        "-",
    )
    starts = min(config.repetitions, 3)
    with tempfile.TemporaryDirectory() as folder:
        _, cold = start_up(Path(folder))
        warm = [start_up(Path(folder)) for _ in range(starts)]
    numba_alone = min(numba_start_up() for _ in range(starts))
    peer = f"numba, empty function: {numba_alone:.2f} s"
    first = min(run[1] for run in warm)
    table.add_row("import beltarm_env", f"{min(run[0] for run in warm):.2f} s", "-", "-")
    table.add_row("make, reset, first step: warm cache", f"{first:.2f} s", peer, f"{numba_alone / first:.2f}x")
    table.add_row("make, reset, first step: cold cache", f"{cold:.1f} s", peer, f"{numba_alone / cold:.2f}x")
    if config.training:
        half, whole, reached = training()
        table.add_row(
            "training until cost, tip RMS and residual are halved", f"{half:.0f} s", "the paper's controller", "0.50x"
        )
        table.add_row("training, whole run", f"{whole:.0f} s", "the paper's controller", reached)
    if config.training_loop:
        training_loop(console, table)
    console.print(table)


if __name__ == "__main__":
    main()
