"""Hostile controllers in a comparison, which has to go on without them."""

from __future__ import annotations

import json
import random
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from eval.siege import hostile
from eval.siege.report import Siege

_ROOT = Path(__file__).resolve().parents[2]
_LIMIT = 40  # [s] that a controller may take
_PATIENCE = 1200  # [s] for a comparison


def besiege(share: float, seed: int) -> Siege:
    """Compare hostile controllers with the paper's: each fails by itself, in one line, and nobody else is disturbed.

    Args:
        share: Of the kinds of mischief, at least two.
        seed: Of the choice.
    """
    blind = "controllers that attack the machine itself: their processes have all rights of their user"
    siege = Siege("controllers", "hostile controllers", blind)
    count = max(2, round(share * len(hostile.KINDS)))
    kinds = sorted(random.Random(seed).sample(hostile.KINDS, count))
    with tempfile.TemporaryDirectory() as folder:
        code, errors, rows = _compared(Path(folder), ["Sound", *kinds])
    siege.count = len(kinds)
    failing = [kind for kind in kinds if kind not in hostile.HARMLESS]
    if code != (1 if failing else 0):
        siege.found.append(f"{kinds}: exit status {code}: {errors[-300:]!r}")
    for kind in kinds:
        lines = re.findall(rf"^eval/compare\.py: {kind} failed on nominal: (.+)$", errors, re.MULTILINE)
        if kind in failing and (len(lines) != 1 or kind in rows):
            siege.found.append(f"{kind}: {len(lines)} lines of failure, {'a' if kind in rows else 'no'} row")
        if kind not in failing and (lines or rows.get(kind) != rows.get("Sound")):
            siege.found.append(f"{kind}: other metrics than without mischief, {rows.get(kind)}, {lines}"[:500])
    if not {"paper", "Sound"} <= set(rows):
        siege.found.append(f"{kinds}: of the others, only {sorted(rows)} have rows: {errors[-2000:]!r}")
    return siege


def _compared(folder: Path, kinds: list[str]) -> tuple[int, str, dict[str, Any]]:
    """Exit status, standard error, and metrics by method."""
    added = [word for kind in kinds for word in ("--add", f"{hostile.__file__}:{kind}")]
    command = [sys.executable, str(_ROOT / "eval" / "compare.py"), *added, "--methods", "paper", *kinds]
    command += ["--splits", "nominal", "--episodes", "4", "--out", str(folder / "out"), "--time-limit", str(_LIMIT)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=_PATIENCE, check=False)
    results = folder / "out" / "results.json"
    rows = json.loads(results.read_text(encoding="utf-8"))["rows"] if results.exists() else []
    return done.returncode, done.stderr, {row["method"]: row["metrics"] for row in rows}
