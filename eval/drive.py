"""Measure controllers on a drive that is not ideal: `python eval/drive.py`.

Each effect of the drive is varied alone, then all together, from none to twice the upper end of the training range.
Writes summary.md, results.json and pictures of cost, tip error and residual vibration.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines.tools.command import require_bounds, run_command, stop_without

try:
    import tyro
    from rich.console import Console

    from baselines.engines.parallel import default_jobs
    from baselines.tools.files import require_writable, write_text
    from baselines.tools.progress import progress_count
    from baselines.tools.provenance import command_line, software
    from beltarm_env.task.seeds import DRIVE_SIZES
    from eval.drives.page import as_json, costs_table, markdown
    from eval.drives.pictures import save_pictures
    from eval.drives.study import MOST_ARMS, SIZES, check_sizes, choose_methods, run_study
except ModuleNotFoundError as error:
    stop_without("eval/drive.py", error)


@dataclass(frozen=True)
class Config:
    """Measure controllers over the size of each effect of the drive."""

    names: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[NAME ...]")] = ()
    """Controllers to measure. Default: all shipped ones."""
    out: Path = Path("results/drive")
    """Folder for summary.md, results.json and the pictures."""
    arms: int = 64
    """Number of arms, 4 to 1000."""
    sizes: tuple[float, ...] = SIZES
    """Sizes of the effects, above 0 and at most 2, where 1 is the upper end of the training range. 1 must be among
    them."""
    jobs: int | None = None
    """Number of processes. Default: one per core."""


def report(config: Config) -> None:
    """Measure everything and write it to the folder.

    Raises:
        ValueError: If a name or an option is not allowed.
        OSError: If the folder cannot be written to, or a process died.
    """
    began = time.perf_counter()
    require_bounds(config, arms=(4, MOST_ARMS), jobs=(1, 256))
    check_sizes(config.sizes)
    methods = choose_methods(config.names)
    require_writable(config.out)
    provenance = {"command": command_line(), **software("numpy", "numba", "torch"), "seed": DRIVE_SIZES.first}
    with progress_count("controllers and effects", Console(stderr=True)) as done:
        study = run_study(methods, config.arms, config.sizes, config.jobs or default_jobs(), done)
    pictures = save_pictures(study, config.out)
    origin = f"`{provenance['command']}`, beltarm {provenance['version']} ({provenance['commit']})"
    write_text(config.out / "results.json", as_json(study, provenance))
    page = markdown(study, pictures, f"{origin}, {time.perf_counter() - began:.0f} s.")
    write_text(config.out / "summary.md", page)
    print(costs_table(study))
    print(f"written to {config.out}: summary.md, results.json, {len(pictures)} pictures")


def main() -> None:
    """Command line."""
    run_command(__file__, Config, report, __doc__)


if __name__ == "__main__":
    main()
