"""Hostile controllers in a comparison: each fails by itself, in one line, and no other method is disturbed."""

import json
import re
import subprocess
import sys
from pathlib import Path

from tests.stress import hostile

ROOT = Path(__file__).resolve().parents[2]


def test_each_fails_by_itself(tmp_path: Path):
    kinds = ["Sound", *hostile.HARMLESS, *hostile.FAILING]
    added = [word for kind in kinds for word in ("--add", f"{hostile.__file__}:{kind}")]
    command = [sys.executable, str(ROOT / "eval" / "compare.py"), *added, "--methods", "paper", *kinds]
    command += ["--splits", "nominal", "--episodes", "4", "--out", "out", "--time-limit", "40"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=1200, check=False)
    assert done.returncode == 1, done.stderr[-2000:]
    failed = re.findall(r"^eval/compare\.py: (\w+) failed on nominal: .+$", done.stderr, re.MULTILINE)
    assert sorted(failed) == sorted(hostile.FAILING)
    results = json.loads((tmp_path / "out" / "results.json").read_text(encoding="utf-8"))
    rows = {row["method"]: row["metrics"] for row in results["rows"]}
    assert set(rows) == {"paper", "Sound", *hostile.HARMLESS}
    assert all(rows[kind] == rows["Sound"] for kind in hostile.HARMLESS), "nobody notices"
