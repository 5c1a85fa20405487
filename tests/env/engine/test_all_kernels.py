"""All kernels that Python calls run as C, and give the bits of plain Python."""

from __future__ import annotations

import pickle
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import python
from networks import SHAPES, episodes, lively
from recording_calls import recorded_calls

from agents.policy.bundle import POLICIES, load_controller
from agents.policy.network import NetworkPolicy
from baselines.guard.controller import guarded
from baselines.registry import CONTROLLERS, WITH_ACCELEROMETER
from beltarm_env import EPISODE_STEPS, BeltArmEnv, BeltArmVectorEnv
from beltarm_env.engine import PLAIN
from beltarm_env.observation import SENSORS

STEPS = 25
STUDENT = POLICIES / "student" / "seed0"
ROOT = Path(__file__).resolve().parents[3]
AGAIN = "import sys, pathlib; from recording_calls import differing; print(*differing(pathlib.Path(sys.argv[1])))"


def step_environments() -> None:
    """Step an arm and a batch, with what they can be made with."""
    for sensors, model, ranges in product(SENSORS, ("lumped", "lagrangian"), ("off", "train")):
        env = BeltArmEnv(sensors=sensors, model=model, randomization=ranges)  # pyright: ignore[reportArgumentType]
        batch = BeltArmVectorEnv(3, sensors=sensors, model=model, randomization=ranges, max_episode_steps=3)  # pyright: ignore[reportArgumentType]
        env.reset(seed=1)
        batch.reset(seed=1)
        for _ in range(STEPS):
            env.step(np.array([0.3], np.float32))
            batch.step(np.full((3, 1), -0.5, np.float32))
    for model, ranges in product(("lumped", "lagrangian"), ("off", "train")):  # into the second move
        for env in (
            BeltArmEnv(model=model, randomization=ranges, moves=2),
            BeltArmVectorEnv(3, model=model, randomization=ranges, moves=2),
        ):
            env.reset(seed=1)
            for _ in range(EPISODE_STEPS + 1):
                env.step(np.zeros(env.action_space.shape or (), np.float32))


def drive(controller: Any, sensors: str) -> None:
    """Drive a few arms by a controller."""
    env = BeltArmVectorEnv(3, sensors=sensors, randomization="train")  # pyright: ignore[reportArgumentType]
    observation, memory, begins = env.reset(seed=5)[0], None, np.ones(3, bool)
    for _ in range(STEPS):
        torque, memory = controller.predict(observation, memory, begins)
        observation, *_ = env.step(torque)
        begins = np.zeros(3, bool)


@pytest.mark.skipif(PLAIN, reason="kernels run in plain Python")
def test_all_kernels_run_as_c_and_give_the_bits_of_plain_python(tmp_path: Path):
    with recorded_calls() as calls:
        step_environments()
        for make in (*CONTROLLERS.values(), partial(guarded, "adaptive"), partial(load_controller, STUDENT)):
            drive(make(), "encoder")
        for make in WITH_ACCELEROMETER.values():
            drive(make(), "accelerometer")
        for shape in SHAPES.values():
            calls.count_anew()
            policy, memory = NetworkPolicy(lively(shape).weights()), None
            for seen in episodes(shape, 9, 2):
                _, memory = policy.predict(seen, memory)
    refused = {name: kernel._refused for name, kernel in calls.kernels.items() if kernel._refused}
    assert not refused and all(kernel._variants for kernel in calls.kernels.values()) and len(calls.kernels) > 35
    path = tmp_path / "calls"
    path.write_bytes(pickle.dumps(calls.made))
    assert python("-c", AGAIN, path, path=(ROOT, ROOT / "tests" / "helpers"), BELTARM_ENGINE="plain").split() == []
