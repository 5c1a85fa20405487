"""Compare the full arm in two engines: `python eval/crosscheck.py`.

Arms of the ideal ranges are moved by the paper's controller, and back and forth so that the motor sticks and breaks
away; also with those effects of a drive that MuJoCo can express. The same torques then go into this package's kernel
and into MuJoCo, from the same state and without feedback. Prints the largest distance between the two tips over 1.8 s,
and writes summary.md with a picture.
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
    from beltarm_env.task.seeds import CROSSCHECK
    from eval.verification.crosscheck import crosscheck
    from eval.verification.crosscheck_report import markdown, save_picture
except ModuleNotFoundError as error:
    stop_without("eval/crosscheck.py", error)


@dataclass(frozen=True)
class Config:
    """Compare the full arm in MuJoCo with the compiled kernel."""

    out: Path = Path("results/crosscheck")
    """Folder for summary.md and the picture."""
    arms: int = 8
    """Arms of each kind of motion, 1 to 1000."""
    seed: int = CROSSCHECK.first
    """Seed of the first arm. Arm i has seed + i."""


def report(config: Config) -> None:
    """Compare the engines and write what comes out."""
    began = time.perf_counter()
    require_bounds(config, arms=(1, CROSSCHECK.size), seed=(0, None))
    require_writable(config.out)
    results = crosscheck(config.arms, config.seed)
    text = markdown(results, config.arms, config.seed, time.perf_counter() - began)
    save_picture(results, config.out / "distance.png")
    write_text(config.out / "summary.md", text)
    print(text)


def main() -> None:
    """Command line."""
    run_command(__file__, Config, report, __doc__)


if __name__ == "__main__":
    main()
