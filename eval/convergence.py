"""Measure the integrator's order of convergence: `python eval/convergence.py`.

Integrates the same torques with 1, 2, 4 and 8 steps per control period, and compares the tip with a solution by SciPy's
DOP853 that locates all events. There are three motions: without Coulomb friction; with a motor that sticks and breaks
away again and again; and the same behind a drive with every effect at its upper end in training.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines.tools.command import require_bounds, run_command, stop_without

try:
    from rich.console import Console

    from beltarm_env import EPISODE_STEPS
    from eval.verification.convergence import REGIMES, measure_convergence, table
    from eval.verification.event_located import MODELS
except ModuleNotFoundError as error:
    stop_without("eval/convergence.py", error)


@dataclass(frozen=True, slots=True)
class Config:
    """Print the integrator's error against its step, and the order of convergence."""

    samples: int = EPISODE_STEPS
    """Length of the motion in control periods, 1 to 1200."""


def run(config: Config) -> None:
    """Measure and print."""
    require_bounds(config, samples=(1, EPISODE_STEPS))
    Console().print(table([measure_convergence(m, r, config.samples) for m in MODELS for r in REGIMES]))


def main() -> None:
    """Command line."""
    run_command(__file__, Config, run, __doc__)


if __name__ == "__main__":
    main()
