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
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from beltarm_env import BeltArmVectorEnv
from beltarm_env.arrays import Floats, Singles

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


@examples(5, shrink=False)
@given(st.integers(0, 2**31), st.integers(1, ARMS))
def test_batches_of_any_size(seed: int, batch: int):
    assert episodes(seed, batch) == episodes(seed)


def episodes(seed: int, batch: int = ARMS) -> str:
    """SHA-256 of observations, states and rewards of some arms, stepped in batches."""
    total = hashlib.sha256()
    for number, settings in enumerate(SETTINGS):
        torques = np.random.default_rng([seed, number]).uniform(-1, 1, (STEPS, ARMS, 1)).astype(np.float32)
        parts = [_part(settings, seed, torques, low, min(low + batch, ARMS)) for low in range(0, ARMS, batch)]
        total.update(np.concatenate(parts, axis=1).tobytes())
    return total.hexdigest()


def _part(settings: dict[str, Any], seed: int, torques: Singles, low: int, high: int) -> Floats:
    """Numbers of the arms from `low` to `high`, shape (steps + 1, arms, numbers)."""
    env = BeltArmVectorEnv(high - low, **settings)
    observations, _ = env.reset(seed=seed + low)
    seen = [np.column_stack([observations.astype(np.float64), env.state, np.zeros(high - low)])]
    for torque in torques[:, low:high]:
        observations, rewards, *_ = env.step(torque)
        seen.append(np.column_stack([observations.astype(np.float64), env.state, rewards]))
    return np.array(seen)
