"""Train a residual policy with recurrent PPO: `python train/recurrent_ppo.py`.

An LSTM remembers what the encoder has shown. Other agents observe the identified arm instead: can a network learn by
itself to identify arms? A run writes the same files as `train/ppo.py`.

J. Schulman et al.: Proximal Policy Optimization Algorithms, 2017; S. Hochreiter, J. Schmidhuber: Long Short-Term
Memory, 1997.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines.tools.command import stop_without

try:
    from agents.learners.ppo import RecurrentPpoConfig
    from agents.runs.command_line import main
except ModuleNotFoundError as error:
    stop_without("train/recurrent_ppo.py", error)

if __name__ == "__main__":
    main(RecurrentPpoConfig, __doc__)
