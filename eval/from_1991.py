"""Show the steps from the paper's controller to the best classical one: `python eval/from_1991.py`.

Writes summary.md, with a table, and a waterfall of the cost.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines.tools.command import require_bounds, run_command, stop_without

try:
    from baselines.tools.files import require_writable, write_text
    from baselines.tools.provenance import command_line, commit
    from beltarm_env import __version__
    from eval.studies.steps.page import markdown, table
    from eval.studies.steps.study import ADVANCES, BESIDE, MOST_ARMS, measure
except ModuleNotFoundError as error:
    stop_without("eval/from_1991.py", error)


@dataclass(frozen=True)
class Config:
    """Show what each step from the paper's controller to the best classical one brings."""

    out: Path = Path("results/from_1991")
    """Folder for summary.md and the picture."""
    arms: int = 256
    """Number of arms, 4 to 10000."""


def report(config: Config) -> None:
    """Measure everything and write it to the folder.

    Raises:
        ValueError: If an option is not allowed, or a file of gains is damaged.
        OSError: If the folder cannot be written to.
    """
    began = time.perf_counter()
    require_bounds(config, arms=(4, MOST_ARMS))
    require_writable(config.out)
    found = [measure(advance, config.arms) for advance in (*ADVANCES, BESIDE)]
    origin = f"`{command_line()}`, beltarm {__version__} ({commit()}), {time.perf_counter() - began:.0f} s."
    write_text(config.out / "summary.md", markdown(found, config.out, origin))
    print(table(found))
    print(f"written to {config.out}: summary.md, 1 picture")


def main() -> None:
    """Command line."""
    run_command(__file__, Config, report, __doc__)


if __name__ == "__main__":
    main()
