"""Render all measured pages from their data: `python eval/pages.py`.

With `--check`, says which pages the code of today would measure differently. With `--measure`, measures all pages, or
those that are named, on a clean commit, the cheapest first; an interrupted run goes on.
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines.tools.command import run_command, stop_without

try:
    import tyro

    from eval.studies._pages import check, measure_all, render_all
except ModuleNotFoundError as error:
    stop_without("eval/pages.py", error)


@dataclass(frozen=True)
class Config:
    """Render, check or measure the measured pages."""

    names: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[NAME ...]")] = ()
    """Pages, by the names of their folders in docs/results. Default: all."""
    check: bool = False
    """Say which pages are fresh, and exit with 3 if one is not."""
    measure: bool = False
    """Measure them anew, on a clean commit."""


def run(config: Config) -> None:
    """Do what is asked for."""
    if config.check and config.measure:
        raise ValueError("--check and --measure are two things: give one of them")
    if config.check:
        states = check(config.names)
        for name, state in states:
            print(f"{name:12} {state.verdict:15} {state.commit}")
        sys.exit(3 * any(state.verdict != "fresh" for _, state in states))
    if config.measure:
        for name, news in measure_all(config.names):
            print(f"{name}: {news}", flush=True)
    for path in render_all(config.names):
        print(path)


def main() -> None:
    """Command line."""
    run_command(__file__, Config, run, __doc__)


if __name__ == "__main__":
    main()
