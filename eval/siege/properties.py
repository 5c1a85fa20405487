"""The property tests of the suite under seeds that nobody has tried."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np

from eval.siege.report import Siege

SEEDS = 200
"""In a whole siege; each has a fifth of the examples of `make test`."""
_ROOT = Path(__file__).resolve().parents[2]
_PATIENCE = 3600  # [s]


def besiege(share: float, seed: int) -> Siege:
    """Run the property tests at random.

    Args:
        share: Of a whole siege.
        seed: From which theirs are drawn.
    """
    siege = Siege("properties", "seeds of all property tests", "properties that no test states")
    seeds = np.random.default_rng(seed).integers(1, 10**6, size=max(1, round(SEEDS * share)))
    siege.count = len(seeds)
    siege.found += broken("-m", "hypothesis", seeds=seeds.tolist())
    return siege


def broken(*words: str, seeds: list[int]) -> list[str]:
    """Run some tests under seeds, and return a line for each that fails.

    Args:
        words: For pytest: which tests.
        seeds: Of those that are property tests.
    """
    options = ["-q", "--tb=short", "-p", "no:cacheprovider", "--hypothesis-profile", "siege"]
    command = [sys.executable, "-m", "pytest", *options, f"--seeds={','.join(map(str, seeds))}", *words]
    done = subprocess.run(command, cwd=_ROOT, capture_output=True, text=True, timeout=_PATIENCE, check=False)
    if done.returncode == 0:
        return []
    failed = [line for line in done.stdout.splitlines() if line.startswith("FAILED")]
    blamed = re.findall(r"with the seed \d+", done.stdout)
    lines = failed or [f"no end: {(done.stdout + done.stderr)[-200:]!r}"]
    return [f"make fuzz, {', '.join(blamed) or 'any seed'}: {line[:250]}" for line in lines]
