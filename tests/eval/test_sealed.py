"""The sealed set: a secret whose hash is published, and the scenarios that it draws once it is revealed."""

from __future__ import annotations

import hashlib
import json
import os
import stat
from pathlib import Path

import pytest
from commands import mistake, stopped

from beltarm_env.task.seeds import SEALED
from eval import compare as compare_command
from eval.comparison.splits import EDITION, EPISODES
from eval.leaderboard import sealed

ROOT = Path(__file__).resolve().parents[2]


def test_the_published_hash_is_of_this_edition_and_its_secret_is_not_here():
    published = sealed.read()
    assert published["edition"] == EDITION
    assert len(bytes.fromhex(published["sha256"])) == 32
    if not published["revealed"]:
        with pytest.raises(ValueError, match=f"sealed set of edition {EDITION} is not revealed yet"):
            sealed.sealed_set()
    else:
        sealed.sealed_set()


@pytest.fixture
def published(tmp_path: Path) -> Path:
    sealed.seal(tmp_path / "secret.txt", tmp_path / "sealed.json")
    return tmp_path / "sealed.json"


def test_a_secret_is_kept_until_it_is_revealed(published: Path):
    secret = published.with_name("secret.txt")
    line = secret.read_text()
    assert stat.S_IMODE(os.stat(secret).st_mode) == 0o600
    assert sealed.digest_of(line) == hashlib.sha256(secret.read_bytes()).hexdigest() in published.read_text()
    assert not any(part in published.read_text() for part in line.split()[3:])
    with pytest.raises(ValueError, match="is not revealed yet"):
        sealed.sealed_set(published)
    sealed.reveal(secret, ["b", "a"], published)
    content = sealed.read(published)
    assert (content["revealed"], content["submissions"]) == (line, ["a", "b"])
    drawn = sealed.sealed_set(published)
    assert drawn.label.name == sealed.SEALED
    assert len(drawn.splits["randomized"].moves) == EPISODES
    assert all(SEALED.first <= split.seed < SEALED.first + SEALED.size for split in drawn.splits.values())
    with pytest.raises(ValueError, match="has the secret already"):
        sealed.reveal(secret, [], published)


def test_another_secret_is_refused(published: Path, tmp_path: Path):
    (tmp_path / "other.txt").write_text(sealed.draw_secret())
    with pytest.raises(ValueError, match="is not the one that was sealed"):
        sealed.reveal(tmp_path / "other.txt", [], published)
    changed = sealed.read(published) | {"revealed": sealed.draw_secret()}
    published.write_text(json.dumps(changed))
    with pytest.raises(ValueError, match="is not the one that was sealed"):
        sealed.sealed_set(published)


@pytest.mark.parametrize(
    "line",
    [
        f"beltarm sealed {EDITION + 1} 1 {'0' * 32}",
        f"beltarm sealed {EDITION} 1",
        f"beltarm sealed {EDITION} 1 {'0' * 32}\n",
        f"beltarm sealed {EDITION} {10**13} {'0' * 32}",
    ],
)
def test_a_secret_of_another_form_is_refused(line: str):
    with pytest.raises(ValueError, match=f"with a seed below {sealed.SEEDS}"):
        sealed.seed_of(line, {"sha256": sealed.digest_of(line)})


def test_a_secret_is_drawn_once_and_never_into_the_repository(published: Path, tmp_path: Path):
    with pytest.raises(ValueError, match=f"has the hash of edition {EDITION} already"):
        sealed.seal(tmp_path / "again.txt", published)
    for place in (ROOT / "secret.txt", published):
        with pytest.raises(ValueError, match="is in the repository, or is there already"):
            sealed.seal(place, tmp_path / "new.json")
    assert not (tmp_path / "again.txt").exists()


@pytest.mark.slow
def test_the_comparison_runs_the_sealed_set_only_when_it_is_revealed(published: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(compare_command, "sealed_set", lambda: sealed.sealed_set(published))
    said = mistake(compare_command.main, ("--scenarios", "sealed"), published.parent)
    assert "is not revealed yet" in said
    said = mistake(compare_command.main, ("--scenarios", "sealed", "--scenario-seed", "1"), published.parent)
    assert "leave out --scenarios sealed" in said
    sealed.reveal(published.with_name("secret.txt"), [], published)
    few = ("--splits", "nominal", "--methods", "paper", "rigid", "--episodes", "4", "--jobs", "1", "--out", "out")
    code, errors = stopped(compare_command.main, ("--scenarios", "sealed", *few), published.parent)
    assert code == 0, errors
    results = json.loads((published.parent / "out" / "results.json").read_text())
    assert results["scenario_set"]["name"] == sealed.SEALED
