"""Check a controller of your own: `python eval/check_controller.py path/to/file.py:Class`.

The comparison relies on these checks: `eval/compare.py --add` runs them first.
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import tyro

from baselines.tools.command import require_bounds, run_command
from eval.comparison.check import isolated_findings
from eval.comparison.custom import LONGEST, TIME_LIMIT


@dataclass(frozen=True)
class Config:
    """Check that a controller keeps the protocol of the comparison."""

    controller: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="FILE.py:CLASS")]
    """Your controller."""
    time_limit: float = TIME_LIMIT
    """Seconds that all checks together may take. They run in a process of their own."""
    traceback: bool = False
    """Print the whole traceback of each failure, to stderr."""


def run(config: Config) -> None:
    """Check, and print each finding."""
    require_bounds(config, time_limit=(1, LONGEST))
    failed = 0
    for finding in isolated_findings(config.controller, config.time_limit):
        verdict = "FAILED" if not finding.passed else "late" if finding.late else "ok"
        print(f"{verdict:6}  {finding.check}: {finding.detail}", flush=True)
        if config.traceback and finding.trace:
            print(finding.trace, file=sys.stderr)
        failed += not finding.passed
    sys.exit(1 if failed else 0)


def main() -> None:
    """Command line."""
    run_command(__file__, Config, run, __doc__)


if __name__ == "__main__":
    main()
