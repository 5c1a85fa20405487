"""Besiege the project: `python eval/soak.py`, or `make soak`.

Attacks what the documentation promises: with arms that nobody would build, mischievous controllers, kills at any
moment, damaged files, and elsewhere. Writes what was tried and what was found. Exit status 1 if anything was.
"""

from __future__ import annotations

import os
import sys
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines.tools.command import require_bounds, run_command, stop_without

try:
    from baselines.engines.parallel import Failure, run_side_by_side
    from baselines.tools.files import require_writable, write_text
    from baselines.tools.provenance import command_line, commit
    from beltarm_env import __version__
    from eval.siege.parts import PARTS, timed
    from eval.siege.report import Siege, markdown
except ModuleNotFoundError as error:
    stop_without("eval/soak.py", error)


@dataclass(frozen=True)
class Config:
    """Besiege the project, and say what was tried and what was found."""

    parts: tuple[str, ...] = ()
    """Parts of the siege. Default: all."""
    share: float = 1.0
    """Of a whole siege, 0.001 to 100."""
    seed: int = 0
    """Of all that is drawn. Another one is another siege."""
    jobs: int | None = None
    """Parts side by side. Default: one per core."""
    out: Path = Path("results/soak")
    """Folder for reliability.md."""


def besiege(config: Config) -> None:
    """Run the parts and write the page.

    Raises:
        ValueError: If an option is not allowed.
        OSError: If the folder cannot be written to.
        SystemExit: If a promise was broken, with status 1.
    """
    require_bounds(config, seed=(0, 2**32 - 1))
    if not 0.001 <= config.share <= 100:
        raise ValueError(f"--share must be 0.001 to 100, got {config.share:g}")
    unknown = [name for name in config.parts if name not in PARTS]
    if unknown:
        raise ValueError(f"--parts has {unknown[0]!r}; there are {', '.join(PARTS)}")
    require_writable(config.out)
    began = time.perf_counter()
    tasks = {name: partial(timed, name, config.share, config.seed) for name in config.parts or PARTS}
    done: dict[str, tuple[Siege, float]] = {}
    for name, result in run_side_by_side(tasks, config.jobs):
        if isinstance(result, Failure):
            broken = Siege(name, "attacks", "anything: it did not come to an end", found=[result.message])
            result = broken, time.perf_counter() - began
        siege, seconds = done[name] = result
        print(f"{name}: {siege.count} {siege.unit} in {seconds:.0f} s, {len(siege.found)} broken promises", flush=True)
        for line in siege.found:
            print(f"  {line}", flush=True)
    took = f"{time.perf_counter() - began:.0f} s on {os.cpu_count()} cores"
    origin = f"`{command_line()}`, beltarm {__version__} ({commit()}), {took}."
    write_text(config.out / "reliability.md", markdown([done[name] for name in tasks], origin))
    print(f"written to {config.out}: reliability.md")
    if any(siege.found for siege, _ in done.values()):
        raise SystemExit(1)


def main() -> None:
    """Command line."""
    run_command(__file__, Config, besiege, __doc__)


if __name__ == "__main__":
    main()
