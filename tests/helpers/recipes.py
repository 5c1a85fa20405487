"""The recipes of CONTRIBUTING.md, followed to the letter in a copy of the sources."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("beltarm_env", "baselines", "agents", "train", "eval")
_STEP = re.compile(r"^(New file|In) `([^`]+)`[^\n]*\n\n```\w+\n(.*?)^```$", re.M | re.S)


def recipe(title: str) -> list[tuple[str, str, str]]:
    """Return the steps below a heading: "New file" or "In", the path, and what is written there."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    _, section = text.split(f"### {title}\n", 1)
    return [(found[1], found[2], found[3]) for found in _STEP.finditer(re.split(r"^##", section, flags=re.M)[0])]


def follow(title: str, folder: Path) -> list[str]:
    """Follow a recipe in a copy of the sources; returns the files that it names.

    A difference is a run of lines that the file has exactly once: " " stays, "-" goes, "+" comes.
    """
    for package in PACKAGES:
        shutil.copytree(ROOT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
    steps = recipe(title)
    for kind, name, text in steps:
        path = folder / name
        if kind == "New file":
            assert not path.exists(), f"{name} is there already"
            path.write_text(text, encoding="utf-8")
            continue
        for hunk in re.split(r"^@@.*\n", text, flags=re.M):
            lines = hunk.splitlines(keepends=True)
            before = "".join(line[1:] for line in lines if line[0] in " -")
            after = "".join(line[1:] for line in lines if line[0] in " +")
            source = path.read_text(encoding="utf-8")
            assert source.count(before) == 1, f"{name} has not once:\n{before}"
            path.write_text(source.replace(before, after), encoding="utf-8")
    return [name for _, name, _ in steps]


def run(folder: Path, *words: str, compiled: bool = True) -> str:
    """Run Python in the copy and return what it prints; `compiled=False` runs the kernels as plain Python."""
    environment = {**os.environ, "PYTHONPATH": str(folder)} | ({} if compiled else {"NUMBA_DISABLE_JIT": "1"})
    done = subprocess.run([sys.executable, *words], cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout
