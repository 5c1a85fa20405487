"""Train a residual policy by rapid motor adaptation (RMA): `python train/rma.py`.

First a policy is trained that knows its arm and drive. Then a memory is trained that guesses the same from the
encoder. The method is explained in `agents/learners/rma.py`. A run writes the same files as `train/ppo.py`. It is
validated and saved after each round; until the memory is trained, all arms are taken to be alike.

A. Kumar, Z. Fu, D. Pathak, J. Malik: RMA: Rapid Motor Adaptation for Legged Robots, RSS 2021.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from agents.learners.rma import RmaConfig
from agents.runs.command_line import main

if __name__ == "__main__":
    main(RmaConfig, __doc__)
