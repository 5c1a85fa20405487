"""Compiles what the first commands need: `python -m agents.compile_kernels`, the last step of `make setup`.

Each controller, and a shipped policy, runs one episode: its kernels are compiled and kept for later.
"""

from __future__ import annotations

import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import gymnasium as gym
import numpy as np

from agents.policy.bundle import POLICIES, load_controller
from baselines.registry import CONTROLLERS
from beltarm_env.rollout import rollout

POLICY = POLICIES / "student" / "seed0"


def run_once(name: str) -> None:
    """Run a controller or "policy" on randomized arms, or "environment", what a first program runs."""
    if name == "environment":
        for randomization in ("off", "train"):
            env = gym.make("beltarm_env:BeltArm-v0", randomization=randomization)
            env.reset(seed=0)
            env.step(np.zeros(1, np.float32))
        return
    controller: Any = load_controller(POLICY) if name == "policy" else CONTROLLERS[name]()
    rollout(controller, 2, seed=0, randomization="train")


def main() -> None:
    """Run them all, in two processes; those first that take longest."""
    names = dict.fromkeys(("environment", "policy", "mpc", "adaptive", *CONTROLLERS))
    with ProcessPoolExecutor(min(2, os.cpu_count() or 1), multiprocessing.get_context("spawn")) as pool:
        list(pool.map(run_once, names))


if __name__ == "__main__":
    main()
