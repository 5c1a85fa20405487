"""Train a residual policy by a teacher's advice: `python train/student.py`.

A student with a memory moves arms that it meets for the first time. After each episode, a teacher who knows the arm
says how every torque should have been. How this works, and why, is explained in `agents/learners/student.py` and
`agents/learners/teaching.py`. A run writes the same files as `train/ppo.py`. It is validated and saved after each
round.

S. Ross, G. J. Gordon, J. A. Bagnell: A Reduction of Imitation Learning and Structured Prediction to No-Regret Online
Learning, 2011.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines.tools.command import stop_without

try:
    from agents.learners.student import StudentConfig
    from agents.runs.command_line import main
except ModuleNotFoundError as error:
    stop_without("train/student.py", error)

if __name__ == "__main__":
    main(StudentConfig, __doc__)
