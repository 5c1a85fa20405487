"""Is this really the paper? `python eval/paper.py` regenerates what it shows.

Writes the motor's and the tip's motion with and without vibration feedback (Figs. 4b and 8b), root loci (Fig. 6), a map
of the damping over K4 and M2, and summary.md: ringing before and after, and what becomes of the paper's conclusion over
the range of everything that it does not print.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import math


def _end(message: str, status: int) -> NoReturn:
    print(f"eval/paper.py: {message}", file=sys.stderr)
    sys.exit(status)


try:
    import tyro

    from baselines.tools.files import require_writable, write_text
    from beltarm_env.task.reference import MoveShape
    from eval.reproduction.cases import USUAL_MOVE
    from eval.reproduction.loop import ServoGains
    from eval.reproduction.response_plots import save_pictures
    from eval.reproduction.runs import check_move
    from eval.reproduction.study import run_study
    from eval.reproduction.summary import markdown, verdict
except ModuleNotFoundError as error:
    package = (error.name or "a package").split(".")[0]
    _end(f"{package} is not installed; run `make setup`, or `pip install -e '.[checkout]'`", 2)
except KeyboardInterrupt:
    _end("interrupted", 130)


_TABLE_2 = ServoGains()


@dataclass(frozen=True)
class Config:
    """Regenerate the paper's figures and conclusion."""

    out: Path = Path("results/paper")
    """Folder for summary.md and the pictures."""
    k4: float = _TABLE_2.k4
    """Gain K4 of the torsional velocity [N m s/rad], 0 to 1; Table 2 has 0.15."""
    natural_frequency: float = _TABLE_2.natural_frequency
    """omega_n of the position loop [rad/s], 0.1 to 100; Table 2 has 5."""
    damping: float = _TABLE_2.damping
    """xi of the position loop, 0.05 to 20; Table 2 has 2."""
    start_deg: float = math.degrees(USUAL_MOVE.start)
    """Joint angle at which the standard move starts, 0 to 90."""
    goal_deg: float = math.degrees(USUAL_MOVE.goal)
    """Joint angle at which it ends, 0 to 90; the paper places its poles at 90."""
    duration: float = USUAL_MOVE.duration
    """Its duration [s]."""
    ramp_time: float = USUAL_MOVE.ramp_time
    """Duration of each of its ramps [s]."""

    @property
    def gains(self) -> ServoGains:
        """The gains.

        Raises:
            ValueError: If one is out of range, naming it.
        """
        return ServoGains(self.k4, self.natural_frequency, self.damping)

    @property
    def move(self) -> MoveShape:
        """The standard move.

        Raises:
            ValueError: If an angle is out of range or the move is not feasible, naming the value and what would do.
        """
        for name, angle in (("--start-deg", self.start_deg), ("--goal-deg", self.goal_deg)):
            if not 0 <= angle <= 90:
                raise ValueError(f"{name} must lie within 0 and 90 degrees, got {angle:g}")
        move = MoveShape(math.radians(self.start_deg), math.radians(self.goal_deg), self.duration, self.ramp_time)
        check_move(move)
        return move


def report(config: Config) -> None:
    """Run everything and write it to the folder.

    Raises:
        ValueError: If a gain, an angle or the move is not allowed.
        OSError: If the folder cannot be written to.
    """
    began = time.perf_counter()
    gains, move = config.gains, config.move
    require_writable(config.out)
    study = run_study(gains, move)
    pictures = save_pictures(study, config.out)
    write_text(config.out / "summary.md", markdown(study, pictures, time.perf_counter() - began))
    _tell([*verdict(study), f"written to {config.out}: summary.md, {len(pictures)} pictures"])


def _tell(lines: Iterable[str]) -> None:
    """Print, unless whoever reads it has gone."""
    try:
        print("\n".join(lines), flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or Python complains on exit


def main() -> None:
    """Command line."""
    try:
        report(tyro.cli(Config, description=__doc__))
    except KeyboardInterrupt:
        _end("interrupted", 130)
    except (OSError, ValueError) as error:
        _end(str(error), 2)


if __name__ == "__main__":
    main()
