"""Measure speed: `python eval/bench.py`, or `make bench`.

Each number stands beside a peer that is measured in the same run, in turns. Prints the page and writes data.json,
page.md and a picture into results/bench.
"""

import sys
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines.tools.command import run_command, stop_without

try:
    from eval.speed import bench
    from eval.studies import _frame
except ModuleNotFoundError as error:
    stop_without("eval/bench.py", error)


def run(options: bench.Options) -> None:
    """Measure, write and print."""
    study: Any = bench
    folder = _frame.run(study, options)
    print((folder / _frame.PAGE).read_text(encoding="utf-8"), f"written to {folder}", sep="\n")


def main() -> None:
    """Command line."""
    run_command(__file__, bench.Options, run, __doc__, partial(_frame.quick_ones, bench))


if __name__ == "__main__":
    main()
