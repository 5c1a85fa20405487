"""Submit a controller or policy to the leaderboard, or verify a submission: `python eval/submit.py results/mine`.

Packs a comparison's folder into one archive in docs/leaderboard, to be offered by a pull request. Nothing of what is
submitted is executed but by --verify, which runs it again and compares. See docs/benchmark/leaderboard.md.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # a process per core; read as numpy is imported, in all of them
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MKL_NUM_THREADS", "1")

import tyro
from rich.console import Console

from baselines.engines.parallel import default_jobs
from baselines.tools.command import require_bounds, run_command
from baselines.tools.files import sha256_of, write_text
from baselines.tools.options import Groups
from baselines.tools.progress import progress_count
from eval.leaderboard.entries import (
    SEALED,
    TEST,
    add_archive,
    add_result,
    board_rules,
    read_entries,
    require_verifier,
    sealed_rules,
)
from eval.leaderboard.packing import pack
from eval.leaderboard.scores import first_difference, largest_difference
from eval.leaderboard.submission import read
from eval.leaderboard.table import table
from eval.leaderboard.verification import require_trust, rerun
from eval.report.readme import updated

PAGE = Path(__file__).resolve().parent.parent / "docs" / "benchmark" / "leaderboard.md"
FOLDER = PAGE.with_suffix("")


@dataclass(frozen=True)
class Config:
    """Submit a controller or policy to the leaderboard, or verify a submission."""

    groups: ClassVar[Groups] = {
        "submit": ("results", "author"),
        "verify": ("verify", "trust", "by", "sealed", "jobs"),
        "table": ("table",),
    }

    results: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="[FOLDER]")] = None
    """Folder that eval/compare.py wrote, with one method of your own on the full test set. It is packed."""
    author: str = ""
    """Your name, as the leaderboard shows it."""
    verify: Path | None = None
    """Archive to verify. Its hashes are checked. Then it is run again, and must score as submitted."""
    trust: bool = False
    """Run a controller: Python code of its author, with all your rights. Policies need no trust."""
    by: str = ""
    """Your name. Records a verification that succeeds, and writes the table again."""
    sealed: bool = False
    """Run it on the sealed set, once that is revealed."""
    jobs: int | None = None
    """Number of processes. Default: one per core."""
    table: bool = False
    """Write the table in docs/benchmark/leaderboard.md from the entries in docs/leaderboard."""

    def check(self) -> None:
        """Check that one thing is asked for.

        Raises:
            ValueError: If it is none, or several, or an option is out of place.
        """
        require_bounds(self, jobs=(1, 256))
        if (self.results is not None) + (self.verify is not None) + self.table != 1:
            raise ValueError("give the folder of a comparison to pack it, or --verify FILE, or --table")
        if self.verify is None and (self.trust or self.by or self.sealed):
            raise ValueError("--trust, --by and --sealed go with --verify FILE")


def run(config: Config) -> None:
    """Pack, verify or write the table; a submission that does not come out again exits with 1."""
    config.check()
    console = Console(soft_wrap=True, markup=False, highlight=False)
    if config.results is not None:
        submission = pack(config.results, config.author, board_rules())
        path = add_archive(submission, FOLDER)
        console.print(f"{path.name} holds {', '.join(submission.files)}")
        console.print(f"written to {path}, SHA-256 {sha256_of(path)}: offer it by a pull request that adds this file")
    if config.verify is not None:
        submission = read(config.verify, board_rules())
        rules = sealed_rules(config.verify) if config.sealed else board_rules()
        require_trust(submission, config.trust, config.verify.name)
        if config.by:
            require_verifier(config.by)
        with progress_count("pairs of method and split", console) as done:
            found = rerun(submission, rules, config.jobs or default_jobs(), done)
        if not config.sealed:
            if wrong := first_difference(submission.scores, found):
                print(f"eval/submit.py: {config.verify.name} does not come out again: {wrong.words}", file=sys.stderr)
                sys.exit(1)
            largest = largest_difference(submission.scores, found)
            how = f"; closest to the limit: {largest.words}" if largest.size else ", all scores the same"
            console.print(f"{config.verify.name} comes out again{how}")
        if config.by:
            console.print(
                f"written to {add_result(config.verify, SEALED if config.sealed else TEST, rules, found, config.by)}"
            )
    if config.table or config.by:
        page = PAGE.read_text(encoding="utf-8")
        write_text(PAGE, updated(page, {"table": table(read_entries(FOLDER), FOLDER.name)}))


def main() -> None:
    """Command line."""
    run_command(__file__, Config, run, __doc__)


if __name__ == "__main__":
    main()
