"""Measure speed and accuracy: `python eval/bench.py`.

Each number stands beside a peer that is measured in the same run. Times are the best of several repetitions: what the
code can do when nothing else runs. Between machines, compare the ratios to the peer.
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
from eval.speed.parts import parts_table
from eval.speed.start_up import start_up_rows
from eval.speed.stepping import batch_rows, single_row, threads_row
from eval.speed.training import training_rows


@dataclass(frozen=True)
class Config:
    """Measure speed and accuracy."""

    arms: int = 4096
    """Arms of the batch."""
    repetitions: int = 25
    """Repetitions of each measurement. The best one counts."""
    steps: int = 100
    """Steps per repetition of a batch. Single arms take a hundred times as many."""
    parts: bool = False
    """Also measure what the parts of a batch's step take."""
    training: bool = False
    """Also run `train/ppo.py` with its defaults, and report when its policy halves the paper's figures. Takes
    minutes."""
    training_loop: bool = False
    """Also measure where PPO spends its time, and its speed beside PPO on single arms. Takes a minute."""


def run(config: Config) -> None:
    """Measure and print."""
    console = Console()
    rows = batch_rows(config.arms, config.steps, config.repetitions)
    rows.append(threads_row(4 * config.arms, config.steps, config.repetitions, "ideal"))
    rows.append(threads_row(config.arms, config.steps, config.repetitions, "train"))
    rows += [single_row(config.steps, config.repetitions), accuracy_row(), *start_up_rows(config.repetitions)]
    if config.parts:
        console.print(parts_table(config.arms, config.steps, config.repetitions))
    if config.training:
        rows += training_rows()
    if config.training_loop:
        from eval.speed.training_loop import loop_row  # loads torch, which the other measurements do without

        rows.append(loop_row(console))
    table = Table("what", "measured", "peer", "ratio", title=f"{os.cpu_count()} cores", title_justify="left")
    for row in rows:
        table.add_row(*row)
    console.print(table)


def main() -> None:
    """Command line."""
    run_command(__file__, Config, run, __doc__)


if __name__ == "__main__":
    main()
