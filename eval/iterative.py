"""Iterative learning: `python eval/iterative.py` repeats the same moves on the same arms.

Each arm makes its move again and again, and three ways of learning from one repetition to the next are compared: the
arm and the torque (`baselines.iterative.controller`), the arm alone, and what a textbook does with the motor's error
(`baselines.iterative.motor_learning`). Beside them are controllers that learn nothing. Writes summary.md, results.json
and a picture.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines.tools.command import one_line_errors, stop_without

try:
    import tyro

    from baselines.tools.files import require_writable, write_text
    from beltarm_env.task.seeds import REPETITION
    from eval.repetition.report import as_json, markdown, save_picture, verdict
    from eval.repetition.study import KINDS, run_study
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
    """How often each move is made, 2 to 100."""
    seed: int = REPETITION.first
    """Of the first arm and its move; arm i has seed + i."""

    def check(self) -> None:
        """Check the numbers.

        Raises:
            ValueError: If one is out of range.
        """
        if not 4 <= self.arms <= REPETITION.size:
            raise ValueError(f"--arms must lie within 4 and {REPETITION.size}, got {self.arms}")
        if not 2 <= self.repetitions <= 100:
            raise ValueError(f"--repetitions must lie within 2 and 100, got {self.repetitions}")
        if self.seed < 0:
            raise ValueError(f"--seed must not be negative, got {self.seed}")


def main() -> None:
    """Command line."""
    began = time.perf_counter()
    with one_line_errors("eval/iterative.py"):
        config = tyro.cli(Config, description=__doc__)
        config.check()
        require_writable(config.out)
        results = run_study(config.arms, config.repetitions, config.seed)
        save_picture(results, config.out / "cost.png")
        write_text(config.out / "results.json", as_json(results, config.seed))
        write_text(config.out / "summary.md", markdown(results, config.seed, time.perf_counter() - began))
        for kind in KINDS:
            print(f"{kind}: {verdict(results, kind)}")
        print(f"written to {config.out}: summary.md, results.json, cost.png")


if __name__ == "__main__":
    main()
