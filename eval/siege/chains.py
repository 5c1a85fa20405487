"""Chains of kills from outside: a user's command, ended by SIGKILL at any moment, again and again.

A training is begun and killed, resumed and killed, and at last left alone: it has to come to the very files of one that
nobody touched. Then two are begun in one folder at a time: one of them has to be refused, and the other not to notice.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from eval.siege.report import Siege
from eval.siege.subjects import differences, meaning_of_training

LINKS, CHAINS = 10, 5
"""Kills of a chain, and chains in a whole siege."""
_LONGEST = 300.0  # that a command may take [s]
_EARLIEST = 0.4  # share of the time of a whole run that passes before a kill: what comes before is importing
_ROOT = Path(__file__).resolve().parents[2]
_TRAINING = """train/ppo.py --total-steps 1500 --validation-every 60 --arms 4 --validation-arms 2 --hold 40 --hidden 4
    --rollout-steps 8 --batch-size 32 --out""".split()


def besiege(share: float, seed: int) -> Siege:
    """Kill trainings in chains, and begin two at a time.

    Args:
        share: Of a whole siege.
        seed: Chooses the moments.
    """
    siege = Siege("chains", "kills from outside", "what a kill does to other commands than a training")
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch) / "run"
        began = time.monotonic()
        if words := _ended(_started(out)):
            siege.found.append(f"a training without kills: {words}")
            return siege
        whole, wanted = time.monotonic() - began, meaning_of_training(out)
        links = max(1, round(LINKS * CHAINS * share))
        for chain in range(-(-links // LINKS)):
            shutil.rmtree(out)
            moments = np.random.default_rng([seed, chain]).uniform(_EARLIEST, 1.0, min(LINKS, links - chain * LINKS))
            siege.count += len(moments)
            words = (
                _killed(out, whole * moments) or _ended(_started(out)) or differences(meaning_of_training, out, wanted)
            )
            siege.found += [f"chain {chain} of seed {seed}: {words}"] if words else []
        shutil.rmtree(out)
        siege.found += _two_at_a_time(out, wanted)
    return siege


def _started(out: Path) -> subprocess.Popen[str]:
    """Begin the training, or go on with it."""
    words = [sys.executable, *_TRAINING, str(out), *(["--resume"] if (out / "config.json").exists() else [])]
    return subprocess.Popen(words, cwd=_ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def _ended(command: subprocess.Popen[str]) -> str:
    """Wait for the end. Return words for what went wrong."""
    try:
        _, errors = command.communicate(timeout=_LONGEST)
    except subprocess.TimeoutExpired:
        command.kill()
        return f"it does not come to an end within {_LONGEST:g} s"
    return f"exit status {command.returncode}: {errors.strip()[-300:]}" if command.returncode else ""


def _killed(out: Path, moments: np.ndarray[Any, np.dtype[np.float64]]) -> str:
    """Kill the training at some moments after it was begun or resumed [s]. Return words if it fails by itself."""
    for moment in moments:
        command = _started(out)
        try:
            _, errors = command.communicate(timeout=float(moment))
        except subprocess.TimeoutExpired:
            command.kill()
            command.communicate()
            continue
        if command.returncode:
            return f"exit status {command.returncode}: {errors.strip()[-300:]}"
    return ""


def _two_at_a_time(out: Path, wanted: dict[str, Any]) -> list[str]:
    """Begin two trainings in one folder. Return lines for what went wrong."""
    both = [_started(out), _started(out)]
    ends = [_ended(one) for one in both]
    refused = [words for words in ends if "exit status 2" in words and str(out) in words]
    words = differences(meaning_of_training, out, wanted)
    if ends.count("") == 1 and len(refused) == 1 and not words:
        return []
    return [" ".join(f"two trainings at a time in one folder: {json.dumps(ends)} {words}".split())]
