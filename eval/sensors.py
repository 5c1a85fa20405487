"""Show what an accelerometer on the arm's end brings: `python eval/sensors.py`.

Runs the best controllers and a student with and without it on the development set. Writes summary.md, with tables and a
picture.
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
    from eval.comparison.methods import chosen
    from eval.comparison.sets import development_set
    from eval.comparison.splits import EPISODES
    from eval.sensing.page import markdown, table
    from eval.sensing.study import NAMES, TIERS, Results, Times, measure, median_time
except ModuleNotFoundError as error:
    stop_without("eval/sensors.py", error)


@dataclass(frozen=True)
class Config:
    """Show what an accelerometer on the arm's end buys the best controllers and a student."""

    splits: tuple[str, ...] = ()
    """Splits to run. Default: all."""
    out: Path = Path("results/sensors")
    """Folder for summary.md and the picture."""
    episodes: int = 100
    """Scenarios per split, 4 to 500."""


def report(config: Config) -> None:
    """Measure everything and write it to the folder.

    Raises:
        ValueError: If an option is not allowed, or a file of gains is damaged.
        OSError: If the folder cannot be written to.
    """
    began = time.perf_counter()
    require_bounds(config, episodes=(4, EPISODES))
    require_writable(config.out)
    scenarios = development_set()
    splits = [scenarios.splits[name] for name in chosen("split", config.splits, scenarios.splits)]
    results: Results = {
        (name, split.name, tier): measure(name, tier, split, config.episodes)
        for name in NAMES
        for split in splits
        for tier in TIERS
    }
    taken: Times = {(name, tier): median_time(name, tier) for name in NAMES for tier in TIERS}
    origin = f"`{command_line()}`, beltarm {__version__} ({commit()}), {time.perf_counter() - began:.0f} s."
    write_text(config.out / "summary.md", markdown(results, taken, scenarios.label, config.out, origin))
    for name in NAMES:
        print(table(results, name))
    print(f"written to {config.out}: summary.md, 1 picture")


def main() -> None:
    """Command line."""
    run_command(__file__, Config, report, __doc__)


if __name__ == "__main__":
    main()
