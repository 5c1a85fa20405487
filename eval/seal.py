"""Seal the scenarios that nobody may know before an edition closes, and open them: `python eval/seal.py`.

Without options it says what is published: eval/leaderboard/sealed.json. For maintainers.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines.tools.command import run_command
from baselines.tools.files import sha256_of
from eval.leaderboard import sealed

FOLDER = Path(__file__).resolve().parent.parent / "docs" / "leaderboard"


@dataclass(frozen=True)
class Config:
    """Seal the scenarios of this edition, or open them."""

    draw: Path | None = None
    """New file for the secret of this edition, outside the repository. It is drawn once, as the edition begins, and its
    hash is published."""
    reveal: Path | None = None
    """File of the secret, which is published as the edition closes. Archives that are on the leaderboard by then take
    part; later ones do not."""


def run(config: Config) -> None:
    """Draw or reveal the secret, and say what is published."""
    if config.draw is not None:
        sealed.seal(config.draw)
    if config.reveal is not None:
        sealed.reveal(config.reveal, [sha256_of(path) for path in FOLDER.glob("*.zip")])
    published = sealed.read()
    print(f"edition {published['edition']}: sha256 {published['sha256']} of a line {published['text']!r}")
    print(f"revealed: {published['revealed'] or 'not yet'}")
    if published["revealed"]:
        print(
            f"scenarios: sha256 {sealed.sealed_set().label.sha256}; {len(published['submissions'])} archives take part"
        )


def main() -> None:
    """Command line."""
    run_command(__file__, Config, run, __doc__)


if __name__ == "__main__":
    main()
