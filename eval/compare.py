"""Compare controllers on the same scenarios: `python eval/compare.py`.

Runs the paper's controller, its rigid variant without vibration feedback and the shipped residual PPO policies on every
split, prints a table, and writes results.json, episodes.csv, summary.md and pictures.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
import torch
import tyro
from rich.console import Console

from agents.bundle import BundleError
from baselines.files import require_writable, write_text
from baselines.provenance import command_line
from beltarm_env.rollout import Recording, rollout
from eval.methods import Method, classical_methods, learned_method, shipped_policies
from eval.plots import Traces, save_plots
from eval.results import (
    Comparison,
    Outcome,
    against_best_classical,
    make_outcome,
    provenance,
    write_results,
)
from eval.splits import EPISODES, MAX_EPISODES, QUICK_EPISODES, SPLITS
from eval.summary import markdown, print_tables
from eval.timing import action_times


@dataclass(frozen=True)
class Config:
    """Compare controllers on the belt-driven arm."""

    policy: Annotated[tuple[Path, ...], tyro.conf.UseAppendAction] = ()
    """Folder of a policy bundle, such as runs/ppo/best; repeat it for several training seeds of one method. Default:
    the shipped policies."""
    out: Path = Path("results/compare")
    """Folder for results.json, episodes.csv, summary.md and the pictures."""
    episodes: int | None = None
    """Scenarios per split; 200 by default."""
    quick: bool = False
    """A first look: 24 scenarios per split."""

    def check(self) -> None:
        """Check the number of episodes.

        Raises:
            ValueError: If it is out of range.
        """
        if self.episodes is not None and not 4 <= self.episodes <= MAX_EPISODES:
            raise ValueError(f"--episodes must lie within 4 and {MAX_EPISODES}, got {self.episodes}")

    @property
    def scenarios(self) -> int:
        """Scenarios per split."""
        return self.episodes or (QUICK_EPISODES if self.quick else EPISODES)


def compare(config: Config, console: Console) -> Comparison:
    """Run all methods on all splits and write everything."""
    config.check()
    torch.set_num_threads(1)  # the networks are too small for more
    began = time.perf_counter()
    require_writable(config.out)
    policies = list(config.policy) or shipped_policies()
    methods = classical_methods() + ([learned_method(policies)] if policies else [])
    times = {method.name: action_times(method.controllers[0]) for method in methods}
    outcomes: list[Outcome] = []
    against_best = {}
    traces: Traces = {}
    for split in SPLITS:
        of_split, traces[split] = _run_split(split, methods, config.scenarios, times)
        outcomes += of_split
        against_best[split] = against_best_classical(of_split)
    origin = provenance(command_line(), time.perf_counter() - began, policies)
    comparison = Comparison(outcomes, against_best, origin)
    print_tables(comparison, console)
    write_results(comparison, config.out)
    pictures = save_plots(comparison, traces, config.out)
    text = markdown(comparison) + "".join(f"\n![{path.stem}]({path.name})\n" for path in pictures)
    write_text(config.out / "summary.md", text)
    console.print(f"written to {config.out}: results.json, episodes.csv, summary.md, {len(pictures)} pictures")
    return comparison


def _run_split(
    split: str, methods: list[Method], episodes: int, times: dict[str, tuple[float, float]]
) -> tuple[list[Outcome], dict[str, tuple[Recording, int]]]:
    """Run all methods on one split; also a recording of each and the scenario to show of it."""
    scenarios = SPLITS[split]
    outcomes: list[Outcome] = []
    traces: dict[str, tuple[Recording, int]] = {}
    shown = 0
    for method in methods:
        runs = [rollout(c, episodes, seed=scenarios.seed, **scenarios.settings) for c in method.controllers]
        outcome = make_outcome(method, split, [run.metrics() for run in runs], times[method.name])
        if not outcomes:  # show the scenario in which the first method does as well as it does in the median
            shown = int(np.argsort(outcome.metrics["tip_rms_mm"][0])[episodes // 2])
        outcomes.append(outcome)
        traces[method.name] = (runs[0], shown)
    return outcomes, traces


def main() -> None:
    """Command line."""
    try:
        config = tyro.cli(Config, description=__doc__)
        compare(config, Console())
    except (BundleError, OSError, ValueError) as error:
        print(f"eval/compare.py: {error}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
