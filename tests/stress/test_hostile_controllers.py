"""Hostile controllers in a comparison: each fails by itself, in one line, and no other method is disturbed."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.stress import hostile

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, dict[str, Any]]:
    """Standard error, and metrics by method."""
    folder, kinds = tmp_path_factory.mktemp("hostile"), ["Sound", *hostile.HARMLESS, *hostile.FAILING]
    added = [word for kind in kinds for word in ("--add", f"{hostile.__file__}:{kind}")]
    command = [sys.executable, str(ROOT / "eval" / "compare.py"), *added, "--methods", "paper", *kinds]
    command += ["--splits", "nominal", "--episodes", "4", "--out", str(folder / "out"), "--time-limit", "40"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=1200, check=False)
    assert done.returncode == 1, done.stderr[-2000:]
    rows = json.loads((folder / "out" / "results.json").read_text(encoding="utf-8"))["rows"]
    return done.stderr, {row["method"]: row["metrics"] for row in rows}


@pytest.mark.parametrize("kind", hostile.FAILING)
def test_it_alone_fails(kind: str, compared: tuple[str, dict[str, Any]]):
    errors, rows = compared
    assert len(re.findall(rf"^eval/compare\.py: {kind} failed on nominal: .+$", errors, re.MULTILINE)) == 1
    assert kind not in rows


@pytest.mark.parametrize("kind", hostile.HARMLESS)
def test_nobody_notices(kind: str, compared: tuple[str, dict[str, Any]]):
    errors, rows = compared
    assert f" {kind} failed" not in errors
    assert rows[kind] == rows["Sound"]


def test_all_others_have_their_rows(compared: tuple[str, dict[str, Any]]):
    assert set(compared[1]) == {"paper", "Sound", *hostile.HARMLESS}
