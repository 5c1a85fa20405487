"""The property tests of the suite under seeds that nobody has tried."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np

from eval.siege.report import Siege

SEEDS = 3
"""In a whole siege; each is ten times the examples of `make test`."""
_ROOT = Path(__file__).resolve().parents[2]
_PATIENCE = 3600  # [s]


def besiege(share: float, seed: int) -> Siege:
    """Run the property tests at random.

    Args:
        share: Of a whole siege.
        seed: From which theirs are drawn.
    """
    siege = Siege("properties", "seeds of all property tests", "properties that no test states")
    for given in np.random.default_rng(seed).integers(1, 10**6, size=max(1, round(SEEDS * share))):
        words = ["-m", "hypothesis", "--hypothesis-profile", "fuzz", f"--hypothesis-seed={given}"]
        command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *words]
        done = subprocess.run(command, cwd=_ROOT, capture_output=True, text=True, timeout=_PATIENCE, check=False)
        siege.count += 1
        if done.returncode:
            failed = [line for line in done.stdout.splitlines() if line.startswith("FAILED")]
            siege.found += [f"make fuzz ARGS=--hypothesis-seed={given}: {line[:250]}" for line in failed or ["no end"]]
    return siege
