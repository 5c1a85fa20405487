"""Show what the guard is worth: `python eval/faults.py`.

Runs learned and classical controllers with and without the guard while something breaks in mid-move, and on the
development set, where nothing does. Writes summary.md, with tables and a picture.
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
    from baselines.tools.progress import progress_over
    from baselines.tools.provenance import command_line, commit
    from beltarm_env import __version__
    from beltarm_env.task.seeds import FAULTS as SEEDS
    from eval.comparison.methods import chosen
    from eval.comparison.sets import development_set
    from eval.comparison.splits import EPISODES
    from eval.guarding.faults import FAULTS
    from eval.guarding.page import Compared, markdown, table
    from eval.guarding.study import BASES, LEARNED, NAN, health, outcome
except ModuleNotFoundError as error:
    stop_without("eval/faults.py", error)


@dataclass(frozen=True)
class Config:
    """Show what the guard is worth while something breaks, and what it costs while nothing does."""

    splits: tuple[str, ...] = ()
    """Splits on which nothing breaks. Default: all."""
    out: Path = Path("results/guard")
    """Folder for summary.md and the picture."""
    arms: int = 100
    """Arms on which something breaks, 1 to 10000."""
    episodes: int = 100
    """Scenarios per split, 4 to 500."""


def report(config: Config) -> None:
    """Measure everything and write it to the folder.

    Raises:
        ValueError: If an option is not allowed, or a file of gains is damaged.
        OSError: If the folder cannot be written to.
    """
    began = time.perf_counter()
    require_bounds(config, episodes=(4, EPISODES), arms=(1, SEEDS.size))
    require_writable(config.out)
    scenarios = development_set()
    splits = [scenarios.splits[name] for name in chosen("split", config.splits, scenarios.splits)]
    cases = [(name, fault) for name in BASES for fault in FAULTS if fault != NAN or name in LEARNED]
    results = [
        Compared(
            name,
            fault,
            outcome(BASES[name], fault, False, config.arms),
            outcome(name, fault, False, config.arms),
            outcome(name, fault, True, config.arms),
        )
        for name, fault in progress_over("faults", cases)
    ]
    pairs = progress_over("splits where nothing breaks", [(name, split) for name in BASES for split in splits])
    healthy = {(name, split.name): health(name, split, config.episodes) for name, split in pairs}
    origin = f"`{command_line()}`, beltarm {__version__} ({commit()}), {time.perf_counter() - began:.0f} s."
    page = markdown(results, healthy, config.arms, scenarios.label, config.out, origin)
    write_text(config.out / "summary.md", page)
    for name in BASES:
        print(table(results, name))
    print(f"written to {config.out}: summary.md, 1 picture")


def main() -> None:
    """Command line."""
    run_command(__file__, Config, report, __doc__)


if __name__ == "__main__":
    main()
