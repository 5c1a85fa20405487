"""Check a controller of your own: `python eval/check_controller.py path/to/file.py:Class`.

The comparison relies on these checks: `eval/compare.py --add` runs them first.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import tyro

from baselines.tools.command import run_command
from eval.comparison import custom
from eval.comparison.protocol import findings


@dataclass(frozen=True)
class Config:
    """Check that a controller keeps the protocol of the comparison."""

    controller: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="FILE.py:CLASS")]
    """Your controller."""
    traceback: bool = False
    """Print the whole traceback of each failure, to stderr."""


def run(config: Config) -> None:
    """Check and print what is found."""
    custom.make(config.controller)
    failed = 0
    for finding in findings(custom.factory(config.controller)):
        print(f"{'ok    ' if finding.passed else 'FAILED'}  {finding.check}: {finding.detail}", flush=True)
        if config.traceback and finding.trace:
            print(finding.trace, file=sys.stderr)
        failed += not finding.passed
    sys.exit(1 if failed else 0)


def main() -> None:
    """Command line."""
    run_command(__file__, Config, run, __doc__)


if __name__ == "__main__":
    main()
