"""The sealed set: scenarios that nobody can prepare for, because their seed is a secret of which the hash is published.

The secret is one line of text,

    beltarm sealed EDITION SEED SALT

of which `sealed.json` has the SHA-256 while the edition lasts. The salt, 128 random bits, keeps the seed from being
found by trying. The seed chooses a range of seeds beyond all others. As the edition closes, the line itself is written
beside its hash, with the SHA-256 of all archives that are on the leaderboard by then: whoever submits later may know
the set, and has no result on it.
"""

from __future__ import annotations

import hashlib
import json
import re
import secrets
from pathlib import Path
from typing import Any

from baselines.tools.files import read_text, write_text
from baselines.tools.schema import check, loads
from beltarm_env.task.seeds import DEVELOPMENT, sealed_arms
from beltarm_env.task.seeds import SEALED as RANGE
from eval.comparison.sets import ScenarioSet, draw_set
from eval.comparison.splits import EDITION

FILE = Path(__file__).with_name("sealed.json")
SEALED = "the sealed seed"
"""Name of the set in results."""
SEEDS = RANGE.size // DEVELOPMENT.size
"""Number of ranges of seeds among which the secret chooses."""
_LINE = re.compile(r"beltarm sealed (\d{1,4}) (\d{1,13}) ([0-9a-f]{32})")
_TEXT = {"type": "string"}
_PROPERTIES = {
    "edition": {"type": "integer"},
    "text": {"const": "beltarm sealed EDITION SEED SALT"},
    "sha256": _TEXT,
    "revealed": _TEXT,
    "submissions": {"type": "array", "items": _TEXT},
}
_SCHEMA = {"type": "object", "required": list(_PROPERTIES), "properties": _PROPERTIES}


def draw_secret() -> str:
    """Draw a secret for this edition."""
    return f"beltarm sealed {EDITION} {secrets.randbelow(SEEDS)} {secrets.token_hex(16)}"


def seal(secret: Path, path: Path = FILE) -> None:
    """Draw the secret of this edition into a file, and write its hash.

    Raises:
        ValueError: If the secret would lie in the repository or replace a file, or this edition's hash is there.
    """
    if secret.resolve().is_relative_to(Path(__file__).resolve().parents[2]) or secret.exists():
        raise ValueError(f"{secret} is in the repository, or is there already: keep the secret in a new file elsewhere")
    if path.exists() and read(path)["edition"] == EDITION:
        raise ValueError(f"{path.name} has the hash of edition {EDITION} already: its secret is drawn once")
    line = draw_secret()
    write_text(secret, line)
    secret.chmod(0o600)
    _write(path, {"edition": EDITION, "sha256": digest_of(line), "revealed": "", "submissions": []})


def reveal(secret: Path, archives: list[str], path: Path = FILE) -> None:
    """Write the secret beside its hash, with the SHA-256 of all archives on the leaderboard.

    Raises:
        ValueError: If it is not the secret of which the hash is there, or is revealed already.
    """
    kept, line = read(path), secret.read_text(encoding="utf-8").strip()
    if kept["revealed"]:
        raise ValueError(f"{path.name} has the secret already")
    seed_of(line, kept)
    _write(path, {**kept, "revealed": line, "submissions": sorted(archives)})


def read(path: Path = FILE) -> dict[str, Any]:
    """Read what is published of the secret.

    Raises:
        ValueError: If the file is damaged.
    """
    try:
        content = loads(read_text(path))
    except (OSError, ValueError) as error:
        raise ValueError(f"{path} cannot be read ({error}): restore it from the repository") from None
    check(content, str(path), _SCHEMA)
    return content


def digest_of(line: str) -> str:
    """SHA-256 of a secret, as `printf %s 'beltarm sealed ...' | sha256sum` has it."""
    return hashlib.sha256(line.encode()).hexdigest()


def seed_of(line: str, published: dict[str, Any]) -> int:
    """Seed of a secret that is checked against what is published of it.

    Raises:
        ValueError: If its hash is not the published one, or it is of another form or edition.
    """
    if digest_of(line) != published["sha256"]:
        raise ValueError(
            f"the secret has the SHA-256 {digest_of(line)[:12]}, the published one is {published['sha256'][:12]}: "
            "it is not the one that was sealed"
        )
    match = _LINE.fullmatch(line)
    if match is None or int(match[1]) != EDITION or int(match[2]) >= SEEDS:
        raise ValueError(f"the secret must be 'beltarm sealed {EDITION} SEED SALT', with a seed below {SEEDS}")
    return int(match[2])


def sealed_set(path: Path = FILE) -> ScenarioSet:
    """Draw the sealed set, by the rules of the test set.

    Raises:
        ValueError: If its secret is not revealed yet, or is not the one that was sealed.
    """
    published = read(path)
    if not published["revealed"]:
        raise ValueError(
            f"the sealed set of edition {published['edition']} is not revealed yet: its seed is published as "
            "the edition closes; draw a set of your own with --scenario-seed 1"
        )
    return draw_set(SEALED, sealed_arms(seed_of(published["revealed"], published)))


def _write(path: Path, content: dict[str, Any]) -> None:
    write_text(path, json.dumps({"text": _PROPERTIES["text"]["const"], **content}, indent=1) + "\n")
