"""Regenerate what the paper shows: `python eval/paper.py`.

Writes the motion of motor and tip with and without vibration feedback (Figs. 4b and 8b), root loci (Fig. 6), a map of
the damping over K4 and M2, and tables.md: ringing before and after, poles, and alternatives to everything that the
paper does not print. docs/science/paper.md draws conclusions. drive.md and its pictures show what becomes of the
paper's conclusion on a drive that is not ideal.
"""

from __future__ import annotations

import math
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines.tools.command import run_command, stop_without

try:
    from rich.console import Console

    from baselines.tools.files import require_writable, write_text
    from baselines.tools.options import Groups
    from baselines.tools.progress import progress_count
    from beltarm_env.task.reference import MoveShape
    from eval.reproduction.assumptions import USUAL_MOVE
    from eval.reproduction.drive_page import drive_markdown
    from eval.reproduction.drive_plots import save_drive_pictures
    from eval.reproduction.drives import run_drives
    from eval.reproduction.loop import ServoGains
    from eval.reproduction.response_plots import save_pictures
    from eval.reproduction.runs import check_move
    from eval.reproduction.study import run_study
    from eval.reproduction.tables import answer_table, markdown
except ModuleNotFoundError as error:
    stop_without("eval/paper.py", error)

_TABLE_2 = ServoGains()


@dataclass(frozen=True)
class Config:
    """Regenerate the paper's figures and conclusion."""

    groups: ClassVar[Groups] = {
        "basic": ("out",),
        "gain": ("k4", "natural_frequency", "damping"),
        "move": (),
    }

    out: Path = Path("results/paper")
    """Folder for tables.md, drive.md and the pictures."""
    k4: float = _TABLE_2.k4
    """Gain K4 of the torsional velocity [N m s/rad], 0 to 1. Table 2 of the paper has 0.15."""
    natural_frequency: float = _TABLE_2.natural_frequency
    """Natural frequency omega_n of the position loop [rad/s], 0.1 to 100. Table 2 has 5."""
    damping: float = _TABLE_2.damping
    """Damping ratio xi of the position loop, 0.05 to 20. Table 2 has 2."""
    start_deg: float = math.degrees(USUAL_MOVE.start)
    """Joint angle at which the move starts [degrees], 0 to 90."""
    goal_deg: float = math.degrees(USUAL_MOVE.goal)
    """Joint angle at which the move ends [degrees], 0 to 90. The paper places its poles at 90."""
    duration: float = USUAL_MOVE.duration
    """Duration of the move [s]."""
    ramp_time: float = USUAL_MOVE.ramp_time
    """Duration of each ramp of the move [s]."""

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
    """Run everything, write it to the folder and print the answers.

    Raises:
        ValueError: If a gain, an angle or the move is not allowed.
        OSError: If the folder cannot be written to.
    """
    began = time.perf_counter()
    gains, move = config.gains, config.move
    require_writable(config.out)
    with progress_count("studies of the paper", Console(stderr=True)) as done:
        done(0, 3)
        study = run_study(gains, move)
        done(1, 3)
        pictures = save_pictures(study, config.out)
        tables = markdown(study, pictures, time.perf_counter() - began)
        done(2, 3)
        drives = run_drives(gains, move)
    of_drives = drive_markdown(drives)  # before a file of the commit changes
    pictures += save_drive_pictures(drives, config.out)
    write_text(config.out / "tables.md", tables)
    write_text(config.out / "drive.md", of_drives)
    print(f"Does K4 = {gains.k4:g} remove the tip's ringing?", answer_table(study), sep="\n\n")
    print(f"written to {config.out}: tables.md, drive.md, {len(pictures)} pictures", flush=True)


def main() -> None:
    """Command line."""
    run_command(__file__, Config, report, __doc__)


if __name__ == "__main__":
    main()
