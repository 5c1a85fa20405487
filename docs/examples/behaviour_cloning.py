"""Clone a controller from a dataset: `python docs/examples/behaviour_cloning.py [CONTROLLER [DATASET]]`.

A network learns from observations alone what the controller wanted to do, without a simulator. Then it moves arms that
are in no dataset. `python eval/export.py dataset` writes the dataset.
"""

import os
import sys

import minari
import numpy as np
import torch
from torch import nn

from baselines import CONTROLLERS

HIDDEN, BATCH, EPOCHS, ARMS = 128, 2048, 20, 50
LAST_COMMAND = 24  # entry of the observation that is hidden: who sees it learns to repeat it


class Clone:
    """A network without memory, as a controller."""

    def __init__(self, observations: torch.Tensor) -> None:
        """Make an untrained one for observations like these, shape (n, size)."""
        self.mean, self.scale = observations.mean(0), observations.std(0) + 1e-6
        self.scale[LAST_COMMAND] = torch.inf
        first, second = nn.Linear(len(self.mean), HIDDEN), nn.Linear(HIDDEN, HIDDEN)
        self.network = nn.Sequential(first, nn.ReLU(), second, nn.ReLU(), nn.Linear(HIDDEN, 1), nn.Tanh())

    def __call__(self, observations: torch.Tensor) -> torch.Tensor:
        """Return actions, shape (n, 1)."""
        return self.network((observations - self.mean) / self.scale)

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        """Return actions and no memory, as every controller does."""
        with torch.no_grad():
            return self(torch.from_numpy(observation)).numpy(), None


def fit(episodes) -> Clone:
    """Clone what the controller of these episodes wanted to do, where random torques had taken the arm too."""
    seen = torch.from_numpy(np.concatenate([one.observations[:-1] for one in episodes]))
    wanted = [one.infos["behaviour"]["controller_action"][1:, None] for one in episodes]
    wanted = torch.from_numpy(np.concatenate(wanted))
    clone, steps = Clone(seen), EPOCHS * len(seen) // BATCH + 1
    optimiser = torch.optim.Adam(clone.network.parameters())
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    for _ in range(steps):
        rows = torch.randint(len(seen), (BATCH,))
        loss = (clone(seen[rows]) - wanted[rows]).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    return clone


def mean_return(env, controller) -> float:
    """Mean sum of rewards on the arms of seeds 0, 1, 2, ..."""
    total = 0.0
    for seed in range(ARMS):
        (observation, _), memory, over = env.reset(seed=seed), None, False
        while not over:
            action, memory = controller.predict(observation[None], memory)
            observation, reward, terminated, truncated, _ = env.step(action[0])
            total, over = total + reward, terminated or truncated
    return total / ARMS


def main(name: str = "adaptive", dataset_id: str = "beltarm/randomized/mixed-v0") -> None:
    """Clone a controller, and compare the clone with it and with `paper`."""
    os.environ.setdefault("MINARI_DATASETS_PATH", "results/datasets")
    torch.manual_seed(0)
    dataset = minari.load_dataset(dataset_id)
    every = list(dataset.storage.get_episode_metadata(dataset.episode_indices))
    told = [one for one in every if one["controller"] == name]
    if not told:
        sys.exit(f"no episode of {name!r}, only of {', '.join(sorted({one['controller'] for one in every}))}")
    clone = fit(list(dataset.iterate_episodes([one["id"] for one in told])))
    env = dataset.recover_environment(eval_env=True)
    found = {f"{name} in the dataset": -np.mean([one["cost"] for one in told if one["disturbance"] == "none"])}
    found |= {f"clone of {name}": mean_return(env, clone), "paper": mean_return(env, CONTROLLERS["paper"]())}
    for who, total in found.items():
        print(f"{who}: mean cost {-total:.0f}, score {minari.get_normalized_score(dataset, total):.3f}")


if __name__ == "__main__":
    main(*sys.argv[1:])
