"""Pages that commands write of some splits of the development set."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from commands import stopped

from eval.comparison.sets import development_set

MISTAKES = [
    (("--episodes", "3"), "--episodes must lie within 4 and 500, got 3"),
    (("--splits", "nominl"), "unknown split 'nominl'; did you mean nominal?"),
    (("--out", "/dev/null/x"), "cannot write to /dev/null/x"),
]
"""Arguments that all of these commands refuse, and what they say."""


def tables_of(main: Callable[[], None], splits: tuple[str, ...], picture: str, folder: Path, *more: str) -> list[str]:
    """Tables of the page that a command writes of four episodes on each of some splits, beside one picture."""
    code, errors = stopped(main, ("--splits", *splits, "--episodes", "4", "--out", "out", *more), folder)
    assert code == 0, errors
    assert {path.name for path in (folder / "out").iterdir()} == {"summary.md", picture}
    page = (folder / "out" / "summary.md").read_text(encoding="utf-8")
    assert not re.search(r"\b(nan|inf)\b", page) and development_set().label.note in page
    return [block for block in page.split("\n\n") if block.startswith("|")]
