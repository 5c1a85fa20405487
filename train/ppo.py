"""Train a residual policy with PPO, proximal policy optimisation: `python train/ppo.py`.

Everything a run writes goes to one folder: `best/` (the policy bundle with the lowest validation cost), `last/`,
`checkpoint.pkl` (to go on with `--resume`), `config.json`, `validation.csv`, and the training log as CSV and for
TensorBoard. The checkpoint is a pickle, for this machine only; pass on `best/`, which is numbers and text.

Options and model are in `agents/learners/ppo.py`.

J. Schulman et al.: Proximal Policy Optimization Algorithms, 2017.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from agents.learners.ppo import PpoConfig, make_learner
from agents.runs.command_line import main

if __name__ == "__main__":
    main(PpoConfig, make_learner, __doc__)
