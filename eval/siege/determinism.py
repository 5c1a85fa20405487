"""The same episodes in other circumstances, which have to give the same bits."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from beltarm_env import BeltArmVectorEnv
from beltarm_env.arrays import Floats, Singles
from eval.siege.report import Siege

_ROOT = Path(__file__).resolve().parents[2]
_ARMS, _STEPS = 140, 25  # more than a block; in plain Python an arm's step takes milliseconds
_SETTINGS: tuple[dict[str, Any], ...] = (
    {"randomization": "train"},
    {"randomization": "ideal", "sensors": "accelerometer", "profile": "scurve"},
    {"randomization": "train", "model": "lagrangian", "sensors": "full", "profile": "quintic", "delay": 1.3},
)
_ELSEWHERE: dict[str, dict[str, str]] = {
    "plain Python": {"NUMBA_DISABLE_JIT": "1"},
    "a processor without wide vectors": {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""},
    "eight threads of every library": dict.fromkeys(
        ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "8"
    ),
    "another seed of Python's hashes": {"PYTHONHASHSEED": "7"},
    "another language and place": {"LC_ALL": "C", "LANG": "de_DE.UTF-8", "TZ": "Asia/Tokyo"},
}
_PATIENCE = 900  # [s]


def besiege(share: float, seed: int) -> Siege:
    """Compare hashes of episodes: batch sizes, and processes in other circumstances.

    Args:
        share: Of a whole siege, which has 40 batch sizes and five circumstances.
        seed: Of the episodes.
    """
    siege = Siege("determinism", "repetitions", "other machines: compare the hash with theirs")
    expected = episodes(seed)
    rng = np.random.default_rng(seed)
    for _ in range(max(1, round(40 * share))):
        batch = int(rng.integers(1, _ARMS))
        siege.count += 1
        if episodes(seed, batch) != expected:
            siege.found.append(f"seed {seed}: other bits in batches of {batch}")
    count = max(1, round(len(_ELSEWHERE) * share))
    for name, variables in list(_ELSEWHERE.items())[:count]:
        siege.count += 1
        if (given := _elsewhere(seed, variables)) != expected:
            siege.found.append(f"seed {seed}: with {name} {given}, not {expected}")
    siege.unit += f" of the episodes with the hash {expected[:16]}"
    return siege


def episodes(seed: int, batch: int = _ARMS) -> str:
    """SHA-256 of what some arms show, in batches."""
    total = hashlib.sha256()
    for number, settings in enumerate(_SETTINGS):
        torques = np.random.default_rng([seed, number]).uniform(-1, 1, (_STEPS, _ARMS, 1)).astype(np.float32)
        shown = [_shown(settings, seed, torques, low, min(low + batch, _ARMS)) for low in range(0, _ARMS, batch)]
        total.update(np.concatenate(shown, axis=1).tobytes())
    return total.hexdigest()


def _shown(settings: dict[str, Any], seed: int, torques: Singles, low: int, high: int) -> Floats:
    """What arms from one to another show, shape (steps + 1, arms, numbers)."""
    env = BeltArmVectorEnv(high - low, **settings)
    observations, _ = env.reset(seed=seed + low)
    seen = [np.column_stack([observations.astype(np.float64), env.state, np.zeros(high - low)])]
    for torque in torques[:, low:high]:
        observations, rewards, *_ = env.step(torque)
        seen.append(np.column_stack([observations.astype(np.float64), env.state, rewards]))
    return np.array(seen)


def _elsewhere(seed: int, variables: dict[str, str]) -> str:
    """The hash that another process prints."""
    words = [sys.executable, "-W", "ignore", "-c", f"from {__name__} import episodes; print(episodes({seed}))"]
    environment = {**os.environ, **variables, "PYTHONPATH": str(_ROOT)}
    done = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=_PATIENCE, check=False)
    return done.stdout.strip() or done.stderr.strip().splitlines()[-1]
