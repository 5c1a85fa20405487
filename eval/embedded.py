"""Show what generated controllers take, and that they are what was compared: `python eval/embedded.py`.

Exports controllers, compiles each and runs it in the loop with arms of the development set. Writes summary.md.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines.tools.command import require_bounds, run_command, stop_without

try:
    from rich.console import Console

    from baselines.tools.files import require_writable, write_text
    from baselines.tools.progress import progress_count
    from baselines.tools.provenance import command_line, commit
    from beltarm_env import __version__
    from eval.comparison.methods import chosen
    from eval.comparison.sets import development_set
    from eval.deploy.building import here
    from eval.deploy.page import markdown, times_table
    from eval.deploy.study import CONTROLLERS, examine
except ModuleNotFoundError as error:
    stop_without("eval/embedded.py", error)


@dataclass(frozen=True)
class Config:
    """Show what generated controllers take, and that they are what was compared."""

    controllers: tuple[str, ...] = ()
    """Controllers and folders of policies. Default: classical ones without variants, and a policy of each method."""
    splits: tuple[str, ...] = ()
    """Splits to run. Default: all."""
    out: Path = Path("results/embedded")
    """Folder for summary.md."""
    episodes: int = 8
    """Scenarios per split, 1 to 200."""


def report(config: Config) -> None:
    """Examine every controller and write the page.

    Raises:
        ValueError: If an option is not allowed, or there is no compiler.
        OSError: If the folder cannot be written to.
    """
    began = time.perf_counter()
    require_bounds(config, episodes=(1, 200))
    here()
    require_writable(config.out)
    scenarios = development_set()
    splits = [scenarios.splits[name] for name in chosen("split", config.splits, scenarios.splits)]
    results = []
    with progress_count("controllers", Console(stderr=True)) as done:
        names = config.controllers or CONTROLLERS
        for k, name in enumerate(names):
            results.append(examine(name, splits, config.episodes))
            done(k + 1, len(names))
    origin = f"`{command_line()}`, beltarm {__version__} ({commit()}), {time.perf_counter() - began:.0f} s."
    write_text(config.out / "summary.md", markdown(results, scenarios.label, origin))
    print(times_table(results))
    print(f"written to {config.out}: summary.md")


def main() -> None:
    """Command line."""
    run_command(__file__, Config, report, __doc__)


if __name__ == "__main__":
    main()
