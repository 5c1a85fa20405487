"""Show how well a filter and learned observers see what the encoder does not show: `python eval/observers.py`.

All watch the same controllers on the development set. Writes summary.md, with tables and a picture.
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
    from eval.observing.page import Results, markdown, torsion_table
    from eval.observing.study import ACTING, measure, times_of, watchers
except ModuleNotFoundError as error:
    stop_without("eval/observers.py", error)


@dataclass(frozen=True)
class Config:
    """Show how well a filter and learned observers see what the encoder does not show."""

    splits: tuple[str, ...] = ()
    """Splits to run. Default: all."""
    out: Path = Path("results/observers")
    """Folder for summary.md and the picture."""
    episodes: int = 100
    """Scenarios per split, 4 to 500."""


def report(config: Config) -> None:
    """Measure everything and write it to the folder.

    Raises:
        ValueError: If an option is not allowed, or a shipped observer is damaged.
        OSError: If the folder cannot be written to.
    """
    began = time.perf_counter()
    require_bounds(config, episodes=(4, EPISODES))
    require_writable(config.out)
    scenarios, known = development_set(), watchers()
    splits = [scenarios.splits[name] for name in chosen("split", config.splits, scenarios.splits)]
    results: Results = {
        (name, split.name, watcher): seen
        for name in ACTING
        for split in splits
        for watcher, seen in measure(name, known, split, config.episodes).items()
    }
    times = times_of(known)
    origin = f"`{command_line()}`, beltarm {__version__} ({commit()}), {time.perf_counter() - began:.0f} s."
    page = markdown(results, known, times, scenarios.label, config.episodes, config.out, origin)
    write_text(config.out / "summary.md", page)
    print(torsion_table(results))
    print(f"written to {config.out}: summary.md, 1 picture")


def main() -> None:
    """Command line."""
    run_command(__file__, Config, report, __doc__)


if __name__ == "__main__":
    main()
