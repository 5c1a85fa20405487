"""Compiles what the first commands need: `python -m agents.ahead`, the last step of `make setup`.

Each controller, and a shipped policy, runs one episode: its kernels are compiled and kept for later.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from agents.policy.bundle import load_controller
from baselines.registry import CONTROLLERS
from beltarm_env.rollout import rollout

POLICY = Path(__file__).parent / "policies" / "student" / "seed0"


def run_once(name: str) -> None:
    """Run a controller or "policy" on arms as they are built, or "environment", what a first program runs."""
    if name == "environment":
        for randomization in ("off", "train"):
            env = gym.make("beltarm_env:BeltArm-v0", randomization=randomization)
            env.reset(seed=0)
            env.step(np.zeros(1, np.float32))
        return
    make: Callable[[], Any] = CONTROLLERS.get(name, lambda: load_controller(POLICY))
    rollout(make(), 2, seed=0, randomization="train")


def main() -> None:
    """Run them all, in two processes."""
    first = ("environment", "policy", "mpc", "adaptive")  # which take longest
    names = [*first, *(name for name in CONTROLLERS if name not in first)]
    with ProcessPoolExecutor(min(2, os.cpu_count() or 1), multiprocessing.get_context("spawn")) as pool:
        list(pool.map(run_once, names))


if __name__ == "__main__":
    main()
