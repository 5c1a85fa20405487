"""Train a residual policy by rapid motor adaptation (RMA): `python train/rma.py`.

A policy is trained that is told arm and drive; then a memory that guesses, from what the encoder shows, what the policy
was told of them. How is said in `agents/learners/rma.py`. What a run writes is as in `train/ppo.py`; it validates, and
saves a checkpoint, after every round: in the first ones, in which there is no memory, as if all arms were alike.

A. Kumar, Z. Fu, D. Pathak, J. Malik: RMA: Rapid Motor Adaptation for Legged Robots, RSS 2021.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from agents.learners.rma import RmaConfig, make_learner
from agents.runs.command_line import main

if __name__ == "__main__":
    main(RmaConfig, make_learner, __doc__)
