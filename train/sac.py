"""Train a residual policy with SAC, soft actor-critic: `python train/sac.py`.

A run writes the same files as `train/ppo.py`. What differs from the textbook's SAC is explained in
`agents/learners/sac.py`.

T. Haarnoja et al.: Soft Actor-Critic Algorithms and Applications, 2018.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from agents.learners.sac import SacConfig
from agents.runs.command_line import main

if __name__ == "__main__":
    main(SacConfig, __doc__)
