"""Train a residual policy by imitation: `python train/student.py`.

A teacher practises every move on every arm; a student, who meets the arms for the first time, learns what the teacher
would do in its place. How, and why it works, is said in `agents/learners/student.py`. What a run writes is as in
`train/ppo.py`; it validates, and saves a checkpoint, after every round.

S. Ross, G. J. Gordon, J. A. Bagnell: A Reduction of Imitation Learning and Structured Prediction to No-Regret Online
Learning, 2011.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from agents.learners.student import StudentConfig, make_learner
from agents.runs.command_line import main

if __name__ == "__main__":
    main(StudentConfig, make_learner, __doc__)
