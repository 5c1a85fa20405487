"""All kernels that Python calls run as C, and give the bits of plain Python."""

import pickle
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import ROOT, python
from episodes import torques_of
from networks import SHAPES, episodes, lively
from recording_calls import recorded_calls

from agents.policy.bundle import POLICIES, load_controller
from agents.policy.network import NetworkPolicy
from agents.residual.controller import behind_guard
from baselines.registry import CONTROLLERS, WITH_ACCELEROMETER
from beltarm_env import EPISODE_STEPS, BeltArmEnv, BeltArmVectorEnv
from beltarm_env.engine import PLAIN, kernels, library
from beltarm_env.observation import SENSORS

STEPS = 25
STUDENT = POLICIES / "student" / "seed0"
AGAIN = "import sys, pathlib; from recording_calls import differing; print(*differing(pathlib.Path(sys.argv[1])))"


def play(env: Any, action: float, steps: int) -> None:
    """Push back and forth, so that motors stick, slip and turn round."""
    env.reset(seed=1)
    for k in range(steps):
        env.step(np.full(env.action_space.shape, action * (-1) ** (k // 8), np.float32))


@pytest.mark.skipif(PLAIN, reason="kernels run in plain Python")
def test_all_kernels_run_as_c_and_give_the_bits_of_plain_python(tmp_path: Path):
    with recorded_calls() as calls:
        for model, ranges in product(("lumped", "lagrangian"), ("off", "train")):
            settings: dict[str, Any] = {"model": model, "randomization": ranges}
            for sensors in SENSORS:
                play(BeltArmEnv(sensors=sensors, **settings), 0.3, STEPS)
                play(BeltArmVectorEnv(3, sensors=sensors, max_episode_steps=3, **settings), -0.5, STEPS)
            for env in (BeltArmEnv(moves=2, **settings), BeltArmVectorEnv(3, moves=2, **settings)):
                play(env, 0.0, EPISODE_STEPS + 1)  # into the second move
        classical = [make() for make in CONTROLLERS.values()]
        for controller in (*classical, behind_guard(CONTROLLERS["adaptive"]()), load_controller(STUDENT)):
            torques_of(controller, 5, 3, STEPS, randomization="train")
        for make in WITH_ACCELEROMETER.values():
            torques_of(make(), 5, 3, STEPS, randomization="train", sensors="accelerometer")
        for shape in SHAPES.values():
            calls.count_anew()
            policy, memory = NetworkPolicy(lively(shape).weights()), None
            for seen in episodes(shape, 9, 2):
                _, memory = policy.predict(seen, memory)
    refused = {name: kernel._refused for name, kernel in calls.kernels.items() if kernel._refused}
    assert not refused and all(kernel._variants for kernel in calls.kernels.values()) and len(calls.kernels) > 35
    made = [(k.py_func, types, kernels.ENGINE == "checked") for k in calls.kernels.values() for types in k._variants]
    assert all(library._read(library._note_of(library.words_of(*one))) for one in made), "it is noted"
    path = tmp_path / "calls"
    path.write_bytes(pickle.dumps(calls.made))
    assert python("-c", AGAIN, path, path=(ROOT, ROOT / "tests" / "helpers"), BELTARM_ENGINE="plain").split() == []
