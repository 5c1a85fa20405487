"""Repeat the same moves on the same arms, and learn from them: `python eval/iterative.py`.

Three ways of learning from one repetition to the next are compared: arm and torque (`baselines.iterative.controller`),
the arm alone, and the textbook's use of the motor's error (`baselines.iterative.motor_learning`). Controllers that
learn nothing stand beside them. Writes summary.md, results.json and a picture.
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
    from beltarm_env.task.seeds import REPETITION
    from eval.repetition.report import as_json, differences_table, markdown, save_picture
    from eval.repetition.study import run_study
except ModuleNotFoundError as error:
    stop_without("eval/iterative.py", error)


@dataclass(frozen=True)
class Config:
    """Repeat moves and learn from them."""

    out: Path = Path("results/iterative")
    """Folder for summary.md, results.json and the picture."""
    arms: int = 100
    """Arms of each kind, 4 to 1000."""
    repetitions: int = 10
    """How often each arm makes its move, 2 to 100."""
    seed: int = REPETITION.first
    """Seed of the first arm and its move. Arm i has seed + i."""


def report(config: Config) -> None:
    """Repeat the moves and write what comes out."""
    began = time.perf_counter()
    require_bounds(config, arms=(4, REPETITION.size), repetitions=(2, 100), seed=(0, None))
    require_writable(config.out)
    results = run_study(config.arms, config.repetitions, config.seed)
    # before a file of the commit changes
    data, page = as_json(results, config.seed), markdown(results, config.seed, time.perf_counter() - began)
    save_picture(results, config.out / "cost.png")
    write_text(config.out / "results.json", data)
    write_text(config.out / "summary.md", page)
    print(differences_table(results))
    print(f"written to {config.out}: summary.md, results.json, cost.png")


def main() -> None:
    """Command line."""
    run_command(__file__, Config, report, __doc__)


if __name__ == "__main__":
    main()
