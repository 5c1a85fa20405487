"""Measure speed and accuracy: `python eval/bench.py`.

Each number stands beside a peer that is measured in the same run, in turns. Times and ratios are medians over the
repetitions, half of which have ratios within the last column; start-ups, and the parts of a step, are the best of
theirs. Between machines, compare the ratios to the peer.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rich.console import Console
from rich.table import Table

from baselines.tools.command import run_command
from eval.speed.accuracy import accuracy_row
from eval.speed.parts import parts_tables
from eval.speed.start_up import memory_rows, start_up_rows
from eval.speed.stepping import batch_rows, rollout_rows, single_row, threads_row
from eval.speed.training import training_rows


@dataclass(frozen=True)
class Config:
    """Measure speed and accuracy."""

    arms: int = 4096
    """Arms of the batch."""
    repetitions: int = 25
    """Repetitions of each measurement."""
    steps: int = 100
    """Steps per repetition of a batch. Single arms take a hundred times as many."""
    parts: bool = False
    """Also measure what the parts of a batch's step take, count their operations, and tell how long a core would need
    for these at least."""
    training: bool = False
    """Also run `train/ppo.py` with its defaults, and report when its policy halves the paper's figures. Takes
    minutes."""
    training_loop: bool = False
    """Also measure where PPO spends its time, and its speed beside PPO on single arms. Takes a minute."""
    sizes: bool = False
    """Measure steps per second over the size of the batch instead, beside all peers that are installed (extra
    `bench`). Takes several minutes."""
    out: Path = Path("results/bench")
    """Folder for sizes.md and sizes.png."""


def run(config: Config) -> None:
    """Measure and print."""
    console = Console()
    if config.sizes:
        from eval.speed.sizes import save_sizes  # loads matplotlib, which the other measurements do without

        save_sizes(config.out, config.repetitions, console)
        console.print(f"{config.out / 'sizes.md'}")
        return
    rows = batch_rows(config.arms, config.steps, config.repetitions)
    rows.append(threads_row(4 * config.arms, config.steps, config.repetitions, "ideal"))
    rows.append(threads_row(config.arms, config.steps, config.repetitions, "train"))
    rows += [*rollout_rows(config.repetitions), single_row(config.steps, config.repetitions), accuracy_row()]
    rows += [*start_up_rows(config.repetitions), *memory_rows()]
    if config.parts:
        console.print(*parts_tables(config.arms, config.steps, config.repetitions), sep="\n")
    if config.training:
        rows += training_rows()
    if config.training_loop:
        from eval.speed.training_loop import loop_row  # loads torch, which the other measurements do without

        rows.append(loop_row(console))
    table = Table(
        "what", "measured", "peer", "ratio", "middle half", title=f"{os.cpu_count()} cores", title_justify="left"
    )
    for row in rows:
        table.add_row(*row)
    console.print(table)


def main() -> None:
    """Command line."""
    run_command(__file__, Config, run, __doc__)


if __name__ == "__main__":
    main()
