"""Train a residual policy with PPO, proximal policy optimisation: `python train/ppo.py`.

A run writes one folder: `best/` (the policy with the lowest validation cost), `last/`, `validation.csv`, `config.json`,
`command.json`, the training log (CSV and TensorBoard), and `checkpoint.pkl`, from which `--resume` continues. The
checkpoint is a pickle, for this machine only. Share `best/`, which holds only numbers and text.

The model is in `agents/learners/ppo.py`. On `adaptive`, which leaves little to find, a teacher's advice comes first;
with `--base paper` PPO learns by trial and error alone.

J. Schulman et al.: Proximal Policy Optimization Algorithms, 2017.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines.tools.command import stop_without

try:
    from agents.learners.ppo import PpoConfig
    from agents.runs.command_line import main
except ModuleNotFoundError as error:
    stop_without("train/ppo.py", error)

if __name__ == "__main__":
    main(PpoConfig, __doc__)
