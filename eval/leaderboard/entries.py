"""Entries of the leaderboard: verified submissions, in a folder that has for each its archive and what was found.

NAME.zip     as its author packed it
NAME.json    the archive's SHA-256, and what came out when it was run again: by whom, when, on which commit
"""

from __future__ import annotations

import hashlib
import json
import platform
import re
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from baselines.tools.files import read_text, sha256_of, write_atomically, write_text
from baselines.tools.provenance import commit, software
from baselines.tools.schema import check, loads
from eval.comparison.scenarios import choose_set
from eval.comparison.sets import TEST_NAME
from eval.comparison.splits import EPISODES
from eval.leaderboard import sealed
from eval.leaderboard.archive import archived
from eval.leaderboard.scores import Scores, first_difference
from eval.leaderboard.submission import PERSON, SCORES, Rules, Submission, read, require_person

_TEXT = {"type": "string"}
_RUN = {
    "type": "object",
    "required": ["by", "date", "software", "machine", "scenario_set", "scores"],
    "properties": {
        "by": PERSON,
        "date": {"type": "string", "pattern": r"^\d{4}-\d\d-\d\d$"},
        "software": {
            "type": "object",
            "required": ["commit"],
            "properties": {"commit": {"type": "string", "pattern": r"^[\w.-]+$"}},
        },
        "machine": _TEXT,
        "scenario_set": {"type": "object", "required": ["name", "sha256"]},
        "scores": SCORES,
    },
}
_SCHEMA = {
    "type": "object",
    "required": ["archive", "sha256", "test"],
    "additionalProperties": False,
    "properties": {
        "archive": {"type": "string", "pattern": r"^[A-Za-z0-9_-]+\.zip$"},
        "sha256": _TEXT,
        "test": _RUN,
        "sealed": _RUN,
    },
}
TEST, SEALED = "test", "sealed"
"""Sets that an entry has results on; of the sealed one only after it was revealed."""


@dataclass(frozen=True, slots=True)
class Entry:
    """Entry of the leaderboard."""

    record: dict[str, Any]  # content of its JSON file
    submission: Submission

    @property
    def references(self) -> list[str]:
        """Methods of the project that ran beside it; costs over all splits are relative to the first."""
        return [name for name in self.submission.scores if name != self.submission.method]

    def scores(self, of: str = TEST) -> Scores:
        """Scores that were found, on the test set or the sealed one."""
        return self.record[of]["scores"]


def board_rules() -> Rules:
    """Rules of the leaderboard: all scenarios of the test set.

    Raises:
        ValueError: If it is not drawn yet.
    """
    return Rules(choose_set(TEST_NAME), EPISODES)


def sealed_rules(archive: Path) -> Rules:
    """Rules of the sealed set for an archive: that it was there before the set was known, and verified.

    Raises:
        ValueError: If the sealed set is not revealed yet, or the archive came later, or is not verified.
    """
    scenarios = sealed.sealed_set()
    if not archive.with_suffix(".json").exists():
        raise ValueError(f"{archive.name} is not verified on the test set yet: do that first, with --by")
    if sha256_of(archive) not in sealed.read()["submissions"]:
        raise ValueError(f"{archive.name} came after the sealed set was revealed: it has no result on it")
    return Rules(scenarios, EPISODES)


def add_archive(submission: Submission, folder: Path) -> Path:
    """Write a submission's archive into the leaderboard's folder, named by method and SHA-256."""
    content = archived(submission.files, submission.method)
    name = f"{re.sub(r'[^A-Za-z0-9_-]', '-', submission.method)}-{hashlib.sha256(content).hexdigest()[:8]}.zip"
    write_atomically(folder / name, lambda path: path.write_bytes(content))
    return folder / name


def require_verifier(by: str) -> None:
    """Check that what is found can be recorded: on a clean commit, under somebody's name.

    Raises:
        ValueError: If not.
    """
    require_person(by, "--by")
    if commit() == "unknown" or commit().endswith("-dirty"):
        raise ValueError(
            f"a verification is recorded on a clean commit, this is {commit()}: commit or undo the changes"
        )


def add_result(archive: Path, of: str, rules: Rules, scores: Scores, by: str) -> Path:
    """Record what came out beside the archive; see `require_verifier` and `sealed_rules`."""
    path = archive.with_suffix(".json")
    record: dict[str, Any] = {"archive": archive.name, "sha256": sha256_of(archive)}
    if of == SEALED:
        record = json.loads(path.read_text(encoding="utf-8"))
    record[of] = {
        "by": by,
        "date": datetime.now(UTC).date().isoformat(),
        "software": software("numpy", "numba", "scipy", "torch", "gymnasium"),
        "machine": platform.machine(),
        "scenario_set": rules.scenarios.label._asdict(),
        "scores": scores,
    }
    write_text(path, json.dumps(record, indent=1, allow_nan=False) + "\n")
    return path


def read_entries(folder: Path, rules: Rules | None = None) -> list[Entry]:
    """Read all entries, each with its archive, and check that they agree with it.

    Args:
        folder: Of the leaderboard.
        rules: By default those of `board_rules`.

    Raises:
        ValueError: If one is damaged, of another set of scenarios, or says other than its archive.
    """
    paths = sorted(folder.glob("*.json"))
    rules = rules or (board_rules() if paths else None)
    return [_entry(path, rules) for path in paths if rules]


def _entry(path: Path, rules: Rules) -> Entry:
    try:
        record = loads(read_text(path), parse_constant=str)
    except ValueError as error:
        raise ValueError(f"{path} is damaged ({error}): verify its archive again") from None
    check(record, path.name, _SCHEMA)
    archive = path.with_suffix(".zip")
    if not archive.is_file() or (record["archive"], record["sha256"]) != (archive.name, sha256_of(archive)):
        raise ValueError(f"{path.name} is of another archive than {archive.name}, or there is none: verify it again")
    if record[TEST]["scenario_set"] != rules.scenarios.label._asdict():
        raise ValueError(f"{path.name} is of other scenarios than the test set: move it to docs/history")
    submission = read(archive, rules)
    try:
        wrong = first_difference(submission.scores, record[TEST]["scores"])
    except KeyError as error:
        raise ValueError(f"{path.name} has no scores of {error}: verify its archive again") from None
    if wrong:
        raise ValueError(f"{path.name} does not agree with its archive: {wrong.words}")
    return Entry(record, submission)
