"""Measure what tasks side by side take, by engine: `python eval/scaling.py`.

Writes summary.md: the cost of an engine per task, equal tasks from 1 to 16, and comparisons from a hundred scenarios to
a hundred thousand, with their memory. Nothing else should run on the machine meanwhile.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines.tools.command import require_bounds, run_command, stop_without

try:
    from baselines.engines.parallel import default_jobs
    from baselines.tools.files import require_writable, write_text
    from baselines.tools.progress import progress_over
    from baselines.tools.provenance import command_line, commit
    from beltarm_env import __version__
    from eval.engines.page import Findings, markdown
    from eval.engines.study import ENGINES, comparison, equal_tasks, overhead
except ModuleNotFoundError as error:
    stop_without("eval/scaling.py", error)


@dataclass(frozen=True)
class Config:
    """Measure what tasks side by side take, by engine."""

    out: Path = Path("results/scaling")
    """Folder for summary.md."""
    methods: tuple[str, ...] = ("paper",)
    """Methods of the comparisons."""
    most: int = 100_000
    """Most scenarios of a comparison, 100 or more."""
    tasks: int = 16
    """Most equal tasks."""
    jobs: int | None = None
    """Processes. Default: one per core."""


def report(config: Config) -> None:
    """Measure everything, and write the page."""
    require_bounds(config, most=(100, 10**7), tasks=(1, 1000), jobs=(1, 256))
    require_writable(config.out)
    jobs, empty = config.jobs or default_jobs(), 200
    begun = progress_over("engines", ENGINES.items())
    overheads = {name: overhead(engine, jobs, empty) for name, engine in begun}
    counts = [count for count in (1, 2, 4, 8, 16, 32, 64) if count <= config.tasks]
    equal = {
        count: {name: equal_tasks(engine, jobs, count) for name, engine in ENGINES.items()}
        for count in progress_over("numbers of equal tasks", counts)
    }
    comparisons, sizes = {}, [10**power for power in range(2, 8) if 10**power <= config.most]
    with tempfile.TemporaryDirectory() as folder:
        of_all = [(method, scenarios) for method in config.methods for scenarios in sizes]
        for method, scenarios in progress_over("comparisons", of_all):
            engines = ENGINES if scenarios <= 10_000 else ["local"]
            uses = {name: comparison(method, scenarios, name, jobs, Path(folder) / name) for name in engines}
            comparisons[method, scenarios] = uses
    origin = f"`{command_line()}`, beltarm {__version__} ({commit()})."
    page = markdown(Findings(jobs, empty, overheads, equal, comparisons), origin)
    write_text(config.out / "summary.md", page)
    print(page)


def main() -> None:
    """Command line."""
    run_command(__file__, Config, report, __doc__)


if __name__ == "__main__":
    main()
