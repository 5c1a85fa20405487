"""Train a residual policy with SAC, soft actor-critic: `python train/sac.py`.

A run writes the same files as `train/ppo.py`. What differs from the textbook's SAC is explained in
`agents/learners/sac.py`.

T. Haarnoja et al.: Soft Actor-Critic Algorithms and Applications, 2018.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines.tools.command import stop_without

try:
    from agents.learners.sac import SacConfig
    from agents.runs.command_line import main
except ModuleNotFoundError as error:
    stop_without("train/sac.py", error)

if __name__ == "__main__":
    main(SacConfig, __doc__)
