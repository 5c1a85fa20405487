"""Write the comparison's numbers into the README: `python eval/readme.py`, or `make readme` to measure first.

Everything between the README's markers comes from `docs/results/comparison/results.json`. `--check` fails where the
README differs, and where the summary or a picture beside that file does not belong to it.
The drawing of the arm, `docs/arm.svg`, is the report's.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines.tools.command import run_command
from baselines.tools.files import write_text
from eval.comparison.schema import read_results
from eval.report.arm import arm_drawing
from eval.report.readme import blocks, of_other_results, updated

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "docs" / "results" / "comparison" / "results.json"
README = ROOT / "README.md"
ARM = ROOT / "docs" / "arm.svg"


@dataclass(frozen=True)
class Config:
    """Write the comparison's numbers into the README."""

    check: bool = False
    """Change nothing. Exit with 1 if README, summary or pictures do not belong to the committed results, or if the
    drawing of the arm is not the report's."""


def run(config: Config) -> None:
    """Write the numbers, or check them."""
    readme = README.read_text(encoding="utf-8")
    fresh = updated(readme, blocks(read_results(RESULTS)))
    if not config.check:
        write_text(README, fresh)
        write_text(ARM, arm_drawing())
        return
    stale = [README] if fresh != readme else []
    stale += [ARM] if ARM.read_text(encoding="utf-8") != arm_drawing() else []
    stale += of_other_results(RESULTS)
    if stale:
        names = ", ".join(str(path.relative_to(ROOT)) for path in stale)
        print(f"eval/readme.py: not of {RESULTS.relative_to(ROOT)}: {names}; run `make readme`", file=sys.stderr)
        sys.exit(1)


def main() -> None:
    """Command line."""
    run_command(__file__, Config, run, __doc__)


if __name__ == "__main__":
    main()
