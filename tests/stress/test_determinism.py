"""The same episodes in other circumstances have the same bits."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beltarm_env import BeltArmVectorEnv

ROOT = Path(__file__).resolve().parents[2]
ARMS, STEPS = 140, 25  # more than a block; in plain Python an arm's step takes milliseconds
SETTINGS: tuple[dict[str, Any], ...] = (
    {"randomization": "train"},
    {"randomization": "ideal", "sensors": "accelerometer", "profile": "scurve"},
    {"randomization": "train", "model": "lagrangian", "sensors": "full", "profile": "quintic", "delay": 1.3},
)
ELSEWHERE: dict[str, dict[str, str]] = {
    "plain Python": {"NUMBA_DISABLE_JIT": "1"},
    "a processor without wide vectors": {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""},
    "eight threads": dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "8"),
    "another seed of Python's hashes": {"PYTHONHASHSEED": "7"},
    "another language and place": {"LC_ALL": "C", "LANG": "de_DE.UTF-8", "TZ": "Asia/Tokyo"},
}


@pytest.mark.parametrize("circumstances", ELSEWHERE)
def test_other_circumstances(circumstances: str):
    path = os.pathsep.join(map(str, (ROOT, ROOT / "tests" / "helpers", Path(__file__).parent)))
    environment = {**os.environ, **ELSEWHERE[circumstances], "PYTHONPATH": path}
    code = "from tests.stress.test_determinism import episodes; print(episodes(3))"
    words = [sys.executable, "-W", "ignore", "-c", code]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=900, check=True)
    assert done.stdout.strip() == episodes(3)


def episodes(seed: int) -> str:
    """SHA-256 of observations, states and rewards of a batch in each of the settings."""
    total = hashlib.sha256()
    for number, settings in enumerate(SETTINGS):
        env = BeltArmVectorEnv(ARMS, **settings)
        total.update(env.reset(seed=seed)[0].tobytes())
        for torque in np.random.default_rng([seed, number]).uniform(-1, 1, (STEPS, ARMS, 1)).astype(np.float32):
            observations, rewards, *_ = env.step(torque)
            for values in (observations, env.state, rewards):
                total.update(np.ascontiguousarray(values).tobytes())
    return total.hexdigest()
