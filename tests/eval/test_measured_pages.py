"""Pages of measurements: each names the command and the commit that it is of."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"
COMMIT = re.compile(r"(?:commit|beltarm(?: [\d.]+)?) \(?([0-9a-f]{7,40}(?:-dirty)?)\b")
MEASURED = [
    *(
        page
        for page in DOCS.glob("results/*/*.md")
        if page.name in ("summary.md", "tables.md", "tails.md", "ablations.md")
    ),
    *(
        DOCS / name
        for name in (
            "results/paper/drive.md",
            "results/bench/page.md",
        )
    ),
]


@pytest.mark.parametrize("page", MEASURED, ids=lambda page: page.relative_to(DOCS).as_posix())
def test_page_names_its_command_and_a_clean_commit(page: Path):
    text = page.read_text(encoding="utf-8")
    assert re.search(r"`(?:python|make) [^`]+`", text)
    named = COMMIT.findall(text)
    assert named and not named[-1].endswith("-dirty")
    assert not re.search(r"\btoday\b", text, re.IGNORECASE)


def test_pages_are_found():
    assert len(MEASURED) >= 15


def test_protocol_lists_commits_that_are_there():
    """What changed after the results, the committed results among it."""
    changes = (
        (DOCS / "benchmark" / "protocol.md").read_text(encoding="utf-8").split("## Changes made after the results")[1]
    )
    named = sorted(set(re.findall(r"\b(?=[0-9a-f]*\d)[0-9a-f]{7}\b", changes)))
    results = json.loads((DOCS / "results/comparison/results.json").read_text(encoding="utf-8"))
    assert results["provenance"]["commit"] in named
    try:
        whole = git("rev-parse", "--is-shallow-repository").stdout.strip() == "false"
    except OSError:
        whole = False
    if not whole:
        pytest.skip("the history is not there")
    missing = [commit for commit in named if git("merge-base", "--is-ancestor", commit, "HEAD").returncode]
    assert not missing


def git(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["git", *words], cwd=DOCS, capture_output=True, text=True, check=False)
