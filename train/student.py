"""Train a residual policy by imitation: `python train/student.py`.

A teacher practises every move on every arm; a student, who meets the arms for the first time, learns what the teacher
would do in its place. How, and why it works, is said in `agents/learners/imitation.py`. What a run writes is as in
`train/ppo.py`; it validates, and saves a checkpoint, after every round.

S. Ross, G. J. Gordon, J. A. Bagnell: A Reduction of Imitation Learning and Structured Prediction to No-Regret Online
Learning, 2011.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from agents.learners.imitation import ImitationConfig, Student
from agents.runs.command_line import main


@dataclass(frozen=True)
class Config(ImitationConfig):
    """Train a residual policy by imitation of a practised teacher."""

    algorithm: ClassVar[str] = "student"

    out: Path = Path("runs/student")
    """Folder of the run; of several seeds' runs, the folder of their folders seed0, seed1, ..."""
    base: str = "adaptive"
    """Controller that the residual corrects, any classical one; "none" to learn torques from scratch."""
    learning_rate: float = 1e-3
    """Learning rate of the optimiser, from which it falls to zero in each fit."""
    residual_limit: float = 0.3
    """Largest residual, as a share of the torque limit."""
    hold: int = 4
    """Samples for which a residual is held: 6 ms."""


if __name__ == "__main__":
    main(Config, Student, __doc__)
